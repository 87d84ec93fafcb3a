"""The rsl_rl environment against the raw environment, and rsl_rl's own runner on it."""

from __future__ import annotations

import importlib
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from locorl import EvalConfig, NetworkConfig, PPOConfig, TaskConfig, evaluate
from locorl.adapters.rsl_rl import RslRlActor, RslRlVecEnv, rsl_rl_config
from locorl.env.observation import ObservationConfig
from locorl.env.scan import ScanConfig
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.utils import LogWriter
from tensordict import TensorDict

STEPS = 12
SHORT = TaskConfig(episode_seconds=STEPS * 0.02, max_tilt=0.3)
"""Episodes of 12 steps, in which many robots count as fallen."""


def actions(count: int) -> torch.Tensor:
    """Random actions, from none at the first robot to large ones at the last."""
    size = np.linspace(0.0, 6.0, 8)[:, None]
    return torch.from_numpy((size * np.random.default_rng(2).uniform(-1, 1, (count, 8, 12))).astype(np.float32))


@pytest.fixture
def train(make_env, tiny):
    """Train for a few iterations and give the runner and its environment."""

    def run(seed: int = 0, iterations: int = 3, log_dir=None, **changes):
        env = RslRlVecEnv(make_env(SHORT, seed=seed))
        torch.manual_seed(seed)
        config = rsl_rl_config(env, tiny.ppo, tiny.network) | changes
        runner = OnPolicyRunner(env, config, log_dir=None if log_dir is None else str(log_dir))
        runner.start = {name: value.clone() for name, value in weights(runner).items()}
        runner.losses = []
        update = runner.alg.update
        runner.alg.update = lambda: runner.losses.append(update()) or runner.losses[-1]
        runner.learn(iterations)
        return runner, env

    return run


def weights(runner: OnPolicyRunner) -> dict[str, torch.Tensor]:
    models = {"actor": runner.alg.actor, "critic": runner.alg.critic}
    return {f"{name}.{key}": value for name, model in models.items() for key, value in model.state_dict().items()}


# ------------------------------------------------------------------------------------------ environment


def test_steps_are_those_of_the_environment(make_env):
    """Observations, rewards, ends and log; time-outs are truncations, never falls."""
    raw = make_env(SHORT, seed=3)
    expected = raw.reset()
    env = RslRlVecEnv(make_env(SHORT, seed=3))
    assert isinstance(env, VecEnv)
    assert (env.num_envs, env.num_actions, env.max_episode_length, env.device) == (8, 12, STEPS, raw.device)
    assert env.cfg["episode_seconds"] == SHORT.episode_seconds

    def check(obs: TensorDict) -> None:
        assert obs.batch_size == (8,)
        assert set(obs.keys()) == set(raw.group_dims)
        for group, values in expected.items():
            assert torch.equal(obs[group], values), group

    check(env.get_observations())
    ends = torch.zeros(2)
    for action in actions(30):
        expected, reward, terminated, truncated, info = raw.step(action)
        obs, rewards, dones, extras = env.step(action)
        check(obs)
        check(env.get_observations())
        assert torch.equal(rewards, reward)
        assert torch.equal(dones, (terminated | truncated).long())
        assert torch.equal(extras["time_outs"], truncated)
        assert torch.equal(env.episode_length_buf, raw.episode_step)
        log = extras["log"]
        for name, value in info.reward_terms.items():
            assert float(log[f"reward/{name}"]) == pytest.approx(float(value) / 0.02)
        assert float(log["reward/total"]) == pytest.approx(float(reward.mean()) / 0.02)
        assert float(log["episode/tracking_error"]) == pytest.approx(float(info.tracking_error.mean()))
        assert float(log["episode/falls"]) == pytest.approx(int(terminated.sum()) / 8 / 0.02)
        assert float(log["episode/diverged"]) == 0.0
        assert all("/" in name for name in log)
        ends += torch.tensor([terminated.sum(), truncated.sum()])
    assert ends.min() >= 5


def test_observations_outlive_the_next_step(make_env):
    """rsl_rl stores an observation only after it has stepped on."""
    env = RslRlVecEnv(make_env(replace(SHORT, observation=ObservationConfig(history=3, scan=ScanConfig(spacing=0.5)))))
    obs = env.get_observations()
    copy = obs.clone()
    for action in actions(STEPS):
        following, *_ = env.step(action)
        assert all(torch.equal(obs[group], copy[group]) for group in obs.keys())  # noqa: SIM118
        obs, copy = following, following.clone()


def test_episode_ages_can_be_set(make_env):
    env = RslRlVecEnv(make_env(replace(SHORT, max_tilt=3.0, min_height=0.0, end_on_base_contact=False)))
    ages = torch.tensor([0, 2, 4, 6, 8, 10, 11, 11])
    env.episode_length_buf = ages
    lasted = torch.zeros(8, dtype=torch.long)
    running = torch.ones(8, dtype=torch.bool)
    for _ in range(STEPS):
        _, _, _, extras = env.step(torch.zeros(8, 12))
        lasted += running
        running &= ~extras["time_outs"]
    assert torch.equal(lasted, STEPS - ages)


# ------------------------------------------------------------------------------------------ training


def test_time_outs_are_bootstrapped_and_falls_are_not(make_env, tiny):
    env = RslRlVecEnv(make_env(replace(SHORT, max_tilt=0.15)))
    runner = OnPolicyRunner(env, rsl_rl_config(env, replace(tiny.ppo, steps=20), tiny.network))
    ends = torch.zeros(2)
    with torch.inference_mode():
        obs = env.get_observations()
        for step in range(20):
            value = runner.alg.critic(obs).squeeze(1).clone()
            obs, reward, dones, extras = env.step(runner.alg.act(obs))
            runner.alg.process_env_step(obs, reward, dones, extras)
            stored = runner.alg.storage.rewards[step].squeeze(1)
            timed_out = extras["time_outs"]
            torch.testing.assert_close(stored, reward + tiny.ppo.gamma_reg * value * timed_out)
            assert torch.equal(runner.alg.storage.dones[step].squeeze(1).long(), dones)
            ends += torch.tensor([timed_out.sum(), (dones.bool() & ~timed_out).sum()])
    assert ends.min() >= 1


def test_runner_trains(train):
    runner, env = train()
    assert len(runner.losses) == 3
    assert all(np.isfinite(list(losses.values())).all() for losses in runner.losses)
    for name, value in weights(runner).items():
        assert not torch.equal(value, runner.start[name]), name
    # what the runner did in inference mode binds nobody afterwards
    env.env.reset()
    env.env.step(torch.zeros(8, 12))
    runner.learn(1, init_at_random_ep_len=True)
    assert len(runner.losses) == 4


def test_same_seed_gives_the_same_weights(train):
    (one, _), (again, _), (other, _) = train(seed=0), train(seed=0), train(seed=1)
    assert all(torch.equal(value, weights(again)[name]) for name, value in weights(one).items())
    assert not any(torch.equal(value, weights(other)[name]) for name, value in weights(one).items())


class Recorder(LogWriter):
    rows: dict[str, list[float]] = {}  # noqa: RUF012

    def __init__(self, log_dir: str) -> None:
        self.rows.clear()

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        self.rows.setdefault(tag, []).append(float(scalar_value))


def test_runner_logs_reward_terms_and_tracking_error(train, tmp_path):
    runner, env = train(log_dir=tmp_path, logger={"class_name": Recorder})
    _, _, _, extras = env.step(torch.zeros(8, 12))
    assert set(extras["log"]) <= set(Recorder.rows)
    assert "episode/tracking_error" in extras["log"]
    assert all(np.isfinite(values).all() and len(values) == 3 for values in map(Recorder.rows.get, extras["log"]))
    assert Recorder.rows["Train/mean_episode_length"][-1] <= STEPS
    assert (tmp_path / "model_2.pt").is_file()


@pytest.mark.parametrize("ppo", [PPOConfig(mirror=True), PPOConfig(regulariser="ppg")])
def test_what_rsl_rl_lacks_is_refused(make_env, ppo):
    with pytest.raises(ValueError, match="rsl_rl"):
        rsl_rl_config(make_env(SHORT), ppo)


def test_the_unregularised_discount_reaches_the_algorithm(make_env):
    config = rsl_rl_config(make_env(SHORT), PPOConfig(regulariser="none", gamma=0.995))
    assert config["algorithm"]["gamma"] == 0.995


def test_configuration_reaches_the_algorithm(make_env):
    """Every hyperparameter of ours, none at its default."""
    env = make_env(SHORT)
    ppo = PPOConfig(
        gamma_reg=0.97,
        lam=0.9,
        steps=3,
        epochs=2,
        minibatches=3,
        clip=0.1,
        entropy=0.01,
        value_weight=0.5,
        learning_rate=2e-4,
        desired_kl=0.02,
        max_grad_norm=0.7,
    )
    changed = {f.name for f in fields(ppo) if getattr(ppo, f.name) != getattr(PPOConfig(), f.name)}
    of_regularisers = {"regulariser", "gamma", "activation_weight", "v_max", "ppg", "mirror"}
    assert changed == {f.name for f in fields(ppo)} - {"min_learning_rate", "max_learning_rate"} - of_regularisers
    network = NetworkConfig(actor=(16, 8), critic=(12,), initial_std=0.5, min_std=0.4)
    config = rsl_rl_config(env, ppo, network, actor=("proprio", "explicit"))
    alg = OnPolicyRunner(RslRlVecEnv(env), config).alg
    assert (alg.gamma, alg.lam, alg.storage.num_transitions_per_env) == (0.97, 0.9, 3)
    assert (alg.num_learning_epochs, alg.num_mini_batches, alg.clip_param, alg.entropy_coef) == (2, 3, 0.1, 0.01)
    assert (alg.value_loss_coef, alg.learning_rate, alg.desired_kl, alg.max_grad_norm) == (0.5, 2e-4, 0.02, 0.7)
    assert alg.schedule == "adaptive"
    dims = env.group_dims
    layers = [[layer.in_features for layer in m.mlp if hasattr(layer, "in_features")] for m in (alg.actor, alg.critic)]
    assert layers == [[dims["proprio"] + dims["explicit"], 16, 8], [sum(dims.values()), 12]]
    obs = RslRlVecEnv(env).get_observations()
    alg.actor(obs, stochastic_output=True)
    torch.testing.assert_close(alg.actor.output_std, torch.full((8, 12), 0.5))
    with torch.no_grad():
        alg.actor.distribution.log_std_param.fill_(-5.0)
    alg.actor(obs, stochastic_output=True)
    torch.testing.assert_close(alg.actor.output_std, torch.full((8, 12), 0.4))


def test_unknown_groups_are_refused(make_env):
    with pytest.raises(ValueError, match=r"camera.*proprio"):
        rsl_rl_config(make_env(), actor=("proprio", "camera"))


# ------------------------------------------------------------------------------------------ policy


def test_learnt_policy_is_an_actor(train, factory, designs, make_env):
    runner, _ = train(iterations=1)
    actor = RslRlActor(runner.get_inference_policy())
    obs = make_env().reset()
    by_hand = torch.cat(list(obs.values()), dim=1)
    for layer in runner.alg.actor.mlp:
        by_hand = layer(by_hand)
    action = actor.act(obs)
    assert not action.requires_grad
    torch.testing.assert_close(action, by_hand.detach())
    assert torch.equal(action, actor.act(obs))  # no exploration

    class Counted(RslRlActor):
        calls = 0

        def act(self, obs):
            self.calls += 1
            return super().act(obs)

    counted = Counted(runner.get_inference_policy())
    config = EvalConfig(seconds=0.5, settle=0.1)
    result = evaluate(counted, factory, designs[:2], SHORT, config, threads=1)
    again = evaluate(counted, factory, designs[:2], SHORT, config, threads=1)
    assert counted.calls == 50
    assert result.returns.shape == (2, 1)
    assert np.array_equal(result.returns, again.returns)


def test_recurrent_policy_forgets_at_a_reset(make_env, tiny):
    env = RslRlVecEnv(make_env(SHORT))
    config = rsl_rl_config(env, tiny.ppo, tiny.network)
    config["actor"] |= {"class_name": "RNNModel", "rnn_hidden_dim": 8, "rnn_num_layers": 1}
    actor = RslRlActor(OnPolicyRunner(env, config).get_inference_policy())
    obs = env.get_observations()
    first = actor.act(obs)
    assert not torch.isclose(actor.act(obs), first).all(dim=1).any()
    actor.reset(torch.tensor([True] + [False] * 7))
    after = torch.isclose(actor.act(obs), first).all(dim=1)
    assert after.tolist() == [True] + [False] * 7
    actor.reset()
    torch.testing.assert_close(actor.act(obs), first)


def test_says_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "locorl.adapters.rsl_rl")
    monkeypatch.setitem(sys.modules, "rsl_rl.env", None)
    with pytest.raises(ImportError, match=r"pip install legged-locorl\[rsl-rl\]"):
        importlib.import_module("locorl.adapters.rsl_rl")
