"""Robots at play: an environment, what moves its robots, and the count of how they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from locorl.env.kinematics import yaw_of
from locorl.env.legged_env import LeggedEnv
from locorl.evaluation.evaluate import Actor
from locorl.interfaces import Array, BodyFactory
from locorl.play.actors import check_fits
from locorl.tasks.task import TaskConfig

Command = tuple[float, float, float]
"""vx, vy (m/s) and yaw rate (rad/s) in the base frame."""
_SMOOTHING = 0.5
"""Time constant of the speed shown, s."""


@dataclass(frozen=True)
class Score:
    """How robots did until their first fall or the end of their course; arrays are (N,).

    Attributes:
        survived: no fall so far, bool.
        distance: way forward, or towards the waypoints, m.
        speed: mean speed that way, m/s.
        commanded: mean commanded forward speed, m/s.
    """

    survived: NDArray[np.bool_]
    distance: Array
    speed: Array
    commanded: Array

    def summary(self) -> dict[str, float]:
        """Means over the robots, under the names that `locorl play` prints."""
        return {
            "robots": float(len(self.survived)),
            "survived": float(self.survived.sum()),
            "distance": float(self.distance.mean()),
            "speed": float(self.speed.mean()),
            "commanded_speed": float(self.commanded.mean()),
        }


class Session:
    """Plays a task.

    Args:
        factory: makes the bodies.
        designs: one per robot, (N, d).
        task: what to play.
        actor: moves the robots.
        command: in place of the task's own; where there are waypoints they still give the yaw rate.
        seed: of commands and terrains.

    Raises:
        ValueError: the actor does not fit robot or task, or a design has no stance.

    Attributes:
        env: the environment.
        command: as above; may be changed at any time.
        speed: forward speed of each robot, smoothed, (N,), m/s.
        falls: of each robot since the start, (N,).
    """

    def __init__(
        self,
        factory: BodyFactory,
        designs: Array,
        task: TaskConfig,
        actor: Actor,
        command: Command | None = None,
        seed: int = 0,
    ) -> None:
        self.env = LeggedEnv(factory, designs, task, seed=seed)
        check_fits(actor, self.env)
        self.actor = actor
        self.command = command
        self._seed = seed
        self.restart()

    def restart(self) -> None:
        """Everything back to the start."""
        n = self.env.num_envs
        self._obs = self.env.reset(seed=self._seed)
        self.actor.reset()
        self.speed = torch.zeros(n)
        self.falls = torch.zeros(n, dtype=torch.long)
        self._arrived = torch.zeros(n, dtype=torch.bool)
        self._distance, self._commanded, self._time = (torch.zeros(n, dtype=torch.float64) for _ in range(3))

    def step(self) -> None:
        """Advance one control period."""
        env = self.env
        if self.command is not None:
            self._ask(*self.command)
            self._obs = env.observe()
        commanded = env.command[:, 0].cpu()
        self._obs, _, terminated, truncated, info = env.step(self.actor.act(self._obs))
        self.actor.reset(terminated | truncated)
        self.falls += terminated.cpu()
        forward, under_way = info.speed.cpu(), (self.falls == 0) & ~self._arrived
        self._distance += forward * env.dt * under_way
        self._commanded += commanded * env.dt * under_way
        self._time += env.dt * under_way
        self._arrived |= info.success.cpu()
        self.speed += (forward - self.speed) * (env.dt / _SMOOTHING)

    def _ask(self, vx: float, vy: float, yaw_rate: float) -> None:
        env = self.env
        env.command[:, 0], env.command[:, 1] = vx, vy
        if env.goals is not None:
            return
        env.command[:, 2] = yaw_rate
        # where a heading to keep gives the yaw rate, the one that gives this
        yaw = yaw_of(env.sim.qpos[:, 3:7].float())
        env.commands.heading[:] = yaw + yaw_rate / env.task.command.heading_gain

    def qpos(self, robot: int) -> Array:
        """Present generalised position of a robot, (19,)."""
        return self.env.sim.qpos[robot].double().cpu().numpy()

    def score(self) -> Score:
        """How the robots did since the start."""
        time = self._time.clamp(min=self.env.dt)
        return Score(
            (self.falls == 0).numpy(),
            self._distance.numpy(),
            (self._distance / time).numpy(),
            (self._commanded / time).numpy(),
        )

    def caption(self, robot: int) -> list[str]:
        """A few numbers about a robot, one line each."""
        env = self.env
        vx, vy, yaw_rate = (_two_digits(value) for value in env.command[robot].tolist())
        lines = [f"{_two_digits(float(self.speed[robot]))} m/s", f"asked {vx}, {vy} m/s, {yaw_rate} rad/s"]
        kind = env.terrain.kinds[env.curriculum.column[robot]]
        if kind != "flat":
            lines.append(f"{kind.replace('_', ' ')}, difficulty {env.terrain.difficulty[0]:.2f}")
        return lines

    def course(self, robot: int) -> tuple[Array, int]:
        """Waypoints of a robot, world, (k, 3), m, and how many of them it has reached."""
        goals = self.env.goals
        if goals is None:
            return np.zeros((0, 3)), 0
        return goals.course[robot].double().cpu().numpy(), int(goals.index[robot])

    def depth(self, robot: int) -> NDArray[np.uint8] | None:
        """What the depth camera of a robot sees, near bright, (H, W); None without a camera."""
        if self.env.task.camera is None:
            return None
        return (255 * (0.5 - self.env.depth[robot])).byte().cpu().numpy()


def _two_digits(value: float) -> str:
    """Without a minus before a zero."""
    return f"{round(value, 2) + 0.0:.2f}"
