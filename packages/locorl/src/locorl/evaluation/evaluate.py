"""Honest evaluation: return never without tracking error, distance, survival and energy beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from locorl.env.commands import CommandConfig
from locorl.env.legged_env import LeggedEnv
from locorl.env.randomisation import no_randomisation
from locorl.evaluation.gait import Gait, GaitMeter, sole_height
from locorl.evaluation.legs import Legs
from locorl.interfaces import Array, BodyFactory
from locorl.simulation.make import SimulatorConfig
from locorl.tasks.task import TaskConfig


class Actor(Protocol):
    """Anything that acts on observations; one with a memory forgets it at `reset`."""

    def reset(self, done: Tensor | None = None) -> None:
        """Forget; everything, or only robots where `done` (N,)."""
        ...

    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        """Action for each robot, (N, 12)."""
        ...


@dataclass(frozen=True)
class EvalConfig:
    """The walking protocol: mean action, no noise, no pushes, forward commands."""

    seconds: float = 20.0
    """Length of an episode."""
    vx: tuple[float, float] = (0.3, 0.8)
    """Commanded forward speed, m/s, drawn uniformly per robot; lateral and yaw commands are 0."""
    settle: float = 2.0
    """Tracking error and energy count from here on, s."""
    robots_per_body: int = 1
    reset_joint: float = 0.0
    """Half-width of joint deviations at the start, rad: makes repeated robots differ."""
    seed: int = 0
    """Same seed, same commands and starts, whatever the bodies: common random numbers."""
    level: int | None = None
    """Level of the terrain; None spreads the robots of each body evenly over all levels."""

    def __post_init__(self) -> None:
        """Refuse an episode without anything to measure."""
        if not 0.0 <= self.settle < self.seconds or self.robots_per_body < 1:
            raise ValueError(f"EvalConfig: need 0 <= settle < seconds and robots_per_body >= 1, got {self}")


@dataclass(frozen=True)
class Course:
    """What the robots of a parkour task were up against; arrays are (B, R).

    Attributes:
        obstacle: size of the obstacles, m (see `terrain.tile.Tile`).
        hip_height: of the robot in its stance, m.
        length: from the start along all waypoints, m.
        kind: of terrain, by name.
    """

    obstacle: Array
    hip_height: Array
    length: Array
    kind: NDArray[np.str_]


@dataclass(frozen=True)
class Evaluation:
    """Results for B bodies and R robots on each; arrays are (B, R) unless said otherwise.

    Attributes:
        designs: (B, d).
        config: the protocol.
        command: commanded speed, m/s.
        weight: of the robot, N.
        survived: no fall and no failed simulation until the end, bool.
        returns: undiscounted sum of rewards until the end, the fall or the last waypoint (eq. 9).
        tracking_error: mean |v - command| after `settle`, along the commanded way, m/s; a fallen robot counts its
            whole command, one that is through with its course nothing more.
        distance: way along the commanded direction in the base frame, or towards the waypoints, m.
        energy: positive joint work, J, accumulated at every physics step (eq. 10 times the time step).
        cost_of_transport: positive joint work / (m g way), both after `settle`; infinite without a way.
        mean_power: positive mechanical power after `settle`, W, while upright and under way.
        succeeded: last waypoint reached, bool, where it ends the episode; None on a task without waypoints.
        gait: how the robots walked after `settle`, while upright and under way.
        course: what they were up against; None on a task without waypoints.
    """

    designs: Array
    config: EvalConfig
    command: Array
    weight: Array
    survived: NDArray[np.bool_]
    returns: Array
    tracking_error: Array
    distance: Array
    energy: Array
    cost_of_transport: Array
    mean_power: Array
    succeeded: NDArray[np.bool_] | None = None
    gait: Gait | None = None
    course: Course | None = None

    @property
    def through(self) -> NDArray[np.bool_]:
        """Robots that did what they were to: came through the course, or did not fall, (B, R)."""
        return self.survived if self.succeeded is None else self.succeeded

    @property
    def commanded_distance(self) -> Array:
        """Way that each robot was to come, (B, R), m; a course is not longer than to its last waypoint."""
        way = self.command * self.config.seconds
        return way if self.course is None else np.minimum(way, self.course.length)

    def summary(self) -> dict[str, float]:
        """Means over all robots; cost of transport and gait over those that survived and got somewhere."""
        moving = self.survived & np.isfinite(self.cost_of_transport)
        gait = {}
        if self.gait is not None:
            walked = moving & np.isfinite(self.gait.slip)
            gait = {
                name: float(values[walked].mean()) if walked.any() else float("nan")
                for name, values in (
                    ("foot_clearance", self.gait.clearance),
                    ("slip", self.gait.slip),
                    ("duty_factor", self.gait.duty_factor),
                )
            }
        return {
            "robots": float(self.survived.size),
            "survived": float(self.survived.sum()),
            **({} if self.succeeded is None else {"succeeded": float(self.succeeded.sum())}),
            "return": float(self.returns.mean()),
            "tracking_error": float(self.tracking_error.mean()),
            "tracking_error_worst_decile": float(np.quantile(self.tracking_error, 0.9)),
            "tracking_error_worst": float(self.tracking_error.max()),
            "distance": float(self.distance.mean()),
            "commanded_distance": float(self.commanded_distance.mean()),
            "energy": float(self.energy.mean()),
            "cost_of_transport": float(self.cost_of_transport[moving].mean()) if moving.any() else float("inf"),
            **gait,
        }


def walking_protocol(task: TaskConfig, config: EvalConfig) -> TaskConfig:
    """The task as it is evaluated: one command for each robot, nothing random but the starts."""
    command = CommandConfig(config.vx, (0.0, 0.0), (0.0, 0.0), hold=2 * config.seconds, standing=0.0)
    calm = replace(no_randomisation(), reset_joint=config.reset_joint, reset_yaw=task.randomisation.reset_yaw)
    steered = replace(command, yaw_rate=task.command.yaw_rate, heading_gain=task.command.heading_gain)
    if task.goals is not None:  # the way to the next waypoint needs turning
        command = steered
    elif task.command.heading is not None:  # straight on
        command, calm = replace(steered, heading=(0.0, 0.0)), replace(calm, reset_yaw=0.0)
    # the episode never ends by time within the evaluation, and no body is spared a level
    curriculum = replace(task.curriculum, hip_limit=None)
    seconds = 2 * config.seconds
    return replace(task, episode_seconds=seconds, command=command, randomisation=calm, curriculum=curriculum)


def _tiles(config: EvalConfig, bodies: int, levels: int, columns: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Level and column of each robot, (B * R,) each: the same for every body.

    Raises:
        ValueError: the map has no such level.
    """
    robot = torch.arange(config.robots_per_body, device=device)
    if config.level is None:
        level = ((robot + 0.5) * levels / config.robots_per_body).long()
    elif 0 <= config.level < levels:
        level = torch.full_like(robot, config.level)
    else:
        raise ValueError(f"EvalConfig: the terrain has levels 0 to {levels - 1}, not {config.level}")
    return level.repeat(bodies), (robot % columns).repeat(bodies)


@torch.no_grad()
def evaluate(
    actor: Actor,
    factory: BodyFactory,
    designs: Array,
    task: TaskConfig,
    config: EvalConfig | None = None,
    threads: int | None = None,
    simulator: SimulatorConfig | None = None,
) -> Evaluation:
    """Run `actor` on bodies `designs` (B, d), `config.robots_per_body` robots on each, for one episode.

    The reward is the task's own, without randomisation, pushes, exploration or curriculum.
    """
    config = config or EvalConfig()
    designs = np.asarray(designs, dtype=np.float64)
    bodies, robots = len(designs), config.robots_per_body
    task = walking_protocol(task, config)
    env = LeggedEnv(
        factory, np.repeat(designs, robots, axis=0), task, seed=config.seed, threads=threads, simulator=simulator
    )
    meter, legs = GaitMeter(sole_height(env, robots), env.dt), Legs(env.sim.model, factory.layout.joints, env.device)
    steps = round(config.seconds / env.dt)
    settle = round(config.settle / env.dt)
    obs = env.reset(seed=config.seed)
    if len(env.terrain.difficulty) > 1:
        levels, columns = env.terrain.obstacle.shape
        obs = env.reset_on(*_tiles(config, bodies, levels, columns, env.device))
    actor.reset()
    asked = env.command[:, 0].clone()
    course = _course(env, (bodies, robots))

    alive = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
    arrived = torch.zeros_like(alive)
    returns, error, way, work = (torch.zeros_like(alive, dtype=torch.float64) for _ in range(4))
    settled_way, settled_work, settled_steps, judged_steps = (torch.zeros_like(returns) for _ in range(4))
    for step in range(steps):
        obs, reward, terminated, truncated, info = env.step(actor.act(obs))
        actor.reset(terminated | truncated)
        # who is through with the course starts another, which is not part of the protocol
        returns += reward * (alive & ~arrived)
        alive = alive & (arrived | ~terminated)
        under_way = alive & ~arrived
        moved = info.speed.double() * env.dt * under_way
        spent = info.positive_work.double() * under_way
        way += moved
        work += spent
        if step >= settle:
            error += torch.where(alive, info.tracking_error, asked.abs()) * ~arrived
            judged_steps += ~arrived
            settled_way += moved
            settled_work += spent
            settled_steps += under_way
            feet = env.sim.foot_position
            ground = env.terrain.heights.at(feet[..., :2].float())
            # who has started anew stands elsewhere
            going = under_way & ~(terminated | truncated)
            rate = legs.foot_rate(env.sim.qpos, env.sim.qvel)
            meter.add(feet, rate, ground, env.contacts.touching, moved, going)
        arrived = arrived | (under_way & info.success)

    def shape(values: Tensor) -> Array:
        return values.double().numpy(force=True).reshape(bodies, robots)

    weight = env.weight.double()
    transport = torch.where(settled_way > 0.05, settled_work / (weight * settled_way), torch.inf)
    return Evaluation(
        designs=designs,
        config=config,
        command=shape(asked),
        weight=shape(weight),
        survived=alive.numpy(force=True).reshape(bodies, robots),
        returns=shape(returns),
        tracking_error=shape(error / judged_steps.clamp(min=1)),
        distance=shape(way),
        energy=shape(work),
        cost_of_transport=shape(transport),
        mean_power=shape(settled_work / (settled_steps * env.dt).clamp(min=env.dt)),
        succeeded=None if env.goals is None else arrived.numpy(force=True).reshape(bodies, robots),
        gait=meter.gait().reshape(bodies, robots),
        course=course,
    )


def _course(env: LeggedEnv, shape: tuple[int, int]) -> Course | None:
    """What the robots of `env` are about to meet, arrays of `shape`; None without waypoints."""
    if env.goals is None:
        return None
    level, column = env.curriculum.level, env.curriculum.column
    points = torch.cat((env.terrain.origins[level, column][:, None], env.goals.course), dim=1)[..., :2]
    length = (points[:, 1:] - points[:, :-1]).norm(dim=-1).sum(dim=1)
    sizes = (env.terrain.obstacle[level, column], env.body.stance_height, length)
    kind = np.array(env.terrain.kinds)[column.cpu().numpy()]
    return Course(*(each.double().cpu().numpy().reshape(shape) for each in sizes), kind=kind.reshape(shape))
