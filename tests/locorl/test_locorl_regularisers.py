"""Regularisers: their losses by hand, and short trainings with each."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from locorl import PPOConfig
from locorl.learning.config import PPGConfig
from locorl.learning.regularisers import ActivationRegulariser, PhasicPolicyGradient
from locorl_target import DIMS, TargetEnv, make_ppo

SHORT = PPGConfig(policy_iterations=3, epochs=4, minibatches=2)


def test_activation_by_hand():
    value = torch.tensor([1.0, 5.0, 7.0, 8.0], requires_grad=True)
    penalty = ActivationRegulariser(weight=0.5, v_max=6.0).penalty(value)
    assert penalty is not None
    assert penalty.item() == pytest.approx(0.5 * (1 + 4) / 4)
    penalty.backward()
    assert value.grad is not None
    assert value.grad.tolist() == pytest.approx([0, 0, 0.5 * 2 * 1 / 4, 0.5 * 2 * 2 / 4])


def test_activation_holds_values_down():
    """Rewards of 1 at discount 0.99 are worth up to 100; the critic says less where it is punished."""

    class Generous(TargetEnv):
        def step(self, action):
            obs, reward, *rest = super().step(action)
            return obs, torch.ones_like(reward), *rest

    def value(regulariser: str) -> float:
        ppo, env = make_ppo(PPOConfig(steps=8, regulariser=regulariser, v_max=1.0, activation_weight=20.0)), Generous()
        obs = env.observe()
        for _ in range(12):
            obs, _ = ppo.collect(env, obs)
            ppo.update()
        return ppo.rollout.value.mean().item()

    free, held = value("none"), value("activation")
    assert free > 2.0
    assert held < 0.75 * free


def phasic(config: PPGConfig = SHORT) -> PhasicPolicyGradient:
    ppo = make_ppo(PPOConfig(steps=4, regulariser="ppg", ppg=config))
    assert isinstance(ppo._regulariser, PhasicPolicyGradient)
    return ppo._regulariser


def test_auxiliary_losses_by_hand():
    regulariser = phasic()
    model = regulariser.model
    with torch.no_grad():
        for network, bias in ((model.critic, 3.0), (model.actor, 0.5)):
            network[-1].weight.zero_()
            network[-1].bias.fill_(bias)
        regulariser.head.weight.zero_()
        regulariser.head.bias.fill_(2.0)
        model.log_std.zero_()
    obs = {group: torch.randn(2, size) for group, size in DIMS.items()}
    target, old_mean = torch.tensor([1.0, 4.0]), torch.tensor([[0.5, 0.5], [1.5, 0.0]])
    old_std = torch.tensor([1.0, 2.0])
    auxiliary, clone, value = regulariser.losses(obs, target, old_mean, old_std)
    assert auxiliary.item() == pytest.approx(0.5 * (1 + 4) / 2)
    assert value.item() == pytest.approx(0.5 * (4 + 1) / 2)
    # both rows: the wider old Gaussian in the second action, (4 - 1)/2 - log 2; means differ by 1 and 0.5 in one row
    assert clone.item() == pytest.approx(1.5 - math.log(2.0) + 0.5 * (1 + 0.25) / 2, rel=1e-5)


def test_the_auxiliary_phase_comes_every_few_iterations():
    ppo, env = make_ppo(PPOConfig(steps=4, regulariser="ppg", ppg=SHORT)), TargetEnv()
    obs, phases = env.observe(), []
    for _ in range(7):
        obs, _ = ppo.collect(env, obs)
        phases.append("ppg/auxiliary_loss" in ppo.update())
    assert phases == [False, False, True, False, False, True, False]


def test_the_phase_learns_values_in_the_actors_trunk_and_holds_the_policy():
    def change(clone_weight: float) -> tuple[float, float]:
        config = PPOConfig(steps=8, regulariser="ppg")
        config = replace(config, ppg=PPGConfig(1, 12, 4, clone_weight=clone_weight, learning_rate=3e-3))
        ppo, env = make_ppo(config), TargetEnv()
        regulariser = ppo._regulariser
        ppo.collect(env, env.observe())
        rollout = ppo.rollout
        obs = {group: values.flatten(0, 1) for group, values in rollout.obs.items()}
        # something that the networks can learn
        rollout.target = rollout.obs["proprio"][..., 0] - rollout.obs["implicit"][..., 1]

        def loss() -> tuple[float, torch.Tensor]:
            with torch.no_grad():
                mean, std = ppo.model.act(obs), ppo.model.std()
                return regulariser.losses(obs, rollout.target.flatten(), mean, std)[0].item(), mean

        before, mean = loss()
        regulariser.after_update(rollout)
        after, now = loss()
        return after / before, (now - mean).square().mean().item()

    learnt, moved = change(clone_weight=1.0)
    _, free = change(clone_weight=0.0)
    assert learnt < 0.5
    assert moved < 0.3 * free


@pytest.mark.parametrize("regulariser", ["discount", "activation", "ppg", "none"])
def test_a_short_training_with_each(regulariser):
    config = PPOConfig(steps=12, learning_rate=3e-3, entropy=0.0, regulariser=regulariser, ppg=SHORT)
    ppo, env = make_ppo(config, num_envs=64), TargetEnv(64)
    obs, rewards = env.observe(), []
    for _ in range(12):
        obs, stats = ppo.collect(env, obs)
        rewards.append(stats["reward"])
        losses = ppo.update()
    assert rewards[-1] > 0.75 * rewards[0]  # rewards are negative
    assert all(math.isfinite(x) for x in losses.values())


@pytest.mark.parametrize("wrong", [{"policy_iterations": 0}, {"epochs": 0}, {"minibatches": 0}])
def test_impossible_phases_are_refused(wrong):
    with pytest.raises(ValueError, match="PPGConfig"):
        PPGConfig(**wrong)
