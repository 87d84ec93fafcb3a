"""Reward terms, one function each, named as in Table I of the paper.

A term maps the robots' `StepState` to (N,), unweighted: tracking terms grow with what is wanted, the others with what
is to be avoided, and have negative weights. Where the print is loose the docstring gives our reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache, reduce
from importlib import import_module

import torch
from torch import Tensor

from locorl.rewards.config import RewardConfig
from locorl.rewards.state import StepState

Term = Callable[[StepState, RewardConfig], Tensor]


def _kernel(error: Iterable[Tensor], scale: float, config: RewardConfig) -> Tensor:
    """exp(-|e|_1) or exp(-|e|^2 / scale) of an error given by its components, (N,) each."""
    if config.kernel == "l1":
        return reduce(torch.add, map(torch.abs, error)).neg_().exp_()
    return reduce(torch.add, map(torch.square, error)).div_(-scale).exp_()


def _square_xy(vector: Tensor) -> Tensor:
    """x^2 + y^2 of (N, 3)."""
    x, y, _ = vector.unbind(1)
    return x.square() + y.square()


# ------------------------------------------------------------------ both tasks


def angular_velocity_tracking(state: StepState, config: RewardConfig) -> Tensor:
    """Angular velocity tracking: exp(-|w_z - w_cmd|), or the Gaussian kernel.

    In parkour too, as Table I prints it: there the commanded yaw rate follows from the heading error.
    """
    return _kernel((state.rate[:, 2] - state.command[:, 2],), config.angular_scale, config)


def linear_velocity_penalty(state: StepState, _: RewardConfig) -> Tensor:
    """Linear velocity penalty: v_z^2 in the base frame."""
    return state.velocity[:, 2].square()


def angular_velocity_penalty(state: StepState, _: RewardConfig) -> Tensor:
    """Angular velocity penalty: |w_xy|^2."""
    return _square_xy(state.rate)


def action_rate(state: StepState, _: RewardConfig) -> Tensor:
    """Action rate: |a_t - a_(t-1)|_2, not squared."""
    return torch.linalg.vector_norm(state.action - state.last_action, dim=1)


def hip_position_penalty(state: StepState, _: RewardConfig) -> Tensor:
    """Hip position penalty: squared deviation of the 4 abduction joints from the stance."""
    return state.q_error[:, ::3].square().sum(dim=1)


def joint_acceleration(state: StepState, _: RewardConfig) -> Tensor:
    """Joint acceleration: |ddq|^2, ddq by finite difference over the control period."""
    return state.joint_acceleration.square().sum(dim=1)


def joint_position_penalty(state: StepState, _: RewardConfig) -> Tensor:
    """Joint position penalty: |q - q_init|^2, q_init being the body's own stance."""
    return state.q_error.square().sum(dim=1)


def torque_rate(state: StepState, _: RewardConfig) -> Tensor:
    """Torque rate: |tau_t - tau_(t-1)|^2, one control period apart."""
    return (state.torque - state.last_torque).square_().sum(dim=1)


def torque_penalty(state: StepState, _: RewardConfig) -> Tensor:
    """Torque penalty: |tau|^2."""
    return state.torque.square().sum(dim=1)


# ------------------------------------------------------------------ locomotion


def linear_velocity_tracking(state: StepState, config: RewardConfig) -> Tensor:
    """Linear velocity tracking: exp(-|v_xy - v_cmd|_1), or the Gaussian kernel."""
    error = state.velocity[:, :2] - state.command[:, :2]
    return _kernel(error.unbind(1), config.linear_scale, config)


def collisions(state: StepState, _: RewardConfig) -> Tensor:
    """Collisions: number of links other than feet that touch something."""
    return state.colliding_links


def feet_air_time(state: StepState, config: RewardConfig) -> Tensor:
    """Feet air time: sum over feet of (t_air - offset).

    Counts once, when the foot touches down: summed at every step, as printed, it would punish standing. With
    `air_time_command` it counts only while a horizontal velocity beyond it is commanded.
    """
    cap = float("inf") if config.air_time_cap is None else config.air_time_cap
    gain = state.landed_air_time.clamp(max=cap).sub_(config.air_time_offset).mul_(state.landed)
    total = gain.sum(dim=1)
    if config.air_time_command > 0.0:
        total.mul_(torch.linalg.vector_norm(state.command[:, :2], dim=1) > config.air_time_command)
    return total


# --------------------------------------------------------------------- parkour


def goal_tracking(state: StepState, config: RewardConfig) -> Tensor:
    """Goal tracking: min(<v, d_w>, v_cmd), velocity towards the next waypoint up to the commanded speed, m/s.

    With `normalise_goal_velocity` it is divided by the commanded speed, or by 0.1 m/s below that.
    """
    speed = torch.linalg.vector_norm(state.command[:, :2], dim=1)
    gain = torch.minimum(torch.linalg.vecdot(state.velocity_world, state.goal_direction), speed)
    return gain / speed.clamp(min=0.1) if config.normalise_goal_velocity else gain


def clearance(state: StepState, _: RewardConfig) -> Tensor:
    """Clearance: number of feet in contact within 5 cm of an edge.

    Table I prints a minus in the equation and another in the weight; we read one penalty.
    """
    return state.edge_feet.sum(dim=1)


def orientation(state: StepState, _: RewardConfig) -> Tensor:
    """Orientation: |g_xy|^2, the squared sine of the tilt; all of g, as printed, would always give 1."""
    return _square_xy(state.gravity)


# ------------------------------------------------------------- not in Table I


def heading_tracking(state: StepState, _: RewardConfig) -> Tensor:
    """Heading tracking of the authors' released code: exp(-|yaw error|) towards the next waypoint."""
    return state.heading_error.abs().neg_().exp_()


def stumble(state: StepState, _: RewardConfig) -> Tensor:
    """Stumbling as in the authors' released code: 1 if on any foot |F_xy| > 4 |F_z|, as at a vertical face."""
    sideways = torch.linalg.vector_norm(state.foot_force[..., :2], dim=2)
    return (sideways > 4.0 * state.foot_force[..., 2].abs()).any(dim=1).to(sideways.dtype)


def progress(state: StepState, _: RewardConfig) -> Tensor:
    """Progress: min(<v_xy, v_cmd> / |v_cmd|, |v_cmd|), velocity in the commanded direction, m/s. Ours."""
    speed = _square_xy(state.command).sqrt()
    along = (state.velocity[:, :2] * state.command[:, :2]).sum(dim=1) / speed.clamp(min=1e-6)
    return torch.minimum(along, speed)


def low_swing(state: StepState, config: RewardConfig) -> Tensor:
    """Low swing: sum over feet of horizontal speed x how much of the swing height is missing, m/s. Ours.

    A foot that slides counts its whole speed, one that swings higher than `swing_height` nothing: air time alone
    teaches feet to skim the ground.
    """
    missing = (1.0 - state.foot_rise / config.swing_height).clamp_(min=0.0)
    return (state.foot_speed * missing).sum(dim=1)


def specific_power(state: StepState, _: RewardConfig) -> Tensor:
    """Positive mechanical power over body weight, m/s: cost of transport times speed. Ours."""
    return state.specific_power


TERMS: Mapping[str, Term] = {
    term.__name__: term
    for term in (
        linear_velocity_tracking,
        angular_velocity_tracking,
        collisions,
        linear_velocity_penalty,
        angular_velocity_penalty,
        action_rate,
        hip_position_penalty,
        joint_acceleration,
        joint_position_penalty,
        torque_rate,
        torque_penalty,
        feet_air_time,
        goal_tracking,
        clearance,
        orientation,
        heading_tracking,
        stumble,
        progress,
        low_swing,
        specific_power,
    )
}
"""Every term by the name of its weight in `RewardConfig`."""


@cache
def find_term(name: str) -> Term:
    """The term of that name in `TERMS`, or the function `module:function` of your own.

    It gets the robots' `StepState` and the `RewardConfig` and returns (N,), finite, on their device.

    Raises:
        ValueError: there is no such term, or it cannot be imported.

    Example:
        >>> term = find_term("locorl.rewards.terms:orientation")
    """
    if name in TERMS:
        return TERMS[name]
    module, colon, function = name.partition(":")
    if not colon:
        raise ValueError(f"reward term '{name}': write one of your own as module:function; known: {', '.join(TERMS)}")
    try:
        return getattr(import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"reward term '{name}' cannot be imported ({error}): put its module on the path, with PYTHONPATH or an "
            "installed package"
        ) from error
