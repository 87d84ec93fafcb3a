"""Entry points through which other packages' commands find environments, bodies and teachers."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from locorl.bodies import sample_designs
from locorl.env import LeggedEnv
from locorl.interfaces import BodyFactory
from locorl.policy import Policy, load_policy
from locorl.task import TaskConfig


def find_factory(robot: str) -> BodyFactory:
    """The body factory that an installed package registers under `robot` (entry point group `legged.bodies`).

    Raises:
        LookupError: no installed package knows the robot; the message says what to install.
    """
    known = {point.name: point for point in entry_points(group="legged.bodies")}
    if robot not in known:
        names = ", ".join(sorted(known)) or "none"
        raise LookupError(
            f"no robot '{robot}' (installed: {names}); legged-morphgen provides go2: pip install legged-morphgen"
        )
    return known[robot].load()()


def load_teacher(path: Path) -> Policy:
    """A trained policy as a teacher for distillation (entry point group `legged.teachers`)."""
    return load_policy(path)


def make_env(
    robot: str = "go2", num_envs: int = 256, design: tuple[float, ...] | None = None, seed: int = 0
) -> LeggedEnv:
    """The locomotion environment (entry point group `legged.envs`): one body, or random ones without `design`."""
    factory = find_factory(robot)
    if design is None:
        designs = sample_designs(factory, num_envs, np.random.default_rng(seed))
    else:
        designs = np.tile(np.asarray(design, dtype=np.float64), (num_envs, 1))
    return LeggedEnv(factory, designs, TaskConfig(), seed=seed)
