"""Entry points through which other packages' commands find environments, bodies and teachers."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from locorl.bodies.designs import sample_designs
from locorl.env.legged_env import LeggedEnv
from locorl.interfaces import BodyFactory
from locorl.learning.policy import Policy, load_policy
from locorl.tasks import Preset, make_task


def is_file(robot: str) -> bool:
    """Whether a robot is given as the path of a URDF instead of a name."""
    return robot.lower().endswith(".urdf")


def installed_robots() -> tuple[str, ...]:
    """Names that `find_factory` knows, sorted."""
    return tuple(sorted({point.name for point in entry_points(group="legged.bodies")} - {"urdf"}))


def find_factory(robot: str) -> BodyFactory:
    """The body factory of a robot, from an installed package (entry point group `legged.bodies`).

    Args:
        robot: name of an entry point, which is called without arguments; or the path of a URDF, with which the
            entry point `urdf` is called.

    Raises:
        LookupError: no installed package knows the robot or opens URDFs; the message says what to install.
        FileNotFoundError: there is no such file.
    """
    known = {point.name: point for point in entry_points(group="legged.bodies")}
    opener = known.pop("urdf", None)
    if is_file(robot):
        if not Path(robot).is_file():
            raise FileNotFoundError(f"there is no robot file '{robot}'")
        if opener is None:
            raise LookupError(
                f"no installed package opens '{robot}'; legged-morphgen does: pip install legged-morphgen"
            )
        return opener.load()(Path(robot))
    if robot not in known:
        names = ", ".join(sorted(known)) or "none"
        raise LookupError(
            f"no robot '{robot}' (installed: {names}); legged-morphgen provides go2 and lite3, and opens the path of "
            "your .urdf: pip install legged-morphgen"
        )
    return known[robot].load()()


def load_teacher(path: Path) -> Policy:
    """A trained policy as a teacher for distillation (entry point group `legged.teachers`)."""
    return load_policy(path)


def make_env(
    robot: str = "go2",
    num_envs: int = 256,
    design: tuple[float, ...] | None = None,
    seed: int = 0,
    task: str = "locomotion-flat",
    preset: Preset = "laptop",
) -> LeggedEnv:
    """An environment of one of `locorl.tasks.TASKS` (entry point group `legged.envs`).

    Robots have random bodies, or the one of `design`. See `find_factory` for `robot`, `make_task` for the rest.
    """
    factory = find_factory(robot)
    if design is None:
        designs = sample_designs(factory, num_envs, np.random.default_rng(seed))
    else:
        designs = np.tile(np.asarray(design, dtype=np.float64), (num_envs, 1))
    return LeggedEnv(factory, designs, make_task(task, preset), seed=seed)
