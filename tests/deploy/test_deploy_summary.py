"""Distances and errors on motions whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest
from deploy.logs.metadata import RunInfo
from deploy.logs.trace import Trace
from deploy.measure.summary import summarise

HZ = 50
SPEED = 0.5


def info(command, duration):
    return RunInfo("b", "0", "r", {}, 10.0, HZ, command, duration, 0, "0")


def motion(ticks, speed, yaw_rate, lead=10, heading=0.0):
    """Stand for `lead` ticks, then an exact arc at constant speed and yaw rate; power grows by 1 W a tick."""
    count = lead + ticks + 1
    t = np.maximum(np.arange(count) - lead, 0) / HZ
    yaw = heading + yaw_rate * t
    if yaw_rate:
        radius = speed / yaw_rate
        x, y = radius * (np.sin(yaw) - np.sin(heading)), radius * (np.cos(heading) - np.cos(yaw))
    else:
        x, y = speed * t * np.cos(heading), speed * t * np.sin(heading)
    zeros = np.zeros(count)
    return Trace(
        mode=np.array(["stand_up"] * lead + ["policy"] * ticks + ["damp"]),
        reason="finished",
        time=np.arange(count) / HZ,
        due=np.arange(count) / HZ,
        done=np.arange(count) / HZ,
        q=np.zeros((count, 12)),
        q_target=np.zeros((count, 12)),
        dq=np.ones((count, 12)),
        tau=np.tile(np.arange(count)[:, None] / 12, (1, 12)),
        late=np.arange(count) % 7 == 0,
        skipped=np.arange(count) // (count - 2),
        clamped=np.ones(count, dtype=int),
        joint_energy_pos_j=np.arange(count)[:, None] * np.array([3.0] + 11 * [0.0]),
        states=4 * np.arange(count),
        peak_w=np.arange(count) + 0.5,
        position=np.stack([x, y, zeros + 0.3], axis=1),
        quat_wxyz=np.stack([np.cos(yaw / 2), zeros, zeros, np.sin(yaw / 2)], axis=1),
        velocity=np.tile([speed, 0.0, 0.0], (count, 1)),
        yaw_rate=zeros + yaw_rate,
    )


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_straight_line(heading):
    summary = summarise(info((SPEED, 0.0, 0.0), 10.0), motion(500, 0.4, 0.0, heading=heading))
    assert summary.distance_m == pytest.approx(4.0)
    assert summary.displacement_m == pytest.approx(4.0)
    assert summary.commanded_m == pytest.approx(5.0)
    assert summary.mean_speed == pytest.approx(0.4)
    assert summary.tracking_error == pytest.approx(0.1)
    assert summary.completed
    assert not summary.fell


def test_only_full_control_counts():
    """Standing up has power, clamped targets and late ticks of its own."""
    trace = motion(100, SPEED, 0.0)
    summary = summarise(info((SPEED, 0.0, 0.0), 2.0), trace)
    assert summary.ticks == 100
    assert summary.clamped == 100
    assert summary.late == len([i for i in range(10, 110) if i % 7 == 0])
    assert summary.eq10_w_ticks == pytest.approx(-sum(range(10, 110)))
    assert summary.energy_j_50hz == pytest.approx(sum(range(10, 110)) / 50)
    assert summary.energy_j_physics == pytest.approx(300.0)
    assert summary.cost_of_transport == pytest.approx(300.0 / (10 * 9.81 * 1.0))
    assert summary.mean_power_w == pytest.approx(150.0)
    assert summary.peak_power_w == 110.5


def test_full_circle_covers_way_but_no_displacement():
    """Heading turns with the robot: 2 pi r of way, back at the start."""
    turns = motion(500, SPEED, 2 * np.pi / 10)
    summary = summarise(info((SPEED, 0.0, 2 * np.pi / 10), 10.0), turns)
    assert summary.distance_m == pytest.approx(5.0, rel=1e-3)
    assert summary.displacement_m == pytest.approx(0.0, abs=1e-9)
    assert summary.yaw_rate_error == pytest.approx(0.0)


def test_sideways_command_counts_sideways_way():
    trace = motion(100, SPEED, 0.0)
    summary = summarise(info((0.0, SPEED, 0.0), 2.0), trace)
    assert summary.distance_m == pytest.approx(0.0, abs=1e-12)
    assert summary.displacement_m == pytest.approx(1.0)
    assert summary.tracking_error == pytest.approx(SPEED)
    assert summary.cost_of_transport is None


def test_standing_still_on_command():
    summary = summarise(info((0.0, 0.0, 0.0), 4.0), motion(200, 0.03, 0.0))
    assert summary.distance_m is None
    assert summary.tracking_error == pytest.approx(0.03)


def test_time_lost_to_a_fall_counts_the_whole_command():
    """Falls after 6 of 10 s: 4 s counted at 0.1 m/s, 4 s at the whole 0.5 m/s."""
    fallen = replace(motion(300, 0.4, 0.0), reason="tilt: 1.2 rad, limit 1.0 rad")
    summary = summarise(info((SPEED, 0.0, 0.0), 10.0), fallen)
    assert summary.fell
    assert not summary.completed
    assert summary.tracking_error == pytest.approx((0.1 + 0.5) / 2)
    assert summary.distance_m == pytest.approx(2.4)
    assert summary.commanded_m == pytest.approx(5.0)


def test_hardware_has_no_truth():
    trace = motion(100, SPEED, 0.0)
    nothing = {
        name: np.full_like(getattr(trace, name), np.nan)
        for name in ("joint_energy_pos_j", "peak_w", "position", "quat_wxyz", "velocity", "yaw_rate")
    }
    summary = summarise(info((SPEED, 0.0, 0.0), 2.0), replace(trace, **nothing))
    assert summary.distance_m is None
    assert summary.tracking_error is None
    assert summary.energy_j_physics is None
    assert summary.peak_power_w == pytest.approx(109.0)
    assert summary.mean_power_w == pytest.approx(sum(range(10, 110)) / 100)
