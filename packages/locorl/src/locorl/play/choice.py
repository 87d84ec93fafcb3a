"""What is played: which robot with which body, moved by what, on which task and level."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from locorl.bodies.designs import repeat_design, sample_designs
from locorl.env.depth_camera import DepthConfig
from locorl.env.randomisation import no_randomisation
from locorl.evaluation.evaluate import Actor
from locorl.interfaces import Array, BodyFactory
from locorl.learning.policy import Policy
from locorl.play.actors import make_actor
from locorl.play.session import Command, Session
from locorl.providers import find_factory
from locorl.tasks import Preset, TaskConfig, make_task
from locorl.terrain.curriculum import CurriculumConfig

_FOREVER = 1e6
"""Seconds that no one watches for."""
_ROWS = 3
"""Tiles of the level that follow each other."""


@dataclass(frozen=True)
class Choice:
    """A selection, as made on the command line or in the browser.

    Attributes:
        robot: an installed robot, or the path of a .urdf.
        policy: `stand`, `random`, or the path of a policy.
        adopt: whether a policy is taken that was trained on bodies with other rules or gains.
        task: name of a task; None for that of the policy, or `locomotion-flat`.
        preset: of the task.
        level: of the terrain; 0 is the easiest. Flat ground has no levels.
        design: of the robot; None for the nominal body, or random ones if there are several.
        bodies: number of robots.
        command: vx, vy (m/s), yaw rate (rad/s); None leaves it to the task.
        camera: whether robots of a task without a depth camera get the small one.
        seed: of everything random.
    """

    robot: str = "go2"
    policy: str = "stand"
    task: str | None = None
    preset: Preset = "laptop"
    level: int = 3
    design: tuple[float, ...] | None = None
    bodies: int = 1
    command: Command | None = None
    camera: bool = False
    seed: int = 0
    adopt: bool = False

    def start(self) -> Session:
        """Robots ready to play.

        Raises:
            ValueError: something does not exist or does not fit; the message says what.
            LookupError: no installed package knows the robot.
            CheckpointError: the policy cannot be read.
        """
        if self.command is not None and not np.isfinite(self.command).all():
            raise ValueError(f"a command is three finite numbers: forward, left, turn; got {self.command}")
        actor = make_actor(self.policy, self.seed)
        factory = find_factory(self.robot)
        if self.adopt and isinstance(actor, Policy):
            actor = actor.adopted(factory)
        task = at_level(calm(self._task(actor)), self.level)
        if self.camera and task.camera is None:
            task = replace(task, camera=DepthConfig.small())
        return Session(factory, self.designs(factory), task, actor, self.command, self.seed)

    @property
    def levels(self) -> int:
        """Number of levels of the terrain."""
        return _levels(self._task(make_actor(self.policy)))

    def _task(self, actor: Actor) -> TaskConfig:
        if self.task is None and isinstance(actor, Policy):
            return actor.card.task
        return make_task(self.task or "locomotion-flat", self.preset)

    def designs(self, factory: BodyFactory) -> Array:
        """One design per robot, (bodies, d).

        Raises:
            ValueError: there is no such body.
        """
        if self.bodies < 1:
            raise ValueError(f"there must be at least one robot, got {self.bodies}")
        if self.design is None and self.bodies > 1:
            return sample_designs(factory, self.bodies, np.random.default_rng(self.seed))
        design = factory.space.nominal if self.design is None else np.array(self.design)
        return repeat_design(factory, design, self.bodies)


def calm(task: TaskConfig) -> TaskConfig:
    """The task with nominal friction and exact starts, without disturbances, in episodes that only a fall ends."""
    return replace(task, episode_seconds=_FOREVER, randomisation=no_randomisation())


def at_level(task: TaskConfig, level: int) -> TaskConfig:
    """The task on a map whose every tile is of `level`, so that nobody leaves it.

    Raises:
        ValueError: the terrain has no such level.
    """
    terrain, levels = task.terrain, _levels(task)
    if levels == 1:
        return task
    if not 0 <= level < levels:
        raise ValueError(f"task '{task.name}' has levels 0 to {levels - 1}, got {level}")
    low, high = terrain.difficulty
    difficulty = low + (high - low) * level / (levels - 1)
    return replace(
        task,
        terrain=replace(terrain, levels=_ROWS, difficulty=(difficulty, difficulty)),
        curriculum=CurriculumConfig(start_level=0),
    )


def _levels(task: TaskConfig) -> int:
    return 1 if set(task.terrain.kinds) == {"flat"} else task.terrain.levels
