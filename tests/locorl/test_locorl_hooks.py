"""What is learnt beside the policy: a stand-in that estimates the explicit group from proprioception."""

from __future__ import annotations

import pytest
import torch
from locorl import PPO, ActorCritic, NetworkConfig, PPOConfig
from locorl_target import DIMS, NETWORK, TargetEnv


class Estimator:
    """Replaces `explicit` by a linear guess."""

    name = "estimator"

    def __init__(self, seed: int = 0, weight: float = 1.0) -> None:
        torch.manual_seed(seed)
        self.network, self.weight = torch.nn.Linear(DIMS["proprio"], DIMS["explicit"]), weight
        self.calls: list[str] = []
        self.seen: list[torch.Tensor] = []

    def begin(self, iteration):
        self.calls.append(f"begin {iteration}")
        self.seen.clear()

    def observe(self, obs):
        assert not torch.is_grad_enabled()
        guess = self.network(obs["proprio"])
        self.seen.append(guess)
        return {**obs, "explicit": guess}

    def end(self, rollout):
        self.calls.append("end")
        assert torch.is_grad_enabled()  # it may train
        with torch.no_grad():
            error = (self.network(rollout.obs["proprio"]) - rollout.obs["explicit"]).square().mean()
        return {"error": error.item(), "advantage": rollout.advantage.mean().item()}

    def loss(self, batch):
        self.calls.append("loss")
        return self.weight * (self.network(batch.obs["proprio"]) - batch.obs["explicit"]).square().mean()

    def parameters(self):
        return self.network.parameters()

    def state_dict(self):
        return {"network": self.network.state_dict()}

    def load_state_dict(self, state):
        self.network.load_state_dict(state["network"])


class Silent(Estimator):
    """Learns nothing, and shows what it sees."""

    name = "silent"

    def observe(self, obs):
        self.seen.append(obs["explicit"])
        return obs

    def loss(self, batch):
        return None


def make(*hooks, seed: int = 0, **config) -> PPO:
    torch.manual_seed(seed)
    config = PPOConfig(**{"steps": 4, **config})
    return PPO(ActorCritic(DIMS, 2, NETWORK), config, 32, DIMS, seed, hooks=hooks)


def test_the_actor_acts_on_what_the_hook_shows_and_the_rollout_keeps_the_truth():
    hook, env = Estimator(), TargetEnv()
    ppo = make(hook)
    first = env.observe()
    truth = {group: values.clone() for group, values in first.items()}
    ppo.collect(env, first)
    rollout = ppo.rollout
    assert all(torch.equal(rollout.obs[group][0], values) for group, values in truth.items())
    shown = {**rollout.obs, "explicit": torch.stack(hook.seen)}
    assert not torch.allclose(shown["explicit"], rollout.obs["explicit"])
    with torch.no_grad():
        torch.testing.assert_close(rollout.mean, ppo.model.act(shown))
        assert not torch.allclose(rollout.mean, ppo.model.act(rollout.obs))
        torch.testing.assert_close(rollout.log_prob, ppo.model.log_prob(ppo.model.act(shown), rollout.action))
        torch.testing.assert_close(rollout.value, ppo.model.value(rollout.obs))  # the critic knows the truth


class Remembering(Silent):
    """Shows a latent in place of the encoder's."""

    def observe(self, obs):
        return {**obs, "latent": torch.full((len(obs["proprio"]), NETWORK.latent), 0.3)}


class Flip:
    """A symmetry of the stand-in's observations and actions."""

    def observation(self, obs):
        return {group: -values for group, values in obs.items()}

    def action(self, action):
        return -action


@pytest.mark.parametrize("mirror", [None, Flip()], ids=["plain", "mirrored"])
@pytest.mark.parametrize("hooks", [(Estimator,), (Remembering,), (Estimator, Remembering)])
def test_the_actor_learns_on_what_it_saw(hooks, mirror):
    torch.manual_seed(0)
    made, env = [hook() for hook in hooks], TargetEnv()
    for number, hook in enumerate(made):
        hook.name = str(number)
    config = PPOConfig(steps=4, epochs=1, minibatches=1, mirror=mirror is not None)
    ppo = PPO(ActorCritic(DIMS, 2, NETWORK), config, 32, DIMS, 0, mirror=mirror, hooks=made)
    ppo.collect(env, env.observe())
    # the first minibatch is that of the policy that acted
    assert ppo.update()["kl"] == pytest.approx(0.0, abs=1e-6)


def test_images_of_what_the_actor_saw_are_mirrored_with_it():
    env = TargetEnv()
    ppo = make(Estimator(), Remembering())
    ppo.collect(env, env.observe())
    batch = ppo.rollout.pick(torch.arange(6)).with_mirror_image(Flip())
    seen, image = batch.seen
    assert torch.equal(image["explicit"], -seen["explicit"])
    assert not torch.equal(seen["explicit"], batch.obs["explicit"][:6])
    assert "latent" in seen
    assert "latent" not in image
    assert all(torch.equal(batch.obs[group][:6], ppo.rollout.obs[group].flatten(0, 1)[:6]) for group in DIMS)


def test_hooks_that_change_their_minds_within_a_rollout_are_refused():
    class Fickle(Silent):
        def observe(self, obs):
            self.seen.append(obs)
            return {**obs, "explicit": obs["explicit"] + 1.0} if len(self.seen) > 2 else obs

    env = TargetEnv()
    with pytest.raises(ValueError, match=r"showed \[\] at step 0 of a rollout, \['explicit'\] at step 2"):
        make(Fickle()).collect(env, env.observe())


def test_hooks_are_called_in_order():
    hook, env = Estimator(), TargetEnv()
    ppo = make(hook, epochs=1, minibatches=2)
    obs = env.observe()
    for _ in range(2):
        obs, _ = ppo.collect(env, obs)
        stats = ppo.update()
    assert hook.calls == ["begin 0", "end", "loss", "loss", "begin 1", "end", "loss", "loss"]
    assert stats["estimator/error"] > 0.0
    assert abs(stats["estimator/advantage"]) > 1e-4  # not yet normalised


def test_a_second_hook_sees_what_the_first_one_shows():
    first, second, env = Estimator(), Silent(), TargetEnv()
    make(first, second).collect(env, env.observe())
    assert all(torch.equal(a, b) for a, b in zip(first.seen, second.seen, strict=True))


def test_its_loss_trains_its_own_parameters_with_the_policys_optimiser():
    def trained(weight: float) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        hook, env = Estimator(weight=weight), TargetEnv()
        ppo = make(hook, max_grad_norm=1e9)
        inside = {id(p) for group in ppo.optimizer.param_groups for p in group["params"]}
        assert inside == {id(p) for p in (*ppo.model.parameters(), *hook.parameters())}
        start = [p.detach().clone() for p in hook.parameters()]
        ppo.collect(env, env.observe())
        ppo.update()
        changes = [p.detach() - old for p, old in zip(hook.parameters(), start, strict=True)]
        return changes, [p.detach().clone() for p in ppo.model.parameters()]

    changes, policy = trained(1.0)
    none, same = trained(0.0)
    assert all(change.abs().max() > 1e-3 for change in changes)
    assert all(change.abs().max() == 0.0 for change in none)
    # the loss reaches nothing of the policy, and the norm that gradients are clipped to is out of reach
    assert all(torch.equal(a, b) for a, b in zip(policy, same, strict=True))


def test_groups_that_the_networks_ignore_are_kept_for_hooks_alone():
    dims = {**DIMS, "history": 9}

    def kept(*hooks) -> set[str]:
        model = ActorCritic(dims, 2, NetworkConfig(actor=(4,), critic=(4,), encoder=(4,), latent=2))
        return set(PPO(model, PPOConfig(), 2, dims, 0, hooks=hooks).rollout.obs)

    assert kept() == set(DIMS)
    assert kept(Silent()) == set(dims)


def test_its_state_is_in_the_checkpoint():
    hook, env = Estimator(), TargetEnv()
    ppo = make(hook)
    ppo.collect(env, env.observe())
    ppo.update()
    fresh = Estimator(seed=5)
    again = make(fresh, seed=5)
    again.load_state_dict(ppo.state_dict())
    assert torch.equal(fresh.network.weight, hook.network.weight)
    moment = [state["exp_avg"] for state in again.optimizer.state_dict()["state"].values()]
    assert moment[-1].abs().max() > 0.0


def test_a_checkpoint_with_other_hooks_is_refused():
    ppo, other = make(Estimator()), make()
    with pytest.raises(ValueError, match=r"\['estimator'\], and now has \[\]"):
        other.load_state_dict(ppo.state_dict())


def test_hooks_with_one_name_are_refused():
    with pytest.raises(ValueError, match="share a name"):
        make(Estimator(), Estimator())
