"""PPO by hand, against torch.distributions, and on a problem that it has to solve."""

from __future__ import annotations

import math

import pytest
import torch
from locorl import PPO, ActorCritic, DivergedError, NetworkConfig, PPOConfig, StepInfo
from locorl.learning.storage import Minibatch, Rollout
from torch.distributions import Independent, Normal, kl_divergence

DIMS = {"proprio": 3, "explicit": 1, "implicit": 2}
NETWORK = NetworkConfig(actor=(16,), critic=(16,), encoder=(8,), latent=3)


class TargetEnv:
    """Reward -|action - f(obs)|^2; episodes end by time or by a fall at fixed steps."""

    dt = 0.02

    def __init__(self, num_envs: int = 32, poison: bool = False) -> None:
        self.num_envs, self.poison, self.t = num_envs, poison, 0
        self.generator = torch.Generator().manual_seed(0)
        self.matrix = torch.tensor([[0.8, -0.5], [0.0, 0.6], [-0.4, 0.0]])

    def observe(self) -> dict[str, torch.Tensor]:
        def draw(size: int) -> torch.Tensor:
            return torch.randn(self.num_envs, size, generator=self.generator)

        self.obs = {group: draw(size) for group, size in DIMS.items()}
        return self.obs

    def target(self, obs: dict[str, torch.Tensor]) -> torch.Tensor:
        return obs["proprio"] @ self.matrix + 0.5 * obs["implicit"]

    def step(self, action: torch.Tensor):
        self.t += 1
        reward = -(action - self.target(self.obs)).square().sum(dim=1)
        if self.poison:
            reward[1] = float("nan")
        robots = torch.arange(self.num_envs)
        terminated, truncated = (robots == 0) & (self.t == 2), (robots == 1) & (self.t == 3)
        ids = truncated.nonzero().flatten()
        self.final = {group: values[ids] for group, values in self.observe().items()}
        zeros = torch.zeros(self.num_envs)
        info = StepInfo(
            ids, self.final, {"target": reward.mean()}, zeros, zeros, zeros, zeros.bool(), zeros, zeros, zeros.bool()
        )
        if len(ids):
            self.last = self.final
        return self.observe(), reward, terminated, truncated, info


def make(config: PPOConfig | None = None, num_envs: int = 32, seed: int = 0) -> PPO:
    torch.manual_seed(seed)
    return PPO(ActorCritic(DIMS, 2, NETWORK), config or PPOConfig(steps=4), num_envs, DIMS, seed)


def gaussian(model: ActorCritic, mean: torch.Tensor) -> Independent:
    return Independent(Normal(mean, model.std()), 1)


@pytest.fixture
def model() -> ActorCritic:
    torch.manual_seed(1)
    model = ActorCritic(DIMS, 5, NETWORK)
    with torch.no_grad():
        model.log_std.copy_(torch.tensor([-1.0, 0.0, 0.5, -0.3, -9.0]))  # the last is held at the floor
    return model


def test_log_prob_and_entropy_against_torch(model):
    mean, action = torch.randn(2, 7, 5)
    truth = gaussian(model, mean)
    torch.testing.assert_close(model.log_prob(mean, action), truth.log_prob(action))
    torch.testing.assert_close(model.entropy(), truth.entropy()[0])
    assert model.std()[-1].item() == pytest.approx(NETWORK.min_std)


def test_the_actor_sees_the_implicit_group_through_the_latent_alone(model):
    obs = {group: torch.randn(4, size) for group, size in DIMS.items()}
    joined = torch.cat((obs["proprio"], obs["explicit"], model.latent(obs)), dim=1)
    torch.testing.assert_close(model.act(obs), model.actor(joined))
    assert model.latent(obs).shape == (4, 3)
    assert model.value(obs).shape == (4,)


def test_kl_against_torch():
    ppo = make()
    old_mean, mean = torch.randn(2, 9, 2)
    old = Independent(Normal(old_mean, torch.tensor([0.7, 1.3])), 1)
    truth = kl_divergence(old, gaussian(ppo.model, mean)).mean()
    assert ppo._kl(mean, old_mean, torch.tensor([0.7, 1.3])) == pytest.approx(truth.item(), rel=1e-5)


@pytest.mark.parametrize(
    ("kl", "factor"), [(0.021, 1 / 1.5), (0.0199, 1.0), (0.01, 1.0), (0.0051, 1.0), (0.0049, 1.5), (0.0, 1.0)]
)
def test_the_learning_rate_follows_the_divergence(kl, factor):
    ppo = make(PPOConfig(desired_kl=0.01, learning_rate=1e-3))
    ppo._adapt(kl)
    assert ppo.learning_rate == pytest.approx(1e-3 * factor)
    assert ppo.optimizer.param_groups[0]["lr"] == ppo.learning_rate


def test_the_learning_rate_stays_in_its_bounds():
    ppo = make(PPOConfig(min_learning_rate=9e-4, max_learning_rate=1.1e-3, learning_rate=1e-3))
    ppo._adapt(1.0)
    assert ppo.learning_rate == 9e-4
    for _ in range(3):
        ppo._adapt(1e-4)
    assert ppo.learning_rate == 1.1e-3


@pytest.mark.parametrize(
    ("ratio", "advantage", "surrogate"),
    [(1.1, 2.0, -2.2), (1.5, 2.0, -2.4), (1.5, -2.0, 3.0), (0.5, 2.0, -1.0), (0.5, -2.0, 1.6)],
)
def test_the_clipped_surrogate_by_hand(ratio, advantage, surrogate):
    ppo = make(PPOConfig(clip=0.2))
    loss, _ = ppo._losses(*batch(ppo, ratio=ratio, advantage=advantage))
    assert loss.item() == pytest.approx(surrogate, rel=1e-4)


@pytest.mark.parametrize(
    ("old", "target", "expected"),  # the critic now says 0; a step of at most 0.2 from the old value is trusted
    [(0.1, 1.0, 1.0), (-0.5, 1.0, 1.3**2), (0.5, 1.0, 1.0), (1.0, -1.0, 1.8**2)],
)
def test_the_clipped_value_loss_by_hand(old, target, expected):
    ppo = make(PPOConfig(clip=0.2))
    for parameter in ppo.model.critic.parameters():
        torch.nn.init.zeros_(parameter)
    _, loss = ppo._losses(*batch(ppo, value=old, target=target))
    assert loss.item() == pytest.approx(expected, rel=1e-5)


def batch(ppo: PPO, ratio=1.0, advantage=0.0, value=0.0, target=0.0) -> tuple[torch.Tensor, Minibatch]:
    obs = {group: torch.randn(1, size) for group, size in DIMS.items()}
    mean = ppo.model.act(obs)
    action = mean.detach() + 0.3
    log_prob = gaussian(ppo.model, mean).log_prob(action).detach() - math.log(ratio)
    numbers = (torch.tensor([x]) for x in (value, advantage, target))
    return mean, Minibatch(obs, action, mean.detach(), log_prob, *numbers)


def test_minibatches_visit_each_transition_once():
    rollout = Rollout(5, 3, {"proprio": 2}, 1)
    numbers = torch.arange(15.0).view(5, 3)
    rollout.value[:], rollout.advantage[:], rollout.target[:] = numbers, numbers + 100, numbers + 200
    rollout.log_prob[:], rollout.action[:], rollout.mean[:] = -numbers, numbers[..., None], numbers[..., None] * 2
    rollout.obs["proprio"][:] = torch.stack((numbers, -numbers), dim=-1)
    generator = torch.Generator().manual_seed(0)
    batches = list(rollout.minibatches(4, generator))
    assert sorted(len(batch.value) for batch in batches) == [3, 4, 4, 4]
    visited = torch.cat([batch.value for batch in batches])
    assert sorted(visited.tolist()) == list(range(15))
    assert visited.tolist() != list(range(15))  # shuffled
    for each in batches:  # all columns of a row belong together
        v = each.value
        assert torch.equal(each.advantage, v + 100)
        assert torch.equal(each.target, v + 200)
        assert torch.equal(each.log_prob, -v)
        assert torch.equal(each.action[:, 0], v)
        assert torch.equal(each.mean[:, 0], 2 * v)
        assert torch.equal(each.obs["proprio"], torch.stack((v, -v), dim=1))
    again = torch.cat([batch.value for batch in rollout.minibatches(4, generator)])
    assert not torch.equal(again, visited)


def test_a_rollout_bootstraps_with_the_state_it_was_cut_in():
    ppo, env = make(num_envs=4), TargetEnv(4)
    obs, stats = ppo.collect(env, env.observe())
    rollout = ppo.rollout
    assert rollout.terminated.nonzero().tolist() == [[1, 0]]
    assert rollout.done.nonzero().tolist() == [[1, 0], [2, 1]]
    with torch.no_grad():
        expected = torch.cat((rollout.value[1:], ppo.model.value(obs)[None]))
        expected[2, 1] = ppo.model.value(env.last)[0]
    torch.testing.assert_close(rollout.next_value, expected)
    truth = gaussian(ppo.model, rollout.mean).log_prob(rollout.action)
    torch.testing.assert_close(rollout.log_prob, truth.detach())
    assert stats["reward"] == pytest.approx(rollout.reward.mean().item() / env.dt, rel=1e-5)
    assert stats["fall_rate"] == pytest.approx(1 / 16 / env.dt)


def test_gamma_reg_reaches_the_targets():
    env = TargetEnv(4)
    ppo = make(PPOConfig(steps=1, gamma_reg=0.7, lam=0.5), num_envs=4)
    ppo.collect(env, env.observe())
    rollout = ppo.rollout
    torch.testing.assert_close(rollout.target, rollout.reward + 0.7 * rollout.next_value)


def test_learning_reaches_the_target():
    env, ppo = TargetEnv(64), make(PPOConfig(steps=12, learning_rate=3e-3, entropy=0.0), num_envs=64)
    obs = env.observe()
    test = {group: values.clone() for group, values in obs.items()}

    def error() -> float:
        with torch.no_grad():
            return (ppo.model.act(test) - env.target(test)).square().sum(dim=1).mean().item()

    before = error()
    first = None
    for _ in range(30):
        obs, stats = ppo.collect(env, obs)
        first = stats["reward"] if first is None else first
        losses = ppo.update()
    assert before > 0.8
    assert error() < 0.2 * before
    assert stats["reward"] > 0.5 * first  # rewards are negative: at most half the loss, noise included
    assert losses["action_std"] < 0.9  # nothing rewards noise


def test_a_nan_reward_stops_training():
    ppo, env = make(num_envs=4), TargetEnv(4, poison=True)
    with pytest.raises(DivergedError, match="not finite"):
        ppo.collect(env, env.observe())


def test_a_nan_loss_stops_training_before_it_harms_the_model():
    ppo, env = make(num_envs=4), TargetEnv(4)
    ppo.collect(env, env.observe())
    ppo.rollout.target[2, 1] = float("nan")
    with pytest.raises(DivergedError, match="not finite"):
        ppo.update()
    assert all(parameter.isfinite().all() for parameter in ppo.model.parameters())


def test_a_saved_update_goes_on_bit_identically():
    def trained(split: bool) -> dict[str, torch.Tensor]:
        ppo, env = make(num_envs=4), TargetEnv(4)
        obs = env.observe()
        for i in range(4):
            if split and i == 2:
                fresh = make(num_envs=4, seed=9)
                fresh.model.load_state_dict(ppo.model.state_dict())
                fresh.load_state_dict(ppo.state_dict())
                ppo = fresh
            obs, _ = ppo.collect(env, obs)
            ppo.update()
        return ppo.model.state_dict()

    whole, split = trained(False), trained(True)
    assert all(torch.equal(whole[name], split[name]) for name in whole)


@pytest.mark.parametrize("wrong", [{"gamma_reg": 1.0}, {"lam": 1.5}, {"steps": 0}, {"minibatches": 0}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError, match="PPOConfig"):
        PPOConfig(**wrong)
