"""Reward terms of the locomotion task: Table I of the paper and the sharper set that a CPU budget needs.

Each term is a function of one `StepState` and returns (N,); weights are multiplied by the control period.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Literal

import torch
from torch import Tensor


@dataclass
class StepState:
    """What the reward terms see of N robots after one control step. Vectors are in the base frame.

    Attributes:
        velocity: linear velocity of the base, (N, 3), m/s.
        rate: angular velocity of the base, (N, 3), rad/s.
        command: vx, vy (m/s) and yaw rate (rad/s), (N, 3).
        q_error: joint positions minus the stance, (N, 12), rad.
        joint_acceleration: (N, 12), rad/s^2, finite difference over the control period.
        action: this action, (N, 12).
        last_action: the one before.
        torque: (N, 12), N m.
        last_torque: one control step earlier.
        landed_air_time: seconds that a foot was in the air before it touched down in this step, (N, 4).
        landed: feet that touched down in this step, (N, 4), 0 or 1.
        colliding_links: number of links other than feet that touch something, (N,).
        specific_power: positive mechanical power over the weight, (N,), m/s.
    """

    velocity: Tensor
    rate: Tensor
    command: Tensor
    q_error: Tensor
    joint_acceleration: Tensor
    action: Tensor
    last_action: Tensor
    torque: Tensor
    last_torque: Tensor
    landed_air_time: Tensor
    landed: Tensor
    colliding_links: Tensor
    specific_power: Tensor


@dataclass(frozen=True)
class RewardConfig:
    """Weights and shapes of the reward terms; a weight of 0 leaves the term out.

    The defaults are ours, chosen so that a policy walks on a thousand bodies within minutes on a CPU.
    `table_i()` gives the paper's.
    """

    linear_velocity: float = 2.0
    angular_velocity: float = 1.0
    collisions: float = -1.0
    vertical_velocity: float = -1.0
    roll_pitch_rate: float = -0.02
    action_rate: float = -0.01
    hip_position: float = -0.5
    joint_acceleration: float = -2.5e-7
    joint_position: float = -0.04
    torque_rate: float = -1e-7
    torque: float = -1e-5
    air_time: float = 5.0
    specific_power: float = 0.0
    """Weight of positive mechanical power over body weight (m/s): cost of transport times speed. Ours."""
    kernel: Literal["gaussian", "l1"] = "gaussian"
    """exp(-|e|^2/s) with s below, or the paper's exp(-|e|_1)."""
    linear_scale: float = 0.15
    """s of the linear velocity kernel, (m/s)^2."""
    angular_scale: float = 0.25
    """s of the angular velocity kernel, (rad/s)^2."""
    air_time_offset: float = 0.15
    """Seconds in the air that earn nothing; the paper's is 0.5."""
    air_time_cap: float = 0.4
    """Air time beyond this earns no more, s; infinite in the paper."""
    clip_at_zero: bool = True
    """Whether the sum of all terms is clipped at 0; the paper does not say, Table I has no clipping."""


def table_i() -> RewardConfig:
    """Table I of the paper, quadruped locomotion, to the letter.

    On a CPU budget this set teaches standing still: standing earns most of what walking does.
    """
    return RewardConfig(
        linear_velocity=1.0,
        angular_velocity=0.5,
        vertical_velocity=-2.0,
        roll_pitch_rate=-0.05,
        kernel="l1",
        air_time=1.0,
        air_time_offset=0.5,
        air_time_cap=float("inf"),
        clip_at_zero=False,
    )


def _kernel(error: Tensor, scale: float, config: RewardConfig) -> Tensor:
    if config.kernel == "l1":
        return torch.exp(-error.abs().sum(dim=1))
    return torch.exp(-error.square().sum(dim=1) / scale)


def linear_velocity(state: StepState, config: RewardConfig) -> Tensor:
    """Linear velocity tracking: exp(-|v_xy - v_cmd|_1), or the Gaussian kernel."""
    return _kernel(state.velocity[:, :2] - state.command[:, :2], config.linear_scale, config)


def angular_velocity(state: StepState, config: RewardConfig) -> Tensor:
    """Angular velocity tracking: exp(-|w_z - w_cmd|), or the Gaussian kernel."""
    return _kernel(state.rate[:, 2:] - state.command[:, 2:], config.angular_scale, config)


def collisions(state: StepState, _: RewardConfig) -> Tensor:
    """Collisions: number of links other than feet that touch something."""
    return state.colliding_links


def vertical_velocity(state: StepState, _: RewardConfig) -> Tensor:
    """Linear velocity penalty: v_z^2."""
    return state.velocity[:, 2].square()


def roll_pitch_rate(state: StepState, _: RewardConfig) -> Tensor:
    """Angular velocity penalty: |w_xy|^2."""
    return state.rate[:, :2].square().sum(dim=1)


def action_rate(state: StepState, _: RewardConfig) -> Tensor:
    """Action rate: |a_t - a_(t-1)|_2."""
    return (state.action - state.last_action).norm(dim=1)


def hip_position(state: StepState, _: RewardConfig) -> Tensor:
    """Hip position penalty: squared deviation of the 4 abduction joints from the stance."""
    return state.q_error[:, ::3].square().sum(dim=1)


def joint_acceleration(state: StepState, _: RewardConfig) -> Tensor:
    """Joint acceleration: |ddq|^2."""
    return state.joint_acceleration.square().sum(dim=1)


def joint_position(state: StepState, _: RewardConfig) -> Tensor:
    """Joint position penalty: |q - q_init|^2, q_init being the body's own stance."""
    return state.q_error.square().sum(dim=1)


def torque_rate(state: StepState, _: RewardConfig) -> Tensor:
    """Torque rate: |tau_t - tau_(t-1)|^2."""
    return (state.torque - state.last_torque).square().sum(dim=1)


def torque(state: StepState, _: RewardConfig) -> Tensor:
    """Torque penalty: |tau|^2."""
    return state.torque.square().sum(dim=1)


def air_time(state: StepState, config: RewardConfig) -> Tensor:
    """Feet air time: sum over feet of (t_air - offset), at touch-down, while a velocity is commanded."""
    gain = (state.landed_air_time.clamp(max=config.air_time_cap) - config.air_time_offset) * state.landed
    return gain.sum(dim=1) * (state.command[:, :2].norm(dim=1) > 0.1)


def specific_power(state: StepState, _: RewardConfig) -> Tensor:
    """Positive mechanical power over body weight, m/s (not in Table I)."""
    return state.specific_power


TERMS: Mapping[str, Callable[[StepState, RewardConfig], Tensor]] = {
    term.__name__: term
    for term in (
        linear_velocity,
        angular_velocity,
        collisions,
        vertical_velocity,
        roll_pitch_rate,
        action_rate,
        hip_position,
        joint_acceleration,
        joint_position,
        torque_rate,
        torque,
        air_time,
        specific_power,
    )
}
"""Every term by the name of its weight in `RewardConfig`."""


def active_terms(config: RewardConfig) -> dict[str, float]:
    """Weights that are not zero, by term."""
    weights = {field.name: getattr(config, field.name) for field in fields(config) if field.name in TERMS}
    return {name: float(weight) for name, weight in weights.items() if weight != 0.0}


def total_reward(state: StepState, config: RewardConfig, dt: float) -> tuple[Tensor, dict[str, Tensor]]:
    """Sum of all active terms for one control step.

    Args:
        state: the N robots after the step.
        config: weights and shapes.
        dt: control period, s, by which every weight is multiplied.

    Returns:
        The reward (N,), and each term's weighted share, name -> (N,).
    """
    parts = {name: TERMS[name](state, config) * (weight * dt) for name, weight in active_terms(config).items()}
    reward = torch.stack(tuple(parts.values())).sum(dim=0)
    return (reward.clamp(min=0.0) if config.clip_at_zero else reward), parts
