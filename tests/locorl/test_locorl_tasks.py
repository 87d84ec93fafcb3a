"""The tasks by name: they run, stand still safely, observe what they say, and go on bit-identically."""

from __future__ import annotations

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from locorl import (
    TASKS,
    LeggedEnv,
    RandomisationConfig,
    TaskConfig,
    TerrainMap,
    flat_scene,
    make_task,
    no_randomisation,
)
from locorl.config import from_dict, to_dict
from locorl.env.depth_camera import DepthConfig
from locorl.rewards.terms import TERMS
from locorl_box import box_spec

BOTH = [(name, preset) for name in TASKS for preset in ("laptop", "paper")]
ON_TERRAIN = [name for name in TASKS if name != "locomotion-flat"]


def calm(task: TaskConfig) -> TaskConfig:
    return replace(task, randomisation=no_randomisation())


def shaken(n: int, steps: int, size: float = 0.5) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [size * torch.randn(n, 12, generator=generator) for _ in range(steps)]


@pytest.mark.parametrize(
    ("name", "value"),
    [("episode_seconds", -1.0), ("episode_seconds", 0.001), ("action_scale", 0.0), ("max_tilt", -1.0)],
)
def test_what_no_robot_could_do_is_refused(name: str, value: float):
    with pytest.raises(ValueError, match=name):
        TaskConfig(**{name: value})


def test_flat_ground_is_the_default_task():
    assert make_task("locomotion-flat") == TaskConfig()


@pytest.mark.parametrize(("name", "preset"), BOTH)
def test_a_task_comes_back_from_json(name, preset):
    task = make_task(name, preset)
    assert task.name == name
    assert from_dict(TaskConfig, json.loads(json.dumps(to_dict(task)))) == task


@pytest.mark.parametrize(
    ("preset", "columns"), [("laptop", ["hills", "steps_up"]), ("paper", ["hills", "steps_up"] * 2)]
)
def test_a_task_on_other_ground_has_as_many_columns_of_each_kind(preset, columns):
    task = make_task("locomotion-steps", preset).on(["hills", "steps_up"], levels=2)
    terrain = TerrainMap(task.terrain)
    assert list(terrain.kinds) == columns
    assert terrain.origins.shape[:2] == (2, len(columns))
    assert replace(task, terrain=make_task("locomotion-steps", preset).terrain) == make_task("locomotion-steps", preset)
    with pytest.raises(ValueError, match="need a kind"):
        task.on([])


@pytest.mark.parametrize(("name", "preset"), [("locomotion-moon", "laptop"), ("locomotion-flat", "pocket")])
def test_unknown_names_are_refused(name, preset):
    with pytest.raises(ValueError, match=r"there is no (task 'locomotion-moon'.*locomotion-flat|preset 'pocket')"):
        make_task(name, preset)


@pytest.mark.parametrize("name", TASKS)
def test_the_paper_has_its_rates_and_its_reward(name):
    task = make_task(name, "paper")
    assert (task.physics.timestep, task.physics.control_dt) == (0.005, 0.02)
    assert task.observation.perception_period == 0.1
    assert task.reward.goal_tracking == (1.5 if name.startswith("parkour") else 0.0)
    assert not task.reward.clip_at_zero
    assert task.observation.scan is not None
    assert task.observation.scan.size == 132
    assert task.observation.history == 10


@pytest.mark.parametrize(("name", "preset"), BOTH)
def test_a_standing_robot_stays_on_its_feet(factory, designs, name, preset):
    task = calm(make_task(name, preset))
    env = LeggedEnv(factory, designs, task, seed=0, threads=1)
    obs = env.reset(seed=0)
    start = env.sim.qpos[:, :2].clone()
    for _ in range(60):
        obs, reward, terminated, truncated, info = env.step(torch.zeros(8, 12))
        assert not terminated.any()
        assert not truncated.any()
        assert reward.isfinite().all()
    assert {group: tuple(values.shape) for group, values in obs.items()} == {
        group: (8, size) for group, size in env.group_dims.items()
    }
    assert all(values.isfinite().all() for values in obs.values())
    assert set(info.reward_terms) <= {*TERMS, "fall"}
    assert (env.sim.qpos[:, :2] - start).norm(dim=1).max() < 0.1
    above = env.sim.qpos[:, 2] - env.terrain.heights.at(env.sim.qpos[:, :2].float())
    np.testing.assert_allclose(above, env.stance_qpos[:, 2], atol=0.06)


@pytest.mark.parametrize("name", ON_TERRAIN)
def test_robots_start_clear_of_the_ground_and_the_scan_is_what_a_ray_meets(factory, designs, name):
    task = calm(make_task(name))
    task = replace(task, observation=replace(task.observation, perception_period=0.02))
    env = LeggedEnv(factory, designs, task, seed=3, threads=1)
    obs = env.reset()
    generator = torch.Generator().manual_seed(5)
    env.sim.qpos[:, :2] += 1.5 * torch.rand(8, 2, generator=generator, dtype=torch.float64)
    env.sim.qpos[:, 2] += 2.0
    seen = env.step(torch.zeros(8, 12))[0]["scan"]
    scanner = env.observer.scanner
    assert scanner is not None
    for robot in (0, 5):
        model, data = env.sim.model_of(robot), env.sim.data_of(robot)
        qpos = env.sim.qpos[robot].numpy()
        yaw = 2 * np.arctan2(qpos[6], qpos[3])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        for k in range(0, scanner.config.size, 5):
            place = qpos[:2] + turn @ scanner.offsets[k].double().numpy()
            # the grid's node may lie up to half a cell beside a face
            around = np.array([ground_below(model, data, place + shift) for shift in 0.026 * CROSS])
            expected = np.clip(qpos[2] - env.stance_qpos[robot, 2].item() - around, -1.0, 1.0)
            assert expected.min() - 0.015 <= seen[robot, k].item() <= expected.max() + 0.015
    assert obs["scan"].shape == (8, scanner.config.size)


CROSS = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)], dtype=float)


def ground_below(model: mujoco.MjModel, data: mujoco.MjData, place: np.ndarray) -> float:
    """Height of the first thing of the world below a point, m; robots are left out."""
    geom = np.zeros(1, dtype=np.int32)
    robot = int(model.jnt_bodyid[0])
    height, lowest = 20.0, -50.0
    while height > lowest:
        distance = mujoco.mj_ray(
            model, data, np.array([*place, height]), np.array([0.0, 0.0, -1.0]), None, 1, robot, geom
        )
        assert distance >= 0
        height -= distance
        if model.geom_bodyid[geom[0]] == 0:
            return height
        height -= 1e-4
    raise AssertionError("nothing below")


@pytest.mark.parametrize("name", ["locomotion-hills", "parkour-highjump"])
def test_everything_at_once_goes_on_bit_identically(factory, designs, name):
    task = make_task(name, "paper")
    task = replace(
        task,
        episode_seconds=0.3,
        randomisation=replace(task.randomisation, observation_noise=1.0),
        curriculum=replace(task.curriculum, least=0.0),
    )
    first = LeggedEnv(factory, designs, task, seed=0, threads=1)
    first.reset()
    actions = shaken(8, 40)
    for action in actions[:17]:
        obs, *_ = first.step(action)
    saved = first.state_dict()
    second = LeggedEnv(factory, designs[::-1].copy(), task, seed=9, threads=1)  # other bodies, other luck
    second.reset()
    restored = second.load_state_dict(saved)
    assert all(torch.equal(restored[group], values) for group, values in obs.items())
    levels = set()
    for action in actions[17:]:
        ours, theirs = first.step(action), second.step(action)
        assert all(torch.equal(ours[0][group], theirs[0][group]) for group in obs)
        assert all(torch.equal(a, b) for a, b in zip(ours[1:4], theirs[1:4], strict=True))
        levels.add(tuple(first.curriculum.level.tolist()))
    assert len(levels) > 1  # robots changed tiles on the way


@pytest.mark.parametrize(("name", "robots"), [("locomotion-flat", 4), ("locomotion-hills", 8), ("parkour-stones", 8)])
def test_a_state_that_does_not_fit_is_refused_and_changes_nothing(factory, designs, name, robots):
    env, twin = (LeggedEnv(factory, designs, TaskConfig(), seed=0, threads=1) for _ in range(2))
    other = LeggedEnv(factory, designs[::-1][:robots], make_task(name), seed=0, threads=1)
    for each in (env, twin, other):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=rf"a state of {robots} robots .* 8 robots on task 'locomotion-flat'"):
        env.load_state_dict(other.state_dict())
    with pytest.raises(ValueError, match="another task"):
        other.load_state_dict(env.state_dict())
    for action in shaken(8, 3):
        ours, theirs = env.step(action), twin.step(action)
        assert all(torch.equal(ours[0][group], theirs[0][group]) for group in ours[0])


def test_the_seed_of_a_reset_decides_with_cameras_too(factory, designs):
    task = replace(make_task("parkour-highjump"), camera=DepthConfig(rows=4, columns=6))
    env = LeggedEnv(factory, designs, task, seed=0, threads=1)
    first, other, again = (env.reset(seed=seed)["proprio"] for seed in (1, 2, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_fall_is_judged_by_the_way_of_the_whole_episode(factory, designs):
    task = calm(make_task("locomotion-steps"))
    command = replace(task.command, vx=(0.8, 0.8), vy=(0.0, 0.0), standing=0.0)
    env = LeggedEnv(factory, designs, replace(task, command=command), seed=0, threads=1)
    env.reset(seed=0)
    env.curriculum.level[:] = 1
    way = sum(env.step(action)[-1].speed * env.dt for action in shaken(8, 5, 0.2))
    np.testing.assert_allclose(env.progress.way, way, atol=1e-6)
    np.testing.assert_allclose(env.progress.asked, 0.8 * 5 * env.dt, rtol=1e-5)
    env.progress.way[:] = 0.08  # just what was asked until now, and little of 16 m
    env.sim.qpos[3, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])
    *_, terminated, _, _ = env.step(torch.zeros(8, 12))
    assert terminated.tolist() == [False] * 3 + [True] + [False] * 4
    assert env.curriculum.level.tolist() == [1, 1, 1, 0, 1, 1, 1, 1]
    assert env.progress.way[3] == env.progress.asked[3] == 0.0


def test_a_failed_simulation_has_come_nowhere(factory, designs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs the failure into the working folder
    env = LeggedEnv(factory, designs, calm(make_task("parkour-highjump")), seed=0, threads=1)
    env.reset(seed=0)
    env.curriculum.level[:] = 1
    env.progress.way[3] = 1e6  # as when it flew off before it failed
    env.sim.qvel[3] = float("nan")
    env.step(torch.zeros(8, 12))
    assert env.curriculum.level.tolist() == [1, 1, 1, 0, 1, 1, 1, 1]


def test_payload_centre_of_mass_and_motors_reach_the_simulation(factory, designs):
    random = RandomisationConfig(
        payload=(1.0, 2.0),
        centre_of_mass=0.05,
        motor_strength=(0.7, 0.9),
        motor_damping=(1.2, 1.5),
        reset_joint=0.0,
        reset_velocity=0.0,
        stagger=False,
    )
    task = replace(TaskConfig(), randomisation=random)
    task = replace(task, observation=replace(task.observation, motors=True))
    env = LeggedEnv(factory, designs, task, seed=4, threads=1)
    obs = env.reset(seed=0)
    told = {
        term.name: obs["implicit"][:, env.layout.column("implicit", term.name)].double() / term.scale
        for term in env.layout.implicit
    }
    payload, strength, damping = (told[name].numpy() for name in ("payload", "motor_strength", "motor_damping"))
    assert ((payload >= 1.0) & (payload <= 2.0)).all()
    assert ((strength >= -0.3 - 1e-6) & (strength <= -0.1 + 1e-6)).all()
    assert ((damping >= 0.2 - 1e-6) & (damping <= 0.5 + 1e-6)).all()
    np.testing.assert_allclose(env.weight, 9.81 * (factory.batch(designs).total_mass + payload[:, 0]), rtol=1e-6)
    spec_shift = env.body.drawn.centre_of_mass.double().numpy()
    assert 0.01 < np.abs(spec_shift).max() <= 0.05
    twins = []
    for i, design in enumerate(designs):
        model = box_spec(design, flat_scene(task.physics)).compile()
        base = model.body("base").id
        model.body_inertia[base] *= 1 + payload[i, 0] / model.body_mass[base]
        model.body_mass[base] += payload[i, 0]
        model.body_ipos[base] += spec_shift[i]
        # the compiler's shortcut for aligned frames does not hold once they are moved apart
        model.body_sameframe[base] = 0
        model.body_simple[base] = 0
        model.actuator_gainprm[:, 0] *= 1 + strength[i]
        model.actuator_biasprm[:, 1] *= 1 + strength[i]
        model.actuator_biasprm[:, 2] *= 1 + damping[i]
        model.geom_friction[:, 0] = told["friction"][i].item()
        model.dof_damping[6:] *= told["joint_damping"][i].item()
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        data.qpos[:] = env.stance_qpos[i].numpy()
        twins.append((model, data))
    for action in shaken(8, 8):
        env.step(action)
        for i, (model, data) in enumerate(twins):
            data.ctrl[:] = env.stance_ctrl[i].double() + 0.25 * action[i].double()
            mujoco.mj_step(model, data, nstep=2)
    np.testing.assert_allclose(env.sim.qpos.numpy(), [data.qpos for _, data in twins], atol=2e-4)


def test_other_bodies_in_place_equal_a_new_environment(factory, designs):
    others = designs[::-1].copy()
    task = calm(TaskConfig())
    changed, new = (
        LeggedEnv(factory, designs, task, seed=0, threads=1),
        LeggedEnv(factory, others, task, seed=0, threads=1),
    )
    changed.reset(seed=0)
    for action in shaken(8, 10):
        changed.step(action)
    simulator = changed.sim
    changed.set_designs(others)
    assert changed.sim is simulator
    first, second = changed.reset(seed=7), new.reset(seed=7)
    for action in shaken(8, 30):
        assert all(torch.equal(first[group], second[group]) for group in first)
        first, reward, *_ = changed.step(action)
        second, expected, *_ = new.step(action)
        assert torch.equal(reward, expected)
    with pytest.raises(ValueError, match="7 designs for 8 robots"):
        changed.set_designs(others[:7])
    lame = others.copy()
    lame[2] = (1.4, 0.6, 0.6, 0.6)
    with pytest.raises(ValueError, match=r"robot 2 .* has no stance"):
        changed.set_designs(lame)


def test_failures_are_counted_by_the_body_that_caused_them(factory, designs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs the failure into the working folder
    env = LeggedEnv(factory, designs, calm(TaskConfig()), seed=0, threads=1)
    env.reset(seed=0)
    assert env.failures.report(factory.space.names) == ""
    for robot in (6, 2, 6):
        env.sim.qvel[robot] = float("nan")
        env.step(torch.zeros(8, 12))
    worst, other = env.failures.by_body()
    assert (worst.count, other.count) == (2, 1)
    np.testing.assert_array_equal(worst.design, designs[6])
    np.testing.assert_array_equal(other.design, designs[2])
    env.set_designs(designs[::-1].copy())
    env.sim.qvel[1] = float("nan")  # the same body as robot 6 before
    env.step(torch.zeros(8, 12))
    assert env.failures.by_body()[0].count == 3
    assert env.failures.report(factory.space.names).startswith(
        "4 simulations failed and were restarted: 3 x (front_thigh"
    )


def test_the_score_is_the_mean_tracking_error_since_the_bodies_changed(factory, designs):
    env = LeggedEnv(factory, designs, TaskConfig(), seed=0, threads=1)
    env.reset(seed=0)
    errors = torch.stack([env.step(action)[4].tracking_error for action in shaken(8, 12)])
    np.testing.assert_allclose(env.score, errors.mean(dim=0), rtol=1e-5)
    env.set_designs(designs)
    assert env.score.tolist() == [0.0] * 8


def test_a_task_without_eyes_says_so(make_env):
    with pytest.raises(ValueError, match="'locomotion-flat' have no camera"):
        _ = make_env().depth


@pytest.mark.parametrize(("name", "preset"), BOTH)
def test_a_task_is_strict_json(name, preset):
    json.dumps(to_dict(make_task(name, preset)), allow_nan=False)  # infinities are none
