"""The tasks by name: locomotion and parkour on each terrain, as the paper has them and as a laptop can."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from locorl.env.commands import CommandConfig
from locorl.env.goals import GoalConfig
from locorl.env.observation import ObservationConfig
from locorl.env.randomisation import RandomisationConfig
from locorl.env.scan import ScanConfig
from locorl.rewards.config import RewardConfig, table_i
from locorl.simulation.scene import PhysicsConfig
from locorl.tasks.task import TaskConfig
from locorl.terrain.curriculum import CurriculumConfig
from locorl.terrain.map import TerrainConfig
from locorl.terrain.tile import LOCOMOTION, PARKOUR

Preset = Literal["laptop", "paper"]

_TERRAINS: Mapping[str, tuple[str, ...]] = {
    "locomotion-flat": ("flat",),
    "locomotion-steps": ("steps_up", "steps_down"),
    "locomotion-hills": ("hills",),
    "locomotion-slope": ("slope_up", "slope_down"),
    "locomotion-rough": ("hills", "steps_up", "steps_up", "steps_down"),
    "parkour-highjump": ("hurdles", "platforms"),
    "parkour-longjump": ("long_jump",),
    "parkour-stones": ("tilted_stones",),
    "parkour-mixed": ("hurdles", "platforms", "long_jump", "tilted_stones"),
}
TASKS = tuple(_TERRAINS)
"""Names of the tasks."""

_PAPER_PHYSICS = PhysicsConfig(timestep=0.005, substeps=4)
_PAPER_RANDOMISATION = RandomisationConfig(
    friction=(0.6, 2.0),
    joint_damping=(1.0, 1.0),
    payload=(0.0, 3.0),
    centre_of_mass=0.2,
    motor_strength=(0.8, 1.2),
    motor_damping=(0.8, 1.2),
    action_delay=(1, 1),
    push=0.5,
    push_interval=8.0,
)
_COURSE_SCAN = ScanConfig(forward=(-0.4, 0.9), sideways=(-0.3, 0.3), spacing=0.1)
"""Finer than the paper's: hurdles may be 10 cm deep, and the edge of a step is where it is."""
_CLIMBING = RewardConfig(
    swing_height=0.1, low_swing=-0.2, clearance=-0.5, collisions=-0.5, linear_velocity_penalty=-0.3
)
"""Feet must rise over what they climb and stay off its edge; climbing takes vertical velocity."""
_PIT_FLOOR = -0.25
"""Base height at which a robot has fallen into a pit, m."""


def make_task(name: str, preset: Preset = "laptop") -> TaskConfig:
    """A task of the paper.

    `laptop` keeps what a policy needs to learn within minutes on a CPU: 100 Hz physics, sharper rewards, a small
    scan, and on courses the easier half of the obstacles. `paper` is section III-A and Table I, with 200 Hz physics,
    50 Hz control and 10 Hz perception; where the paper is silent, the ranges of its authors' released code hold.

    Args:
        name: one of `TASKS`.
        preset: how it is set up.

    Raises:
        ValueError: there is no such task or preset.
    """
    if name not in _TERRAINS:
        raise ValueError(f"there is no task '{name}'; there are {', '.join(TASKS)}")
    if preset not in ("laptop", "paper"):
        raise ValueError(f"there is no preset '{preset}'; there are laptop and paper")
    build = _parkour if name.startswith("parkour") else _locomotion
    return build(name, preset)


def _locomotion(name: str, preset: Preset) -> TaskConfig:
    terrain = _terrain(name, preset)
    if preset == "paper":
        return TaskConfig(
            name=name,
            action_clip=4.8,
            max_tilt=1.5,
            min_height=0.0,
            command=CommandConfig(
                (-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0), hold=10.0, standing=0.0, heading=(-math.pi, math.pi)
            ),
            terrain=terrain,
            observation=_paper_observation("heading_error", "command"),
            reward=table_i("locomotion"),
            randomisation=_PAPER_RANDOMISATION,
            physics=_PAPER_PHYSICS,
        )
    if name == "locomotion-flat":
        return TaskConfig()
    # Half of the paper's range is more than a laptop learns to climb. A training of minutes has few episodes, so they
    # are short, each promotion is a large step, and commands lead straight across the stairs, not around below them.
    return replace(
        TaskConfig(),
        name=name,
        episode_seconds=10.0,
        terrain=replace(terrain, difficulty=(-0.4, 0.35), levels=5),
        command=CommandConfig((0.0, 1.0), (0.0, 0.0), heading=(-math.pi, math.pi)),
        reward=_CLIMBING,
        # the ground under the base jumps by a step's height
        min_height=0.2,
        curriculum=CurriculumConfig(start_level=2),
        observation=ObservationConfig(scan=_COURSE_SCAN),
        randomisation=replace(RandomisationConfig(), reset_position=0.5),
    )


def _parkour(name: str, preset: Preset) -> TaskConfig:
    task = TaskConfig(
        name=name,
        max_tilt=1.5,
        min_height=0.0,
        min_altitude=_PIT_FLOOR,
        end_on_base_contact=False,
        command=CommandConfig((0.3, 0.8), (0.0, 0.0), (-1.0, 1.0), hold=6.0, standing=0.0),
        goals=GoalConfig(),
        terrain=_terrain(name, preset),
    )
    if preset == "paper":
        return replace(
            task,
            action_clip=4.8,
            observation=_paper_observation("heading_error", "next_heading_error", "commanded_speed"),
            reward=table_i("parkour"),
            randomisation=replace(_PAPER_RANDOMISATION, reset_yaw=0.0),
            physics=_PAPER_PHYSICS,
        )
    proprio = (
        "base_angular_velocity",
        "projected_gravity",
        "heading_error",
        "next_heading_error",
        "commanded_speed",
        "joint_position_error",
        "joint_velocity",
        "last_action",
        "foot_contact",
    )
    return replace(
        task,
        max_tilt=math.radians(60.0),
        # the ground under the base jumps by an obstacle's height
        min_height=0.2,
        command=replace(task.command, vx=(0.5, 1.0), yaw_rate=(-1.5, 1.5), heading_gain=2.0),
        terrain=replace(task.terrain, difficulty=(-0.8, 0.4)),
        curriculum=CurriculumConfig(start_level=2, hip_limit=1.5),
        observation=ObservationConfig(proprio=proprio, scan=_COURSE_SCAN),
        # goal tracking is progress along the course
        reward=replace(_CLIMBING, goal_tracking=1.0, progress=0.0),
        randomisation=RandomisationConfig(reset_yaw=math.radians(15.0), reset_position=0.1),
    )


def _terrain(name: str, preset: Preset) -> TerrainConfig:
    kinds = _TERRAINS[name]
    tile = PARKOUR if name.startswith("parkour") else LOCOMOTION
    # every box costs time at every physics step
    return TerrainConfig(kinds=kinds, tile=tile, columns=len(kinds) if preset == "laptop" else None)


def _paper_observation(*way: str) -> ObservationConfig:
    """Section III-A1: angular velocity, orientation angles, the way to go, joint states, the last action, contacts."""
    joints = ("joint_position_error", "joint_velocity", "last_action", "foot_contact")
    proprio = ("base_angular_velocity", "roll_pitch", *way, *joints)
    return ObservationConfig(proprio=proprio, motors=True, scan=ScanConfig(), history=10)
