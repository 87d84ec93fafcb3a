"""Energy against closed forms."""

import numpy as np
import pytest
from deploy.measure.energy import cost_of_transport, eq10, joules, positive_power, sampling_errors
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

finite = st.floats(-100, 100)
tables = arrays(np.float64, (7, 12), elements=finite)


@pytest.mark.parametrize("rate", [200, 500, 1000])
def test_sinusoid_with_known_positive_work(rate):
    """w = A sin, t = B sin(+phi): positive work per period is AB/(2W) (sin phi + (pi - phi) cos phi)."""
    speed, torque, phi, omega = 6.0, 11.0, 0.7, 2 * np.pi
    t = np.arange(10 * rate) / rate
    dq = speed * np.sin(omega * t)[:, None]
    tau = torque * np.sin(omega * t + phi)[:, None]
    exact = 10 * speed * torque / omega * (np.sin(phi) + (np.pi - phi) * np.cos(phi))
    assert joules(eq10(dq, tau), 1 / rate) == pytest.approx(exact, rel=1e-3)


def test_sign_and_unit_as_printed():
    """Two ticks, two joints: only positive products count, and no time step."""
    dq = np.array([[1.0, -2.0], [3.0, 1.0]])
    tau = np.array([[2.0, 1.0], [-1.0, 4.0]])
    assert eq10(dq, tau) == -(2.0 + 4.0)
    assert joules(-6.0, 0.02) == pytest.approx(0.12)


@settings(deadline=None, max_examples=25)
@given(tables, tables)
def test_eq10_is_the_double_sum(dq, tau):
    slow = -sum(max(dq[t, j] * tau[t, j], 0.0) for t in range(7) for j in range(12))
    assert eq10(dq, tau) == pytest.approx(slow, rel=1e-12)


@settings(deadline=None, max_examples=25)
@given(tables, tables)
def test_joints_neither_regenerate_nor_pay_for_each_other(dq, tau):
    """Clamping per joint gives at least what clamping the sum gives, and any order of joints the same."""
    power = positive_power(dq, tau)
    assert (power >= np.maximum((dq * tau).sum(axis=1), 0.0) * (1 - 1e-12) - 1e-9).all()
    np.testing.assert_allclose(positive_power(dq[:, ::-1], tau[:, ::-1]), power, rtol=1e-12, atol=1e-9)


def test_cost_of_transport():
    assert cost_of_transport(981.0, mass=10.0, distance=5.0) == pytest.approx(2.0)


@pytest.mark.parametrize("distance", [0.0, 0.49, -3.0, np.nan])
def test_cost_of_transport_without_distance(distance):
    assert cost_of_transport(1.0, mass=10.0, distance=distance) is None


@settings(deadline=None, max_examples=50)
@given(st.floats(-80, 80), st.floats(100, 200), st.integers(2, 20), st.integers(1, 50))
def test_error_bars_are_the_errors_of_power_in_step_with_the_ticks(slope, start, states, ticks):
    """Power that runs a ramp in every tick: both sums miss the integral by what the bars say, in closed form."""
    dt = 0.02
    exact = ticks * (start * dt + slope * dt / 2)
    at_ticks = ticks * start * dt
    fine = np.arange(states) / states
    at_states = ticks * (start + slope * fine).sum() * dt / states
    policy, state = sampling_errors(at_ticks, at_states, dt, dt / states)
    assert policy == pytest.approx(abs(at_ticks - exact), rel=1e-6, abs=1e-9)
    assert state == pytest.approx(abs(at_states - exact), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("state_dt", [0.02, 0.0199, 0.04, np.nan])
def test_no_error_bar_without_faster_states(state_dt):
    assert sampling_errors(10.0, 11.0, 0.02, state_dt) is None
