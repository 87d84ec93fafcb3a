"""Weights and shapes of the reward terms: our default, Table I of the paper, the authors' released code."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class RewardConfig:
    """One weight per term, per second, under the term's name; a weight of 0 leaves the term out.

    The defaults are ours, chosen so that a policy walks on a thousand bodies within minutes on a CPU.
    `table_i` gives the paper's sets, `released_code` that of the authors' program.
    """

    linear_velocity_tracking: float = 2.0
    angular_velocity_tracking: float = 1.0
    collisions: float = -1.0
    linear_velocity_penalty: float = -1.0
    angular_velocity_penalty: float = -0.02
    action_rate: float = -0.01
    hip_position_penalty: float = -0.5
    joint_acceleration: float = -2.5e-7
    joint_position_penalty: float = -0.04
    torque_rate: float = -1e-7
    torque_penalty: float = -1e-5
    feet_air_time: float = 5.0
    goal_tracking: float = 0.0
    clearance: float = 0.0
    orientation: float = 0.0
    heading_tracking: float = 0.0
    """Yaw towards the waypoint; not in Table I, in the authors' released code."""
    stumble: float = 0.0
    """A foot pushed sideways; not in Table I, in the authors' released code."""
    progress: float = 1.0
    """Velocity along the commanded direction, up to the commanded speed (m/s): far from a fast command, where the
    tracking kernels are flat, it still says which way to go. Ours."""
    low_swing: float = -0.1
    """Feet that move low above the ground, shuffling or sliding (m/s). Ours."""
    specific_power: float = 0.0
    """Weight of positive mechanical power over body weight (m/s): cost of transport times speed. Ours."""
    fall: float = -1.0
    """Paid once when a robot falls, not per second, and never clipped. Without it, leaning into a fast command and
    falling earns more within the discount's horizon than standing, and training dwells there. Ours."""
    own: tuple[tuple[str, float], ...] = ()
    """Further terms of your own and their weights, each term as `module:function`: a `rewards.terms.Term` that can be
    imported wherever the task is used. See `rewards.terms.find_term`."""
    kernel: Literal["gaussian", "l1"] = "gaussian"
    """Velocity tracking: exp(-|e|^2/s) with s below, or the paper's exp(-|e|_1)."""
    linear_scale: float = 0.15
    """s of the linear velocity kernel, (m/s)^2."""
    angular_scale: float = 0.25
    """s of the angular velocity kernel, (rad/s)^2."""
    air_time_offset: float = 0.15
    """Seconds in the air that earn nothing; the paper's is 0.5."""
    air_time_cap: float | None = 0.4
    """Air time beyond this earns no more, s; None, as in the paper, for no limit."""
    air_time_command: float = 0.1
    """Air time counts only beyond this commanded speed, m/s; 0 counts always, as the paper does."""
    swing_height: float = 0.06
    """Rise of a foot, m, at which its motion is no longer low."""
    normalise_goal_velocity: bool = False
    """Whether goal tracking is divided by the commanded speed, as in the authors' released code."""
    clip_at_zero: bool = True
    """Whether the sum of all terms is clipped at 0; the paper does not say, Table I has no clipping."""


def table_i(task: Literal["locomotion", "parkour"] = "locomotion") -> RewardConfig:
    """Table I of the paper to the letter: twelve terms for each of its two tasks.

    What the print leaves open, we read so: the sum of the weighted terms is multiplied by the control period
    and not clipped; what each equation means is said at its term.

    On a CPU budget the locomotion set teaches standing still: standing earns most of what walking does.

    Raises:
        ValueError: the table has no such task.
    """
    if task == "locomotion":
        return RewardConfig(
            linear_velocity_tracking=1.0,
            collisions=-1.0,
            angular_velocity_tracking=0.5,
            linear_velocity_penalty=-2.0,
            angular_velocity_penalty=-0.05,
            action_rate=-0.01,
            hip_position_penalty=-0.5,
            joint_acceleration=-2.5e-7,
            joint_position_penalty=-0.04,
            torque_rate=-1e-7,
            torque_penalty=-1e-5,
            feet_air_time=1.0,
            kernel="l1",
            air_time_offset=0.5,
            air_time_cap=None,
            air_time_command=0.0,
            progress=0.0,
            low_swing=0.0,
            fall=0.0,
            clip_at_zero=False,
        )
    if task == "parkour":
        return replace(
            table_i("locomotion"),
            linear_velocity_tracking=0.0,
            collisions=0.0,
            feet_air_time=0.0,
            goal_tracking=1.5,
            clearance=-1.0,
            linear_velocity_penalty=-1.0,
            action_rate=-0.1,
            orientation=-1.0,
        )
    raise ValueError(f"Table I has the tasks 'locomotion' and 'parkour', not '{task}'")


def released_code(flat: bool = False) -> RewardConfig:
    """Reward of the authors' released code, which has the parkour task only, where it differs from Table I.

    It tracks the heading where the table prints a yaw rate, divides the goal velocity by the commanded speed,
    punishes collisions and stumbling, and clips the sum at 0. It counts feet near edges only on the harder
    half of its terrain levels, which no weight can express: here they count everywhere.

    Args:
        flat: the weights on flat ground, where they differ.
    """
    return replace(
        table_i("parkour"),
        angular_velocity_tracking=0.0,
        heading_tracking=0.5,
        normalise_goal_velocity=True,
        collisions=-10.0,
        stumble=-1.0,
        # jumping takes vertical velocity and pitch, so obstacles halve one and drop the other
        linear_velocity_penalty=-1.0 if flat else -0.5,
        orientation=-1.0 if flat else 0.0,
        clip_at_zero=True,
    )
