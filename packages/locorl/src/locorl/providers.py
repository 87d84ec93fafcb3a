"""Entry points through which other packages' commands find environments, bodies and teachers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from locorl.adapters.student import StudentEnv
from locorl.adapters.vision import VisionEnv, with_camera
from locorl.bodies.designs import repeat_design, sample_designs
from locorl.env.depth_camera import DepthConfig
from locorl.env.legged_env import LeggedEnv
from locorl.evaluation.evaluate import EvalConfig, walking_protocol
from locorl.interfaces import BodyFactory
from locorl.learning.policy import Policy, load_policy
from locorl.simulation.make import SimulatorConfig
from locorl.tasks import Preset, TaskConfig, make_task

_RESET_JOINT = 0.1
"""Half-width of joint deviations at the start of a judged episode, rad: no two are the same."""


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
    design: Sequence[float] | None = None,
    seed: int = 0,
    task: str = "locomotion-flat",
    preset: Preset = "laptop",
    terrain: Sequence[str] = (),
    policy: str | None = None,
    history: int = 0,
    vx: tuple[float, float] | None = None,
    terrain_seed: int | None = None,
    spread: bool = True,
    device: str = "cpu",
) -> StudentEnv:
    """Robots on one of `locorl.tasks.TASKS`, to train and judge a student with.

    Args:
        robot: see `find_factory`.
        num_envs: N.
        design: the body of all of them; None draws one for each.
        seed: of bodies and environment.
        task: see `make_task`.
        preset: likewise.
        terrain: kinds of terrain to take instead of the task's, as many columns of the map.
        policy: path of a policy or checkpoint; task and preset are those that it was trained on.
        history: past frames of proprioception in the observation group `history`.
        vx: lowest and highest forward command, m/s: the walking protocol, to judge by (see `EvalConfig`): no noise, no
            pushes, one command for each robot; None leaves the task as it is trained on.
        terrain_seed: of the map, to judge on ground that no training has seen; None keeps the task's.
        spread: see `StudentEnv`.
        device: `cuda` or `cuda:1` simulates there, on MuJoCo Warp.
    """
    config = _task(task, preset, terrain, policy, history, vx, terrain_seed)
    return StudentEnv(_robots(robot, num_envs, design, seed, config, device), spread)


def locomotion(**options: Any) -> StudentEnv:
    """Robots that are told how fast to go: `locomotion-flat` unless `task` says otherwise; see `make_env`."""
    return make_env(**options)


def parkour(**options: Any) -> StudentEnv:
    """Robots on obstacle courses: Lite3 on `parkour-mixed` unless `robot` and `task` say otherwise; see `make_env`."""
    return make_env(**{"robot": "lite3", "task": "parkour-mixed", **options})


def parkour_depth(
    robot: str = "lite3",
    num_envs: int = 128,
    design: Sequence[float] | None = None,
    seed: int = 0,
    task: str = "parkour-mixed",
    preset: Preset = "laptop",
    terrain: Sequence[str] = (),
    policy: str | None = None,
    history: int = 0,
    vx: tuple[float, float] | None = None,
    terrain_seed: int | None = None,
    spread: bool = True,
    rows: int = 24,
    columns: int = 36,
    device: str = "cpu",
) -> VisionEnv:
    """Robots with depth cameras on obstacle courses.

    Args:
        robot: see `make_env`, as everything down to `spread`.
        num_envs: N.
        design: of all of them.
        seed: of bodies and environment.
        task: one with waypoints.
        preset: of the task.
        terrain: kinds of terrain.
        policy: whose task to take.
        history: past frames of proprioception.
        vx: of the walking protocol.
        terrain_seed: of the map.
        spread: over all tiles.
        rows: height of an image, px; the reference implementation has 58.
        columns: its width, px; there 87.
        device: see `make_env`.
    """
    config = _task(task, preset, terrain, policy, history, vx, terrain_seed)
    config = with_camera(config, replace(DepthConfig.small(), rows=rows, columns=columns), history)
    return VisionEnv(_robots(robot, num_envs, design, seed, config, device), spread)


def _task(
    task: str,
    preset: Preset,
    terrain: Sequence[str],
    policy: str | None,
    history: int,
    vx: tuple[float, float] | None,
    terrain_seed: int | None,
) -> TaskConfig:
    config = make_task(task, preset) if policy is None else load_policy(Path(policy)).card.task
    if terrain:
        config = config.on(terrain)
    if terrain_seed is not None:
        config = replace(config, terrain=replace(config.terrain, seed=terrain_seed))
    if vx is not None:
        slowest, fastest = vx
        config = walking_protocol(config, EvalConfig(vx=(slowest, fastest), reset_joint=_RESET_JOINT))
    return replace(config, observation=replace(config.observation, history=history))


def _robots(
    robot: str, num_envs: int, design: Sequence[float] | None, seed: int, task: TaskConfig, device: str
) -> LeggedEnv:
    factory = find_factory(robot)
    if design is None:
        designs = sample_designs(factory, num_envs, np.random.default_rng(seed))
    else:
        designs = repeat_design(factory, np.asarray(design, dtype=np.float64), num_envs)
    simulator = SimulatorConfig("cpu" if device == "cpu" else "warp", device)
    return LeggedEnv(factory, designs, task, seed=seed, simulator=simulator)
