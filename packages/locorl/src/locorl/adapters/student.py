"""LeggedEnv as an environment that a student is trained and judged in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from locorl.bodies.family import BodyFamily
from locorl.env.legged_env import LeggedEnv
from locorl.interfaces import Array

if TYPE_CHECKING:
    from locorl.play.renderer import RobotCamera

_FEW = 6
"""Different bodies that are told apart one by one."""
_SIZES = ("1: shorter legs", "2: middling legs", "3: longer legs")


class Measures(NamedTuple):
    """What a step tells of the robots' task.

    Attributes:
        tracking_error: |speed along the commanded way - commanded speed|, (N,), m/s.
        success: robots that reached their last waypoint in this step, (N,) bool; None on a task without waypoints.
    """

    tracking_error: Tensor
    success: Tensor | None


class StudentEnv:
    """N robots, with all that a comparison of student and teacher asks for: groups of robots, and pictures.

    Args:
        env: the robots; the adapter steps and resets it.
        spread: whether `reset` puts the robots evenly on all tiles of the map, instead of where the curriculum starts
            them: what a student is not shown, it is not taught, and its teacher has climbed the levels already.

    Attributes:
        env: the same.
    """

    def __init__(self, env: LeggedEnv, spread: bool = True) -> None:
        self.env = env
        self._spread = spread
        self._camera: tuple[int, RobotCamera] | None = None

    @property
    def num_envs(self) -> int:
        """N."""
        return self.env.num_envs

    @property
    def device(self) -> torch.device:
        """Where the tensors live."""
        return self.env.device

    @property
    def group_dims(self) -> Mapping[str, int]:
        """Columns of each observation group."""
        return self.env.group_dims

    @property
    def control_dt(self) -> float:
        """Control period, s."""
        return self.env.dt

    @property
    def signature(self) -> dict[str, object]:
        """What the robots must have in common with those that a policy was trained on: name -> value."""
        factory = self.env.factory
        family = BodyFamily.of(factory).signature
        return {"robot": factory.name, "design": tuple(factory.space.names), **family, **self.env.task.interface}

    def reset(self, seed: int | None = None) -> dict[str, Tensor]:
        """Start every robot, the cameras and the curriculum afresh; None draws a seed. Returns the observation."""
        if seed is None:
            draw = torch.randint(2**31, (), generator=self.env.generator, device=self.env.device)
            seed = int(draw)
        obs = self.env.reset(seed)
        if not self._spread:
            return obs
        levels, columns = self.env.terrain.obstacle.shape
        robot = torch.arange(self.num_envs, device=self.device)
        return self.env.reset_on(robot // columns % levels, robot % columns)

    def step(self, action: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, Measures]:
        """Advance one control period; see `LeggedEnv.step`."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        success = None if self.env.goals is None else info.success
        return obs, reward, terminated, truncated, Measures(info.tracking_error, success)

    def groups(self) -> dict[str, list[str]]:
        """The kind of terrain and the body of each robot: "terrain" and "body" -> N names.

        More than six different bodies make three groups of equally many, by their mean leg scale.
        """
        terrain = self.env.terrain
        column = self.env.curriculum.column.tolist()
        names = self.env.factory.space.names
        return {
            "terrain": [terrain.kinds[each].replace("_", " ") for each in column],
            "body": _body_groups(np.asarray(self.env.bodies.designs), names),
        }

    def picture(self, robot: int, width: int, height: int) -> NDArray[np.uint8]:
        """A robot now, with the waypoints of its course, (height, width, 3).

        Raises:
            PlayError: there is no OpenGL, or a package of the extra `play` is missing.
        """
        from locorl.play.renderer import RobotCamera

        env = self.env
        if self._camera is None or self._camera[0] != robot:
            if self._camera is not None:
                self._camera[1].close()
            self._camera = robot, RobotCamera(env.sim.model_of(robot), width, height, env.dt)
        marks, reached = np.zeros((0, 3)), 0
        if env.goals is not None:
            marks, reached = env.goals.course[robot].double().cpu().numpy(), int(env.goals.index[robot])
        return self._camera[1].draw(env.sim.qpos[robot].double().cpu().numpy(), marks, reached).copy()


def _body_groups(designs: Array, names: tuple[str, ...]) -> list[str]:
    different = np.unique(designs, axis=0)
    if len(different) <= _FEW:
        return [", ".join(f"{name} {value:g}" for name, value in zip(names, row, strict=True)) for row in designs]
    order = np.argsort(np.argsort(designs.mean(axis=1), kind="stable"), kind="stable")
    return [_SIZES[min(len(_SIZES) - 1, len(_SIZES) * place // len(designs))] for place in order.tolist()]
