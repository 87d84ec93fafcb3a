"""The golden trace: conventions of frames and signs, checked against matrices and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from distill import BundleError, RawStates
from distill.golden import plausible_states, projected_gravity, record
from distill.runtimes import Output, PolicyRuntime
from hypothesis import given, settings
from hypothesis import strategies as st

ANGLE = st.floats(-3.0, 3.0)


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rotation(rotvec: np.ndarray) -> np.ndarray:
    """World-from-base matrix of a rotation vector, by the matrix exponential."""
    return torch.matrix_exp(torch.from_numpy(skew(rotvec))).numpy()


@given(st.tuples(ANGLE, ANGLE, ANGLE), st.floats(0.5, 2.0))
@settings(deadline=None)
def test_projected_gravity_is_world_down_in_the_base_frame(rotvec, length):
    vector = np.array(rotvec)
    angle = np.linalg.norm(vector)
    quat = np.concatenate(([np.cos(angle / 2)], 0.5 * np.sinc(angle / 2 / np.pi) * vector))
    expected = rotation(vector).T @ (0.0, 0.0, -1.0)
    np.testing.assert_allclose(projected_gravity(length * quat), expected, atol=1e-12)


def test_a_robot_that_pitches_nose_down_sees_gravity_ahead():
    nose_down = np.array([np.cos(0.1), 0.0, np.sin(0.1), 0.0])  # about +y, x forward and z up
    assert projected_gravity(nose_down)[0] > 0.15


def test_plausible_states_agree_with_their_own_rates(spec):
    """The gyro turns one orientation into the next, and joint rates one set of angles into the next."""
    fine = replace(spec, policy_hz=5000.0, physics_dt=1.0 / 5000.0)
    states = plausible_states(fine, 200, seed=4)
    dt = 1.0 / 5000.0
    for tick in (5, 50, 95, 120, 190):
        middle = 0.5 * (states.q[tick + 1] - states.q[tick - 1]) / dt
        np.testing.assert_allclose(middle, states.dq[tick], atol=1e-3)
        before, now, after = (matrix(states.quat_wxyz[t]) for t in (tick - 1, tick, tick + 1))
        omega = now.T @ (after - before) / (2.0 * dt)
        np.testing.assert_allclose(omega, skew(states.gyro[tick]), atol=1e-3)


def matrix(quat: np.ndarray) -> np.ndarray:
    w, v = quat[0], quat[1:]
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * skew(v)


def test_plausible_states_stay_in_range_and_move(spec):
    states = plausible_states(spec)
    lower, upper = (np.array([getattr(joint, name) for joint in spec.joints]) for name in ("lower", "upper"))
    assert len(states.reset) == 256
    assert np.flatnonzero(states.reset).tolist() == [0, 128]
    assert ((states.q >= lower) & (states.q <= upper)).all()
    assert (np.ptp(states.q, axis=0) > 0.05).all()
    assert ((states.command >= spec.command_low) & (states.command <= spec.command_high)).all()
    np.testing.assert_allclose(np.linalg.norm(states.quat_wxyz, axis=1), 1.0)


class Counting(PolicyRuntime):
    """Answers with the number of ticks since its last reset."""

    def __init__(self) -> None:
        super().__init__([(1, 1)])

    def _forward(self, inputs):
        count = inputs[1] + 1.0
        return [np.tile(0.06 * count, (1, 12)).astype(np.float32), np.zeros((1, 3), np.float32), count]


def test_last_action_is_clipped_and_cleared_by_a_reset(spec):
    trace = record(spec, plausible_states(spec, 10), Counting())
    ticks = np.array([1, 2, 3, 4, 5, 1, 2, 3, 4, 5])
    np.testing.assert_allclose(trace["action"][:, 0], 0.06 * ticks, rtol=1e-6)
    clipped = np.minimum(0.06 * ticks, 0.1)
    np.testing.assert_allclose(trace["obs"][:, -1], [0, *clipped[:4], 0, *clipped[5:9]], rtol=1e-6)
    np.testing.assert_allclose(trace["target"][:, 2], -1.6 + 0.02 + 0.25 * clipped, rtol=1e-6)
    assert isinstance(Counting().step(trace["obs"][0]), Output)


def test_raw_states_that_prove_nothing_are_refused(spec):
    states = plausible_states(spec, 6)
    arrays = {name: getattr(states, name) for name in ("quat_wxyz", "gyro", "q", "dq", "command", "reset")}
    with pytest.raises(BundleError, match="reset at tick 0"):
        RawStates(**{**arrays, "reset": np.zeros(6, dtype=bool)})
    with pytest.raises(BundleError, match=r"gyro has shape \(6, 4\)"):
        RawStates(**{**arrays, "gyro": np.zeros((6, 4))})
    with pytest.raises(BundleError, match="q holds values"):
        RawStates(**{**arrays, "q": np.full((6, 12), np.nan)})
