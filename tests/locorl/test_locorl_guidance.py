"""Where robots are to go: headings, waypoints, steering, and what is paid for getting there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl import CommandConfig, GoalConfig, LeggedEnv, TaskConfig, make_task, no_randomisation
from locorl.env.goals import Waypoints
from locorl.env.kinematics import roll_pitch, wrap, yaw_of, yaw_quat
from locorl.env.state import read_motion

CPU = torch.device("cpu")
angles = st.floats(-10.0, 10.0)


def course_of(env: LeggedEnv) -> torch.Tensor:
    assert env.goals is not None
    return env.goals.course


@pytest.fixture
def jumper(factory, designs) -> LeggedEnv:
    task = make_task("parkour-highjump")
    terrain = replace(task.terrain, difficulty=(0.0, 0.5))
    still = CommandConfig((0.5, 0.5), (0.0, 0.0), (-1.0, 1.0), hold=100.0, standing=0.0)
    task = replace(task, terrain=terrain, randomisation=no_randomisation(), command=still)
    env = LeggedEnv(factory, designs, task, threads=1)
    env.reset(seed=0)
    return env


@given(angles, angles)
def test_wrapping_keeps_the_direction(angle, turn):
    wrapped = wrap(torch.tensor([angle], dtype=torch.float64)).item()
    assert -np.pi - 1e-9 <= wrapped <= np.pi + 1e-9
    assert np.cos(wrapped - angle) == pytest.approx(1.0)
    turned = wrap(torch.tensor([angle + 2 * np.pi * round(turn)], dtype=torch.float64)).item()
    assert np.cos(turned - wrapped) == pytest.approx(1.0)


@given(st.floats(-3.1, 3.1), st.floats(-3.0, 3.0), st.floats(-1.5, 1.5))
def test_yaw_roll_and_pitch_are_those_of_the_rotation_matrix(yaw, roll, pitch):
    def turn(axis: int, angle: float) -> np.ndarray:
        quat = np.zeros(4)
        quat[0], quat[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
        return quat

    def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        w, v, x, u = a[0], a[1:], b[0], b[1:]
        return np.concatenate(([w * x - v @ u], w * u + x * v + np.cross(v, u)))

    quat = torch.from_numpy(times(times(turn(2, yaw), turn(1, pitch)), turn(0, roll))[None])
    np.testing.assert_allclose(yaw_of(quat).item(), yaw, atol=1e-9)
    # gravity in the frame of a base that was turned by yaw, then pitch, then roll
    gravity = (np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch))
    np.testing.assert_allclose(roll_pitch(torch.tensor([gravity]))[0], (roll, pitch), atol=1e-9)


def test_a_waypoint_counts_when_the_robot_stays_near_it():
    goals = Waypoints(GoalConfig(reach=0.2, hold=0.06), count=2, dt=0.02, num_envs=2, device=CPU)
    course = torch.tensor([[1.0, 0.0, 0.4], [2.0, 0.0, 0.0]])
    goals.assign(torch.arange(2), course.expand(2, 2, 3))
    near, away = torch.tensor([0.81, 0.0, 0.9]), torch.tensor([0.79, 0.0, 0.9])
    for position in (near, near, away, near, near):  # never three steps in a row
        goals.advance(torch.stack((position, away)))
        assert goals.index.tolist() == [0, 0]
    goals.advance(torch.stack((near, away)))
    assert goals.index.tolist() == [1, 0]
    np.testing.assert_allclose(goals.ahead(0), ((2.0, 0.0, 0.0), (1.0, 0.0, 0.4)))
    np.testing.assert_allclose(goals.ahead(1), ((2.0, 0.0, 0.0), (2.0, 0.0, 0.0)))
    for _ in range(3):
        assert not goals.finished().any()
        goals.advance(torch.stack((course[1], away)))
    assert goals.finished().tolist() == [True, False]
    goals.assign(torch.tensor([0]), course[None])
    assert goals.index.tolist() == [0, 0]


def test_the_last_waypoint_is_a_finishing_line():
    """Past it counts, as far aside as a robot may be; past another one does not."""
    goals = Waypoints(GoalConfig(reach=0.2, hold=0.04), count=2, dt=0.02, num_envs=2, device=CPU)
    goals.assign(torch.arange(2), torch.tensor([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]).expand(2, 2, 3))
    goals.index[0] = 1
    before, past = torch.tensor([1.99, 0.7, 0.3]), torch.tensor([2.01, 0.7, 0.3])
    for position, finished in ((before, False), (before, False), (past, False), (past, True)):
        goals.advance(torch.stack((position, position)))
        assert goals.finished().tolist() == [finished, False]
    assert goals.index[1] == 0


def test_directions_and_heading_errors_by_hand():
    goals = Waypoints(GoalConfig(), count=2, dt=0.02, num_envs=1, device=CPU)
    goals.assign(torch.tensor([0]), torch.tensor([[[3.0, 4.0, 1.0], [0.0, 9.0, 0.0]]]))
    position = torch.tensor([[0.0, 0.0, 0.5]])
    np.testing.assert_allclose(goals.direction(position), [[0.6, 0.8, 0.0]], rtol=1e-6)
    yaw = torch.tensor([np.pi / 2 + 2 * np.pi], dtype=torch.float32)  # facing along y, after a full turn
    np.testing.assert_allclose(goals.heading_error(position, yaw), [np.arctan2(4, 3) - np.pi / 2], atol=1e-5)
    np.testing.assert_allclose(goals.heading_error(position, yaw, steps=1), [0.0], atol=1e-5)


def test_waypoints_need_a_course(factory, designs):
    with pytest.raises(ValueError, match="has no waypoints"):
        LeggedEnv(factory, designs, replace(TaskConfig(), goals=GoalConfig()), threads=1)


def test_robots_are_steered_towards_the_next_waypoint(jumper):
    env = jumper
    assert (course_of(env)[:, 0, 0] > env.sim.qpos[:, 0]).all()  # the course lies ahead
    for turn, sign in ((0.6, -1.0), (-0.6, 1.0)):
        env.sim.qpos[:, 3:7] = yaw_quat(torch.full((8,), turn, dtype=torch.float64))
        env.step(torch.zeros(8, 12))
        way = env.goal - env.sim.qpos[:, :3]
        bearing = torch.atan2(way[:, 1], way[:, 0])
        error = bearing - yaw_of(env.sim.qpos[:, 3:7])
        assert (torch.sign(error) == sign).all()
        gain = env.task.command.heading_gain
        np.testing.assert_allclose(env.command[:, 2], (gain * error).clamp(-1, 1), atol=1e-4)
    env.sim.qpos[:, 3:7] = yaw_quat(torch.full((8,), 3.0, dtype=torch.float64))
    env.step(torch.zeros(8, 12))
    assert (env.command[:, 2].abs() <= 1.0).all()


def test_on_a_course_the_commanded_velocity_points_to_the_waypoint(jumper):
    env = jumper
    env.sim.qpos[:, 3:7] = yaw_quat(torch.linspace(-3.0, 3.0, 8, dtype=torch.float64))
    now = read_motion(env.sim)
    command = env.guidance.velocity_command(now, env.guidance.direction(now))
    way = env.goal - env.sim.qpos[:, :3]
    world = torch.atan2(command[:, 1], command[:, 0]) + yaw_of(env.sim.qpos[:, 3:7])
    np.testing.assert_allclose(wrap(world - torch.atan2(way[:, 1], way[:, 0])), 0.0, atol=1e-5)
    np.testing.assert_allclose(command[:, :2].norm(dim=1), 0.5, rtol=1e-5)
    assert torch.equal(command[:, 2], env.command[:, 2])


def test_goal_tracking_pays_speed_towards_the_waypoint(jumper):
    env = jumper
    env.step(torch.zeros(8, 12))
    env.sim.qpos[:, 2] += 0.5  # in the air, where nothing slows a robot down within one step
    env.sim.qvel[:] = 0.0
    way = (env.goal - env.sim.qpos[:, :3])[:, :2]
    env.sim.qvel[:, :2] = 0.3 * way / way.norm(dim=1, keepdim=True)
    *_, info = env.step(torch.zeros(8, 12))
    weight = env.task.reward.goal_tracking
    way = (env.goal - env.sim.qpos[:, :3])[:, :2]
    speed = (env.sim.qvel[:, :2] * way).sum(dim=1) / way.norm(dim=1)
    assert 0.2 < speed.min() <= speed.max() < 0.4
    assert info.reward_terms["goal_tracking"].item() == pytest.approx(weight * env.dt * speed.mean().item(), rel=1e-4)
    np.testing.assert_allclose(info.tracking_error, 0.5 - speed, atol=1e-4)


def test_the_end_of_the_course_is_a_success_that_promotes(jumper):
    env = jumper
    env.curriculum.level[:] = 0
    last = course_of(env)[3, -1].double()
    before = env.curriculum.level.clone()
    env.goals.index[3] = env.goals.count - 1
    seen = []
    for _ in range(5):
        env.sim.qpos[3, :2] = last[:2]
        env.sim.qpos[3, 2] = last[2] + 1.0
        env.sim.qvel[3] = 0.0
        _, _, terminated, truncated, info = env.step(torch.zeros(8, 12))
        seen.append((info.success[3].item(), truncated[3].item(), terminated[3].item()))
    assert seen == [(False, False, False)] * 4 + [(True, True, False)]
    assert info.done_ids.tolist() == [3]
    assert env.curriculum.level[3] == before[3] + 1
    assert (env.curriculum.level == before).sum() == 7
    assert env.goals.index[3] == 0


def test_a_fall_into_a_pit_ends_the_episode(factory, designs):
    env = LeggedEnv(factory, designs, make_task("parkour-longjump"), threads=1)
    env.reset(seed=0)
    assert env.terrain.floor < -0.5
    heights = env.terrain.heights
    row, column = (heights.heights < -0.5).nonzero()[100].tolist()
    env.sim.qpos[2, :3] = torch.tensor((heights.origin[0] + 0.05 * row, heights.origin[1] + 0.05 * column, -0.3))
    _, _, terminated, _, _ = env.step(torch.zeros(8, 12))
    assert terminated.tolist() == [False, False, True, *[False] * 5]


def test_a_foot_near_an_edge_is_seen(jumper):
    """A robot moved over the first obstacle stands with feet near its edges, one on open ground does not."""
    env = jumper
    feet = env.sim.foot_position
    env.step(torch.zeros(8, 12))
    assert not env.terrain.heights.near_edge(feet[..., :2].float()).any()
    box = next(b for b in env.terrain.boxes if b.centre[2] + b.half_size[2] > 0.05)
    place = torch.tensor([[box.centre[0] - box.half_size[0] + d, box.centre[1]] for d in (-0.04, 0.0, 0.04, -0.2)])
    assert env.terrain.heights.near_edge(place).tolist() == [True, True, True, False]


def test_a_heading_is_kept(factory, designs):
    command = CommandConfig(heading=(-np.pi, np.pi), standing=0.0, yaw_rate=(-0.4, 0.4))
    task = replace(TaskConfig(), command=command, randomisation=no_randomisation())
    env = LeggedEnv(factory, designs, task, threads=1)
    env.reset(seed=0)
    error = wrap(env.commands.heading - yaw_of(env.sim.qpos[:, 3:7].float()))
    np.testing.assert_allclose(env.command[:, 2], (0.5 * error).clamp(-0.4, 0.4), atol=1e-6)
    assert env.commands.heading.abs().max() <= np.pi
    assert len(set(env.commands.heading.tolist())) == 8
