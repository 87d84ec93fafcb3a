"""Mechanical energy: paper eq. 10 as printed, joules, cost of transport."""

from __future__ import annotations

import numpy as np

from deploy.interfaces import Array

GRAVITY = 9.81
"""m/s^2, for the cost of transport."""

MIN_DISTANCE = 0.5
"""Below this distance in m a cost of transport says nothing."""


def positive_power(dq: Array, tau: Array) -> Array:
    """Mechanical power that the joints put out: clamped per joint, then summed.

    No joint pays for another and none regenerates, as in eq. 10.

    Args:
        dq: Joint velocities, shape (..., n), rad/s.
        tau: Joint torques of the same instants, shape (..., n), N m.

    Returns:
        Power, shape (...), W.
    """
    return np.maximum(dq * tau, 0.0).sum(axis=-1)


def eq10(dq: Array, tau: Array) -> float:
    """The paper's energy objective, eq. 10: ``f = -sum_t sum_j max(dq_tj tau_tj, 0)``.

    It has no time step, so its unit is W times ticks and its value depends on the rate; `joules` does not.

    Args:
        dq: Joint velocities, shape (ticks, n), rad/s.
        tau: Joint torques of the same instants, shape (ticks, n), N m.

    Returns:
        f, never positive.
    """
    return -float(positive_power(dq, tau).sum())


def joules(f: float, dt: float) -> float:
    """Positive mechanical energy in J from eq. 10's f and the time between its ticks in s."""
    return dt * abs(f)


def sampling_errors(policy_j: float, state_j: float, dt: float, state_dt: float) -> tuple[float, float] | None:
    """How far two sums of the same power, at two rates, may be from its integral.

    A tick's sample is taken just before a new target arrives, so that power rises and falls in step with the
    samples: a sum at the policy rate is biased, by a tenth and more, and neither a longer run nor its own samples
    show it. What shows it is the sum at the rate of the state. To first order such a bias is proportional to the
    step, error = c dt, so the two sums give c (Richardson's extrapolation):
    ``error_state = |policy - state| state_dt / (dt - state_dt)``, and ``error_policy = error_state dt / state_dt``.

    Args:
        policy_j: Energy summed at the policy rate, J.
        state_j: The same work summed at the rate of the state, J.
        dt: Time between ticks, s.
        state_dt: Time between states, s.

    Returns:
        Half-widths of the error bars of both sums, J; None where the states come no faster than the ticks.
    """
    if not state_dt < 0.99 * dt:
        return None
    slope = abs(policy_j - state_j) / (dt - state_dt)
    return slope * dt, slope * state_dt


def cost_of_transport(energy_j: float, mass: float, distance: float) -> float | None:
    """``E+ / (m g d)``, without unit.

    Args:
        energy_j: Positive mechanical energy, J.
        mass: Mass of this very body, kg.
        distance: Distance covered, m.

    Returns:
        The cost of transport, or None below `MIN_DISTANCE`, where it is not defined.
    """
    if not distance >= MIN_DISTANCE:
        return None
    return energy_j / (mass * GRAVITY * distance)
