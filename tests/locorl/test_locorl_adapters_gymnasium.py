"""The gymnasium environments against the raw environment and gymnasium's own checkers and vectorisation."""

from __future__ import annotations

import importlib
import math
import sys
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics
from locorl import CommandConfig, LeggedEnv, TaskConfig, no_randomisation
from locorl.adapters.gymnasium import GymEnv, GymVectorEnv
from locorl.play.errors import PlayError
from locorl.play.renderer import gl_context
from locorl.tasks import make_task

ID = "locorl/Legged-v0"
STEPS = 12
SHORT = TaskConfig(episode_seconds=STEPS * 0.02)
"""Random and staggered, with episodes of 12 steps."""
CALM = replace(
    SHORT,
    randomisation=no_randomisation(),
    command=CommandConfig((0.5, 0.5), (0.0, 0.0), (0.0, 0.0), standing=0.0),
)
"""Nothing random."""
STRICT = replace(CALM, max_tilt=0.15, min_height=0.95)
"""The same where many robots count as fallen."""
RICH = replace(
    make_task("parkour-highjump"),
    episode_seconds=STEPS * 0.02,
    randomisation=replace(
        SHORT.randomisation, push=0.5, push_interval=0.06, action_delay=(0, 2), observation_noise=1.0
    ),
)
"""With curriculum, waypoints, scan, pushes, delays and noise."""
ENDLESS = replace(CALM, episode_seconds=1000.0, max_tilt=math.pi, min_height=-10.0, end_on_base_contact=False)
"""The same without any end of an episode."""


def actions(count: int, robots: int, size: float = 6.0) -> np.ndarray:
    """Random actions: large ones tilt the robots, of small ones they take no notice."""
    return np.random.default_rng(2).uniform(-size, size, (count, robots, 12)).astype(np.float32)


def assert_same(a, b) -> None:
    """Nested dicts, lists and arrays are equal to the last bit."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    else:
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


@pytest.mark.parametrize(("task", "flat"), [(SHORT, False), (RICH, True)], ids=["groups", "flat"])
def test_steps_are_those_of_the_environment(make_env, task, flat):
    raw, envs = make_env(task), GymVectorEnv(make_env(task), flat)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP

    def check(obs, expected):
        assert obs in envs.observation_space
        if flat:
            assert_same(obs, torch.cat([expected[group] for group in raw.group_dims], dim=1))
        else:
            assert_same(obs, {group: values.numpy() for group, values in expected.items()})

    obs, infos = envs.reset(seed=3)
    assert infos == {}
    check(obs, raw.reset(seed=3))
    for action in actions(30, 8):
        expected, *ends, info = raw.step(torch.from_numpy(action))
        obs, reward, terminated, truncated, infos = envs.step(action)
        check(obs, expected)
        assert (reward.shape, terminated.dtype, truncated.dtype) == ((8,), np.bool_, np.bool_)
        for value, end in zip((reward, terminated, truncated), ends, strict=True):
            assert_same(value, end.numpy())
        assert_same(infos["position"], info.position.numpy())
        assert_same(infos["_position"], ~(terminated | truncated))


def test_spaces(make_env):
    env = make_env()
    envs = GymVectorEnv(env)
    assert {g: space.shape for g, space in envs.single_observation_space.items()} == {
        group: (size,) for group, size in env.group_dims.items()
    }
    assert all(space.dtype == np.float32 for space in envs.observation_space.values())
    assert envs.action_space.shape == (8, 12)
    assert envs.action_space.high.max() == envs.action_space.high.min() == env.task.action_clip
    assert GymVectorEnv(env, flat=True).observation_space.shape == (8, sum(env.group_dims.values()))


def test_recorded_episodes_are_sums_of_the_raw_environment(make_env):
    raw = make_env(SHORT)
    envs = RecordEpisodeStatistics(GymVectorEnv(make_env(SHORT)))
    envs.reset(seed=1)
    raw.reset(seed=1)
    returns, lengths, episodes = np.zeros(8), np.zeros(8, dtype=int), 0
    for action in actions(60, 8):
        _, reward, terminated, truncated, _ = raw.step(torch.from_numpy(action))
        *_, infos = envs.step(action)
        returns += reward.numpy()
        lengths += 1
        done = (terminated | truncated).numpy()
        assert ("episode" in infos) == done.any()
        if done.any():
            assert_same(infos["_episode"], done)
            np.testing.assert_allclose(infos["episode"]["r"][done], returns[done], rtol=1e-12)
            assert_same(infos["episode"]["l"][done], lengths[done])
            episodes += done.sum()
        returns[done], lengths[done] = 0.0, 0
    assert episodes == envs.episode_count > 20


@pytest.mark.parametrize("task", [SHORT, RICH], ids=["short", "rich"])
def test_equal_seeds_give_equal_rollouts(make_env, task):
    def rollout(envs: GymVectorEnv, seed: int) -> list:
        # a number of steps after which nothing periodic is back at its start
        return [envs.reset(seed=seed)[0], *(envs.step(action)[:4] for action in actions(23, 8))]

    one, other = (GymVectorEnv(make_env(task), flat=True) for _ in range(2))
    first = rollout(one, 7)
    for again in (rollout(one, 7), rollout(other, 7)):
        assert all(np.array_equal(a, b) for x, y in zip(first, again, strict=True) for a, b in zip(x, y, strict=True))
    assert not np.array_equal(first[0], one.reset(seed=8)[0])


def follow(envs: GymVectorEnv, endless: LeggedEnv, size: float) -> dict[str, int]:
    """Step both until the first end of each robot's episode and check the observations there."""
    first, _ = envs.reset()
    endless.reset()
    running, ends = np.ones(endless.num_envs, dtype=bool), {"terminated": 0, "truncated": 0}
    for action in actions(STEPS, endless.num_envs, size):
        # the endless robots know of no end, so their observation is the last of the old episode
        last, *_, info = endless.step(torch.from_numpy(action))
        obs, _, terminated, truncated, infos = envs.step(action)
        done = terminated | truncated
        assert ("final_obs" in infos) == done.any()
        for robot in np.flatnonzero(done & running):
            assert infos["_final_obs"][robot]
            final, past = infos["final_obs"][robot], infos["final_info"]
            assert_same(final, {group: values[robot].numpy() for group, values in last.items()})
            assert final in envs.single_observation_space
            assert_same(past["position"][robot], info.position[robot].numpy())
            # nothing is random, so all episodes begin alike
            assert_same({g: values[robot] for g, values in obs.items()}, {g: v[robot] for g, v in first.items()})
            ends["terminated" if terminated[robot] else "truncated"] += 1
        running &= ~done
        if done.any():
            assert_same(infos["_final_info"], done)
            assert_same(infos["_final_obs"], done)
            assert [final is not None for final in infos["final_obs"]] == done.tolist()
    return ends


def test_truncated_robots_show_their_last_and_their_next_observation(make_env):
    assert follow(GymVectorEnv(make_env(CALM)), make_env(ENDLESS), 0.3) == {"terminated": 0, "truncated": 8}


def test_terminated_robots_show_their_last_and_their_next_observation(make_env):
    assert follow(GymVectorEnv(make_env(STRICT)), make_env(ENDLESS), 6.0)["terminated"] >= 3


def test_agrees_with_gymnasiums_vectorisation_of_single_robots(make_env, designs):
    """Through many ends of episodes, infos included; nothing is random, so the random streams do not matter."""
    single = [lambda d=design: GymEnv(make_env(CALM, designs=d[None])) for design in designs[:3]]
    expected = DictInfoToList(SyncVectorEnv(single, autoreset_mode=AutoresetMode.SAME_STEP))
    envs = DictInfoToList(GymVectorEnv(make_env(CALM, designs=designs[:3])))
    assert envs.observation_space == expected.observation_space
    assert envs.action_space == expected.action_space
    assert_same(envs.reset(seed=0)[0], expected.reset(seed=0)[0])
    ends = np.zeros(2, dtype=int)
    for action in actions(50, 3):
        *got, infos = envs.step(action)
        *want, expected_infos = expected.step(action)
        for a, b in zip((*got, *infos), (*want, *expected_infos), strict=True):
            assert_same(a, b)
        ends += [got[2].sum(), got[3].sum()]
    assert ends.min() >= 1


def test_next_episode_starts_where_the_environment_already_stands(make_env, designs):
    """A reset after an end takes nothing more from the random stream."""
    task = replace(SHORT, randomisation=replace(SHORT.randomisation, stagger=False))
    envs, env = GymVectorEnv(make_env(task, designs=designs[:1])), GymEnv(make_env(task, designs=designs[:1]))
    batch, _ = envs.reset(seed=4)
    obs, _ = env.reset(seed=4)
    episodes = 0
    for action in actions(60, 1):
        assert_same(obs, {group: values[0] for group, values in batch.items()})
        batch, *_ = envs.step(action)
        obs, _, terminated, truncated, _ = env.step(action[0])
        if terminated or truncated:
            obs, _ = env.reset()
            episodes += 1
    assert episodes >= 5


def test_flat_is_what_gymnasium_makes_of_the_groups(make_env):
    groups, flat = GymVectorEnv(make_env(SHORT)), GymVectorEnv(make_env(SHORT), flat=True)
    single = groups.single_observation_space
    assert flat.single_observation_space == gymnasium.spaces.flatten_space(single)
    groups.reset(seed=0)
    flat.reset(seed=0)
    ended = 0
    for action in actions(STEPS, 8):
        (obs, *_, infos), (vectors, *_, flat_infos) = groups.step(action), flat.step(action)
        expected = [gymnasium.spaces.flatten(single, {g: v[i] for g, v in obs.items()}) for i in range(8)]
        assert_same(vectors, expected)
        for robot in np.flatnonzero(infos.get("_final_obs", ())):
            final = gymnasium.spaces.flatten(single, infos["final_obs"][robot])
            assert_same(flat_infos["final_obs"][robot], final)
            ended += 1
    assert ended >= 8


def test_returned_arrays_are_the_callers(make_env):
    envs, untouched = GymVectorEnv(make_env(SHORT)), GymVectorEnv(make_env(SHORT))
    obs, _ = envs.reset(seed=0)
    untouched.reset(seed=0)
    for values in obs.values():
        values.fill(np.nan)
    for action in actions(15, 8):
        obs, *_, infos = envs.step(action)
        assert_same(obs, untouched.step(action)[0])
        for values in (*obs.values(), infos["velocity"], infos["position"]):
            values.fill(np.nan)


# ------------------------------------------------------------------------------------------ one robot


@pytest.fixture(scope="module")
def opengl() -> bool:
    try:
        gl_context(16, 16).free()
    except PlayError:
        return False
    return True


EXPLAINED = (
    "minimum value is -infinity",  # observations have no bounds
    "maximum value is infinity",
    "symmetric and normalized",  # actions are those of LeggedEnv; RescaleAction normalises them
)


@pytest.mark.parametrize(("task", "flat"), [(SHORT, False), (RICH, True)], ids=["groups", "flat"])
def test_gymnasiums_checker_passes(factory, opengl, task, flat):
    rendered = opengl and not flat
    env = gymnasium.make(ID, robot=factory, task=task, flat=flat, render_mode="rgb_array" if rendered else None)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=not rendered)
    unexplained = [str(w.message) for w in caught if not any(text in str(w.message) for text in EXPLAINED)]
    assert unexplained == []
    env.close()


def test_renders_its_own_body_as_it_moves(make_env, opengl, designs):
    if not opengl:
        pytest.skip("no OpenGL")

    def pictures(design, steps):
        env = GymEnv(make_env(CALM, designs=design[None]), render_mode="rgb_array")
        env.reset(seed=0)
        frames = [env.render()]
        for action in actions(steps, 1):
            env.step(action[0])
            frames.append(env.render())
        env.close()
        return frames

    stood, moved = pictures(np.full(4, 1.3), 1)
    assert (stood.shape, stood.dtype) == ((360, 480, 3), np.uint8)
    assert (stood != moved).any()
    assert (stood != pictures(np.full(4, 0.7), 0)[0]).any()


def test_without_a_render_mode_there_is_no_picture(make_env, designs):
    assert GymEnv(make_env(CALM, designs=designs[:1])).render() is None
    assert GymVectorEnv(make_env(CALM)).render() is None


def test_registered(factory, designs):
    envs = gymnasium.make_vec(ID, num_envs=8, robot=factory, designs=designs, task=SHORT, threads=1)
    assert isinstance(envs.unwrapped, GymVectorEnv)
    assert_same(envs.unwrapped.env.bodies.designs, designs)
    sampled = gymnasium.make_vec(ID, num_envs=3, robot=factory, task=SHORT, threads=1)
    assert len(np.unique(sampled.unwrapped.env.bodies.designs, axis=0)) == 3
    env = gymnasium.make(ID, robot=factory, task=SHORT)
    assert_same(env.unwrapped.env.bodies.designs, factory.space.nominal[None])
    assert gymnasium.make(ID, robot=factory, task="locomotion-steps").unwrapped.env.task.name == "locomotion-steps"
    env.reset(seed=0)
    ages = [env.step(np.zeros(12, dtype=np.float32))[3] for _ in range(STEPS)]
    assert ages == [False] * (STEPS - 1) + [True]


def test_refuses_what_it_cannot_do(make_env, factory, designs):
    envs = GymVectorEnv(make_env(CALM))
    with pytest.raises(ValueError, match=r"\(8, 12\), got \(12,\)"):
        envs.step(np.zeros(12, dtype=np.float32))
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.ones(8, dtype=bool)})
    with pytest.raises(ValueError, match="GymVectorEnv"):
        GymEnv(make_env(CALM))
    with pytest.raises(ValueError, match="stagger=False"):
        GymEnv(make_env(SHORT, designs=designs[:1]))
    with pytest.raises(ValueError, match="rgb_array"):
        GymEnv(make_env(CALM, designs=designs[:1]), render_mode="human")
    with pytest.raises(ValueError, match="8 designs for 3 robots"):
        gymnasium.make_vec(ID, num_envs=3, robot=factory, designs=designs)


def test_says_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "locorl.adapters.gymnasium")
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ImportError, match=r"pip install legged-locorl\[gym\]"):
        importlib.import_module("locorl.adapters.gymnasium")
