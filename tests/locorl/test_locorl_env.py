"""LeggedEnv: what its observations mean, how episodes end and begin, and that randomness is a function of the seed."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from locorl import CommandConfig, LeggedEnv, RewardConfig, TaskConfig, flat_scene, no_randomisation
from locorl.env.contacts import Contacts
from locorl.rewards.total import active_terms

QUIET = TaskConfig(randomisation=no_randomisation())


def shaken(env: LeggedEnv, steps: int, seed: int = 1) -> list[torch.Tensor]:
    """Random actions, as a list over steps."""
    generator = torch.Generator().manual_seed(seed)
    return [0.5 * torch.randn(env.num_envs, 12, generator=generator) for _ in range(steps)]


def twins(factory, designs, env: LeggedEnv) -> list[mujoco.MjData]:
    """Freshly compiled robots in the state of the simulation."""
    data = [mujoco.MjData(factory.compiled(design, flat_scene(env.task.physics))) for design in designs]
    for i, one in enumerate(data):
        one.qpos[:], one.qvel[:] = env.sim.qpos[i].numpy(), env.sim.qvel[i].numpy()
        mujoco.mj_forward(one.model, one)
    return data


def test_shapes_and_groups(make_env):
    env = make_env()
    obs = env.reset(seed=0)
    assert {group: tuple(values.shape) for group, values in obs.items()} == {
        "proprio": (8, 45),
        "explicit": (8, 3),
        "implicit": (8, 11),
    }
    obs, reward, terminated, truncated, info = env.step(torch.zeros(8, 12))
    assert dict(env.group_dims) == {group: values.shape[1] for group, values in obs.items()}
    assert reward.shape == terminated.shape == truncated.shape == info.positive_work.shape == (8,)
    assert terminated.dtype == truncated.dtype == torch.bool
    assert info.velocity.shape == info.position.shape == (8, 3)
    assert set(info.reward_terms) == {*active_terms(env.task.reward), "fall"}


def test_columns_hold_what_their_names_say(factory, designs, make_env):
    env = make_env()
    env.reset(seed=3)
    actions = shaken(env, 6)
    for action in actions:
        obs, *_ = env.step(action)

    def column(name: str, group: str = "proprio") -> np.ndarray:
        term = next(term for term in env.layout.groups[group] if term.name == name)
        return obs[group][:, env.layout.column(group, name)].double().numpy() / term.scale

    data = twins(factory, designs, env)
    velocity = np.zeros((8, 6))
    for i, one in enumerate(data):
        mujoco.mj_objectVelocity(one.model, one, mujoco.mjtObj.mjOBJ_XBODY, one.body("base").id, velocity[i], True)
    near = {"atol": 2e-5}
    np.testing.assert_allclose(column("base_linear_velocity", "explicit"), velocity[:, 3:], **near)
    np.testing.assert_allclose(column("base_angular_velocity"), [one.sensor("imu_gyro").data for one in data], **near)
    down = [one.body("base").xmat.reshape(3, 3).T @ (0.0, 0.0, -1.0) for one in data]
    np.testing.assert_allclose(column("projected_gravity"), down, **near)
    np.testing.assert_allclose(column("command"), env.command.numpy(), **near)
    stance = factory.batch(designs).stance_qpos
    np.testing.assert_allclose(column("joint_position_error"), [one.qpos[7:] for one in data] - stance[:, 7:], **near)
    np.testing.assert_allclose(column("joint_velocity"), [one.qvel[6:] for one in data], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(column("last_action"), actions[-1].numpy(), **near)

    np.testing.assert_allclose(column("design", "implicit"), (designs - 1.0) / 0.4, **near)
    nominal_mass = factory.compiled(np.ones(4)).body_mass.sum()
    mass = np.array([one.model.body_mass.sum() for one in data])
    np.testing.assert_allclose(column("mass_ratio", "implicit")[:, 0], mass / nominal_mass - 1.0, **near)
    np.testing.assert_allclose(column("stance_height", "implicit")[:, 0], stance[:, 2], **near)
    for i, one in enumerate(data):
        one.qpos[:] = stance[i]
        mujoco.mj_forward(one.model, one)
    centre = [one.subtree_com[one.body("base").id] - one.body("base").xpos for one in data]
    np.testing.assert_allclose(column("centre_of_mass", "implicit"), centre, **near)
    assert ((column("friction", "implicit") >= 0.5) & (column("friction", "implicit") <= 1.25)).all()
    assert ((column("joint_damping", "implicit") >= 0.5) & (column("joint_damping", "implicit") <= 2.0)).all()


def test_an_unknown_column_is_named(make_env):
    with pytest.raises(KeyError, match="'proprio' has no term 'smell'"):
        make_env().layout.column("proprio", "smell")


def test_friction_damping_and_targets_reach_the_simulation(factory, designs, make_env):
    task = TaskConfig(randomisation=replace(no_randomisation(), friction=(0.2, 1.0), joint_damping=(0.5, 3.0)))
    env = make_env(task)
    obs = env.reset(seed=0)
    env.sim.qvel[:, 0] = 1.0  # so that they slide
    friction = obs["implicit"][:, env.layout.column("implicit", "friction")].double().numpy()
    damping = obs["implicit"][:, env.layout.column("implicit", "joint_damping")].double().numpy()
    told, untold = twins(factory, designs, env), twins(factory, designs, env)
    for i, one in enumerate(told):
        one.model.geom_friction[:, 0] = friction[i]
        one.model.dof_damping[6:] *= damping[i]
    stance_ctrl = factory.batch(designs).stance_ctrl
    for action in shaken(env, 15):
        env.step(action)
        for i, one in enumerate((*told, *untold)):
            one.ctrl[:] = stance_ctrl[i % 8] + 0.25 * action[i % 8].double().numpy()
            mujoco.mj_step(one.model, one, nstep=2)
    np.testing.assert_allclose(env.sim.qpos.numpy(), [one.qpos for one in told], atol=1e-4)
    assert (np.abs(env.sim.qpos.numpy() - [one.qpos for one in untold]).max(axis=1) > 1e-3).all()


def test_a_time_out_resets_and_hands_over_the_last_observation(make_env):
    short, endless = make_env(replace(QUIET, episode_seconds=0.2)), make_env(QUIET)
    short.reset(seed=2)
    endless.reset(seed=2)
    for t, action in enumerate(shaken(short, 11), start=1):
        obs, _, terminated, truncated, info = short.step(action)
        expected, *_ = endless.step(action)
        assert not terminated.any()
        assert truncated.tolist() == [t == 10] * 8
        if t == 10:
            assert info.done_ids.tolist() == list(range(8))
            for group, values in expected.items():
                assert torch.equal(info.final_obs[group], values), group
            # the returned one belongs to a robot that stands and has not acted
            assert obs["explicit"].abs().max() == 0.0
            assert obs["proprio"][:, short.layout.column("proprio", "last_action")].abs().max() == 0.0
            assert torch.allclose(short.sim.qpos, short.stance_qpos)
        else:
            assert len(info.done_ids) == 0
    assert short.episode_step.tolist() == [1] * 8


@pytest.mark.parametrize(("degrees", "ends"), [(50, False), (70, True)])
def test_tilt_ends_an_episode(make_env, degrees, ends):
    env = make_env(QUIET)
    env.reset(seed=0)
    quat = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quat, np.array([1.0, 0.0, 0.0]), np.deg2rad(degrees))
    env.sim.qpos[2, 2], env.sim.qpos[2, 3:7] = 1.0, torch.from_numpy(quat)  # in the air
    _, _, terminated, truncated, _ = env.step(torch.zeros(8, 12))
    assert terminated.tolist() == [False, False, ends, *[False] * 5]
    assert not truncated.any()
    assert (env.sim.qpos[2, 3] == 1.0) == ends  # upright again


def test_a_fall_is_paid_once_and_not_clipped(make_env):
    rewards = []
    for fall in (0.0, -3.0):
        env = make_env(replace(QUIET, reward=RewardConfig(fall=fall)))
        env.reset(seed=0)
        env.sim.qpos[2, 2] = 1.0
        env.sim.qpos[2, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])  # on its back
        _, reward, terminated, _, info = env.step(torch.zeros(8, 12))
        assert terminated.tolist() == [False, False, True, *[False] * 5]
        rewards.append(reward)
    assert info.reward_terms["fall"].item() == pytest.approx(-3.0 / 8)
    torch.testing.assert_close(rewards[1] - rewards[0], torch.tensor([0.0, 0.0, -3.0, *[0.0] * 5]))
    assert not env.step(torch.zeros(8, 12))[4].reward_terms["fall"].any()


def test_a_low_base_ends_an_episode(make_env):
    env = make_env(replace(QUIET, min_height=1.2))
    env.reset(seed=0)
    env.sim.qpos[:, 2] *= 1.3
    env.sim.qpos[4, 2] /= 1.3
    _, _, terminated, _, _ = env.step(torch.zeros(8, 12))
    assert terminated.tolist() == [*[False] * 4, True, *[False] * 3]


@pytest.mark.parametrize("counts", [True, False])
def test_a_base_that_touches_the_ground_ends_an_episode_if_asked(make_env, counts):
    env = make_env(replace(QUIET, min_height=0.0, end_on_base_contact=counts))
    env.reset(seed=0)
    env.step(torch.zeros(8, 12))
    env.sim.qpos[5, 2] = 0.0499  # the half height of the trunk is 0.05
    env.sim.qpos[5, 7:] = torch.tensor([0.0, torch.pi / 2, 0.0]).repeat(4)  # legs stretched backwards
    _, _, terminated, _, _ = env.step(torch.zeros(8, 12))
    assert terminated.tolist() == [*[False] * 5, counts, False, False]


def test_a_failed_simulation_ends_the_episode_without_reward(make_env, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs the failure into the working folder
    env = make_env(QUIET)
    env.reset(seed=0)
    for poison in (1e20, float("nan"), 1e20):
        env.sim.qvel[6] = poison
        obs, reward, terminated, truncated, info = env.step(torch.zeros(8, 12))
        only_it = [*[False] * 6, True, False]
        assert info.diverged.tolist() == terminated.tolist() == only_it
        assert not truncated.any()
        assert reward[6] == 0.0
        assert reward[0] > 0.0
        assert all(values.isfinite().all() for values in obs.values())
        assert info.positive_work.isfinite().all()
        assert torch.equal(env.sim.qpos[6], env.stance_qpos[6])


def test_commands_stay_in_range_and_some_stand(make_env):
    command = CommandConfig(vx=(-0.2, 1.5), vy=(0.1, 0.2), yaw_rate=(-1.0, -0.5), standing=0.25)
    env = make_env(replace(QUIET, command=command))
    draws = []
    for _ in range(60):
        env.reset()
        draws.append(env.command.clone())
    drawn = torch.cat(draws)
    standing = (drawn == 0.0).all(dim=1)
    assert 0.15 < standing.float().mean() < 0.35
    moving = drawn[~standing]
    for column, (low, high) in enumerate((command.vx, command.vy, command.yaw_rate)):
        assert low <= moving[:, column].min() < low + 0.1 * (high - low)
        assert high >= moving[:, column].max() > high - 0.1 * (high - low)


def test_commands_are_held_and_then_renewed(make_env):
    env = make_env(replace(QUIET, command=CommandConfig(hold=0.1, standing=0.0)))
    env.reset(seed=0)
    seen = [env.command.clone()]
    for _ in range(11):
        env.step(torch.zeros(8, 12))
        seen.append(env.command.clone())
    changed = [bool((a != b).any(dim=1).all()) for a, b in pairwise(seen)]
    assert changed == [False] * 4 + [True] + [False] * 4 + [True] + [False]


def test_the_seed_decides_everything(make_env):
    def trajectory(seed: int) -> torch.Tensor:
        env = make_env(TaskConfig(), seed=seed)
        start = env.reset()
        rows = [torch.cat(tuple(start.values()), dim=1)]
        for action in shaken(env, 5):
            obs, reward, *_ = env.step(action)
            rows.append(torch.cat((*obs.values(), reward[:, None]), dim=1))
        return torch.cat(rows, dim=1)

    first = trajectory(4)
    assert torch.equal(first, trajectory(4))
    assert not torch.equal(first, trajectory(5))


def test_first_episodes_start_at_random_ages(make_env):
    task = replace(QUIET, episode_seconds=1.0)  # 50 steps
    staggered = make_env(replace(task, randomisation=replace(task.randomisation, stagger=True)))
    staggered.reset(seed=1)
    ages = staggered.episode_step.clone()
    assert len(set(ages.tolist())) > 4
    assert 0 <= ages.min() < 25 <= ages.max() < 50
    ended = torch.zeros(8, dtype=torch.long)
    for t in range(1, 51):
        *_, truncated, _ = staggered.step(torch.zeros(8, 12))
        ended[truncated] = t
    assert ended.tolist() == (50 - ages).tolist()


def test_resets_stay_within_the_randomisation(make_env):
    task = TaskConfig(randomisation=replace(no_randomisation(), reset_joint=0.1, reset_velocity=0.3))
    env = make_env(task)
    env.reset(seed=0)
    deviation = (env.sim.qpos[:, 7:] - env.stance_qpos[:, 7:]).abs()
    assert 0.05 < deviation.max() <= 0.1 + 1e-6
    assert 0.1 < env.sim.qvel[:, :6].abs().max() <= 0.3 + 1e-6
    assert env.sim.qvel[:, 6:].abs().max() == 0.0
    np.testing.assert_allclose(env.sim.qpos[:, 4:6].numpy(), 0.0)  # only the heading turns
    assert env.sim.qpos[:, 6].abs().max() > 0.1


def test_air_time_is_paid_once_at_touch_down(make_env, designs):
    only_air_time = dict.fromkeys(active_terms(RewardConfig()), 0.0) | {"feet_air_time": 1.0}
    reward_config = RewardConfig(**only_air_time, air_time_offset=0.0, air_time_cap=10.0)
    task = replace(QUIET, reward=reward_config, command=CommandConfig(vx=(0.5, 0.5), standing=0.0))
    env = make_env(task, designs=designs[:1])
    for _ in range(2):  # what a first episode spent in the air does not count in the second
        env.reset(seed=0)
        env.sim.qpos[0, 2] += 0.1
        first_steps = [env.step(torch.zeros(1, 12))[1].item() for _ in range(3)]
        assert first_steps == [0.0] * 3
    feet = [env.sim.sensor_slice(name).start for name in env.factory.layout.foot_contact]
    paid, touching = [], []
    for _ in range(60):
        _, reward, terminated, _, _ = env.step(torch.zeros(1, 12))
        assert not terminated.any()
        paid.append(reward.item() / env.dt)
        touching.append(env.sim.sensors[0, feet] > 0)
    first = {foot: next(t for t, touch in enumerate(touching) if touch[foot]) for foot in range(4)}
    landing = min(first.values())
    assert landing >= 1  # it takes 0.14 s to fall 10 cm
    assert paid[:landing] == [0.0] * landing
    landed = sum(t == landing for t in first.values())
    assert paid[landing] == pytest.approx(landed * (3 + landing + 1) * env.dt, rel=1e-5)
    assert all(touch.all() for touch in touching[-20:])
    assert paid[-20:] == [0.0] * 20  # standing earns nothing


def test_air_time_of_flights_flickers_and_fresh_starts():
    """One foot in each of four robots: down for good, a flicker, a hop of two steps, a restart in the air."""
    seen = torch.zeros(4, 4)
    sim = SimpleNamespace(num_envs=4, device=torch.device("cpu"), sensors=seen)
    sim.sensor_slice = lambda name: slice(int(name), int(name) + 1)
    layout = SimpleNamespace(foot_contact=("0", "1", "2", "3"), link_contact=("0",))
    contacts = Contacts(sim, layout, dt=0.02)  # pyright: ignore[reportArgumentType]
    paid = torch.zeros(4)
    for t, down in enumerate(((1, 1, 1, 0), (1, 1, 1, 0), (1, 0, 0, 0), (1, 1, 0, 0), (1, 1, 1, 1))):
        if t == 4:
            contacts.reset(torch.tensor([3]))
        seen[:] = torch.tensor(down, dtype=torch.float)[:, None]
        contacts.update()
        paid += (contacts.air_time * contacts.landed)[:, 0]
    np.testing.assert_allclose(paid, (0.0, 0.0, 0.04, 0.0), atol=1e-7)


def test_pushes_come_on_time_and_a_saved_environment_goes_on_bit_identically(make_env):
    random = replace(TaskConfig().randomisation, push=0.5, push_interval=0.1, stagger=False)
    pushed = make_env(TaskConfig(randomisation=random))
    calm = make_env(TaskConfig(randomisation=replace(random, push=0.0)))
    actions = shaken(pushed, 20)
    pushed.reset(seed=0)
    calm.reset(seed=0)
    for t, action in enumerate(actions[:5], start=1):
        obs, *_ = pushed.step(action)
        calm.step(action)
        kick = (pushed.sim.qvel - calm.sim.qvel)[:, :6].abs()
        assert (kick.max() > 0.1) == (t == 5)
    assert kick[:, :2].max() <= 0.5
    assert kick[:, 2:].max() == 0.0

    # right after a push, when the observation must already show it
    saved = pushed.state_dict()
    other = make_env(TaskConfig(randomisation=random))
    restored = other.load_state_dict(saved)
    assert all(torch.equal(restored[group], values) for group, values in obs.items())
    for action in actions[5:]:
        ours, theirs = pushed.step(action), other.step(action)
        assert all(torch.equal(ours[0][group], theirs[0][group]) for group in obs)
        assert all(torch.equal(a, b) for a, b in zip(ours[1:4], theirs[1:4], strict=True))


def test_actions_are_clipped(make_env):
    env = make_env(QUIET)
    env.reset(seed=0)
    obs, *_ = env.step(torch.full((8, 12), 100.0))
    assert (obs["proprio"][:, env.layout.column("proprio", "last_action")] == 6.0).all()
    assert torch.allclose(env.sim.ctrl.float(), env.stance_ctrl + 0.25 * 6.0)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (torch.zeros(12), r"an action is \(8, 12\), a row for each robot; got \(12,\)"),
        (torch.zeros(1, 12), r"got \(1, 12\)"),
        (torch.zeros(8, 11), r"got \(8, 11\)"),
        (torch.zeros(8, 12).index_fill(0, torch.tensor([2, 5]), math.nan), r"NaN for 2 of 8 robots \(2, 5\)"),
    ],
)
def test_actions_that_cannot_be_change_nothing(make_env, action, message):
    env, untouched = make_env(), make_env()
    for each in (env, untouched):
        each.reset(seed=0)
        each.step(torch.ones(8, 12))
    with pytest.raises(ValueError, match=message):
        env.step(action)
    for (name, value), expected in zip(env.state_dict().items(), untouched.state_dict().values(), strict=True):
        torch.testing.assert_close(value, expected, rtol=0.0, atol=0.0, msg=name)


def test_arrays_of_any_precision_are_actions(make_env):
    env, other = make_env(), make_env()
    env.reset(seed=0), other.reset(seed=0)
    obs, *_ = env.step(torch.full((8, 12), 0.5))
    same, *_ = other.step(np.full((8, 12), 0.5))
    for group, values in obs.items():
        torch.testing.assert_close(same[group], values, rtol=0.0, atol=0.0)


def test_bodies_without_a_stance_and_wrong_shapes_are_refused(factory, designs, make_env):
    lame = designs.copy()
    lame[3] = (1.4, 0.6, 0.6, 0.6)
    with pytest.raises(ValueError, match=r"robot 3 with design .* has no stance"):
        make_env(designs=lame)
    with pytest.raises(ValueError, match=r"designs must be \(n, 4\), got \(8, 3\)"):
        make_env(designs=designs[:, :3])
    with pytest.raises(ValueError, match=r"designs must be \(n, 4\), got \(0, 4\)"):
        make_env(designs=designs[:0])
