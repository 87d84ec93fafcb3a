"""Proximal policy optimisation with discount regularisation (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from locorl.learning.advantage import generalised_advantage
from locorl.learning.networks import ActorCritic
from locorl.learning.storage import Minibatch, Rollout

if TYPE_CHECKING:
    from locorl.env.legged_env import LeggedEnv


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO."""

    gamma_reg: float = 0.98
    """Regularised discount (section III-B2); 0.99 is the paper's unregularised baseline."""
    lam: float = 0.95
    """Lambda of the advantage estimator."""
    steps: int = 24
    """Control steps of each robot in one rollout."""
    epochs: int = 5
    """Passes over a rollout."""
    minibatches: int = 4
    """Minibatches in a pass."""
    clip: float = 0.2
    """Clipping of the likelihood ratio and of the value step."""
    entropy: float = 0.005
    """Weight of the entropy bonus."""
    value_weight: float = 1.0
    """Weight of the value loss."""
    learning_rate: float = 1e-3
    """Initial learning rate of Adam; it then adapts to the KL divergence."""
    min_learning_rate: float = 1e-5
    max_learning_rate: float = 1e-2
    desired_kl: float = 0.01
    """The learning rate falls above twice and rises below half this divergence."""
    max_grad_norm: float = 1.0
    """Gradients are clipped to this norm."""

    def __post_init__(self) -> None:
        """Refuse impossible settings before anything runs."""
        if not 0.0 < self.gamma_reg < 1.0 or not 0.0 <= self.lam <= 1.0:
            raise ValueError(f"PPOConfig: need 0 < gamma_reg < 1 and 0 <= lam <= 1, got {self.gamma_reg}, {self.lam}")
        if min(self.steps, self.epochs, self.minibatches) < 1:
            raise ValueError("PPOConfig: steps, epochs and minibatches must be at least 1")


class DivergedError(RuntimeError):
    """Training produced NaN or infinity."""


class PPO:
    """Collects rollouts and updates an `ActorCritic` on them.

    Args:
        model: policy and value function; trained in place.
        config: hyperparameters.
        num_envs: N of the environment.
        dims: its observation groups.
        seed: of exploration noise and minibatches.
    """

    def __init__(
        self, model: ActorCritic, config: PPOConfig, num_envs: int, dims: Mapping[str, int], seed: int
    ) -> None:
        self.model = model
        self.config = config
        self.learning_rate = config.learning_rate
        self.optimizer = torch.optim.Adam(model.parameters(), lr=config.learning_rate, foreach=True)
        self.generator = torch.Generator().manual_seed(seed)
        self.rollout = Rollout(config.steps, num_envs, dims, model.log_std.numel())

    @torch.no_grad()
    def collect(self, env: LeggedEnv, obs: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, float]]:
        """Fill the rollout from `env`, starting at `obs`.

        Returns:
            The observation after the last step, and the rollout's statistics.

        Raises:
            DivergedError: an observation or a reward is not finite.
        """
        rollout, stats = self.rollout, RolloutStats()
        current = dict(obs)
        std = self.model.std()
        for t in range(rollout.steps):
            for group, values in current.items():
                rollout.obs[group][t] = values
            mean = self.model.act(current)
            action = mean + std * torch.randn(mean.shape, generator=self.generator)
            rollout.mean[t], rollout.action[t] = mean, action
            rollout.log_prob[t] = self.model.log_prob(mean, action)
            rollout.value[t] = self.model.value(current)
            current, reward, terminated, truncated, info = env.step(action)
            rollout.reward[t] = reward
            rollout.terminated[t], rollout.done[t] = terminated, terminated | truncated
            if len(info.done_ids):
                rollout.next_value[t, info.done_ids] = self.model.value(info.final_obs)
            stats.add(reward, terminated, truncated, info.tracking_error, info.reward_terms, info.diverged)
        # V(s_(t+1)) is the next row's value, except where an episode was cut by time in between
        following = torch.cat((rollout.value[1:], self.model.value(current)[None]))
        truncated = rollout.done & ~rollout.terminated
        rollout.next_value = torch.where(truncated, rollout.next_value, following)
        if not (rollout.reward.isfinite().all() and rollout.value.isfinite().all()):
            raise DivergedError("a reward or an observation is not finite: check the bodies and the physics step")
        rollout.advantage, rollout.target = generalised_advantage(
            rollout.reward,
            rollout.value,
            rollout.next_value,
            rollout.done,
            rollout.terminated,
            self.config.gamma_reg,
            self.config.lam,
        )
        return current, stats.summary(env.dt)

    def update(self) -> dict[str, float]:
        """Improve policy and value function on the collected rollout.

        Returns:
            Mean losses, KL divergence, noise and learning rate.

        Raises:
            DivergedError: the loss is not finite; the model is left as it was before that minibatch.
        """
        config, rollout = self.config, self.rollout
        advantage = rollout.advantage
        rollout.advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        old_std = self.model.std().detach().clone()
        sums = torch.zeros(3)
        for _ in range(config.epochs):
            for batch in rollout.minibatches(config.minibatches, self.generator):
                mean = self.model.act(batch.obs)
                kl = self._kl(mean.detach(), batch.mean, old_std)
                self._adapt(kl)
                surrogate, value_loss = self._losses(mean, batch)
                loss = surrogate + config.value_weight * value_loss - config.entropy * self.model.entropy()
                if not loss.isfinite():
                    raise DivergedError("the loss is not finite; lower the learning rate")
                self.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self.model.parameters(), config.max_grad_norm, foreach=True)
                self.optimizer.step()
                sums += torch.tensor((surrogate.item(), value_loss.item(), kl))
        surrogate, value_loss, kl = (sums / (config.epochs * config.minibatches)).tolist()
        return {
            "surrogate_loss": surrogate,
            "value_loss": value_loss,
            "kl": kl,
            "action_std": float(self.model.std().detach().mean()),
            "learning_rate": self.learning_rate,
        }

    def _losses(self, mean: Tensor, batch: Minibatch) -> tuple[Tensor, Tensor]:
        """Clipped surrogate and clipped value loss of a minibatch."""
        clip = self.config.clip
        ratio = (self.model.log_prob(mean, batch.action) - batch.log_prob).exp()
        surrogate = -torch.min(batch.advantage * ratio, batch.advantage * ratio.clamp(1 - clip, 1 + clip)).mean()
        value = self.model.value(batch.obs)
        clipped = batch.value + (value - batch.value).clamp(-clip, clip)
        value_loss = torch.max((value - batch.target).square(), (clipped - batch.target).square()).mean()
        return surrogate, value_loss

    @torch.no_grad()
    def _kl(self, mean: Tensor, old_mean: Tensor, old_std: Tensor) -> float:
        """KL divergence of the new policy from the one that collected, mean over rows."""
        std = self.model.std()
        ratio = old_std / std
        kl = 0.5 * (ratio.square() + ((mean - old_mean) / std).square() - 1.0) - ratio.log()
        return float(kl.sum(dim=1).mean())

    def _adapt(self, kl: float) -> None:
        config = self.config
        if kl > 2.0 * config.desired_kl:
            self.learning_rate = max(config.min_learning_rate, self.learning_rate / 1.5)
        elif 0.0 < kl < 0.5 * config.desired_kl:
            self.learning_rate = min(config.max_learning_rate, self.learning_rate * 1.5)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate

    def state_dict(self) -> dict[str, object]:
        """Optimiser, learning rate and random stream; the model is saved by its owner."""
        return {
            "optimizer": self.optimizer.state_dict(),
            "learning_rate": self.learning_rate,
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Go back to a saved state."""
        self.optimizer.load_state_dict(state["optimizer"])  # pyright: ignore[reportArgumentType]
        self.learning_rate = float(state["learning_rate"])  # pyright: ignore[reportArgumentType]
        self.generator.set_state(state["generator"])  # pyright: ignore[reportArgumentType]


class RolloutStats:
    """Running statistics of one rollout, kept as tensors until the end."""

    def __init__(self) -> None:
        self._rows: list[Tensor] = []
        self._terms: list[Tensor] = []
        self._names: tuple[str, ...] = ()

    def add(
        self,
        reward: Tensor,
        terminated: Tensor,
        truncated: Tensor,
        tracking_error: Tensor,
        terms: Mapping[str, Tensor],
        diverged: Tensor,
    ) -> None:
        """Take in one step."""
        columns = (reward, terminated.float(), truncated.float(), tracking_error, diverged.float())
        self._rows.append(torch.stack([column.mean() for column in columns]))
        self._names = tuple(terms)
        self._terms.append(torch.stack(tuple(terms.values())))

    def summary(self, dt: float) -> dict[str, float]:
        """Means over the rollout; `reward` and its terms are per second, `fall_rate` per second too."""
        reward, fallen, _, error, diverged = torch.stack(self._rows).mean(dim=0).tolist()
        terms = (torch.stack(self._terms).mean(dim=0) / dt).tolist()
        return {
            "reward": reward / dt,
            "fall_rate": fallen / dt,
            "tracking_error": error,
            "diverged": diverged,
            **{f"term/{name}": value for name, value in zip(self._names, terms, strict=True)},
        }
