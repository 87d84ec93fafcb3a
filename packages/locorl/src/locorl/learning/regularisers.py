"""What keeps a critic of many bodies from overfitting, compared in section IV-B2 of the paper.

Discount regularisation is the smaller discount of `PPOConfig.discount` and needs nothing here. Activation
regularisation penalises values that are too high. Phasic policy gradient follows Cobbe et al. 2021.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from locorl.learning.config import PPGConfig, PPOConfig
from locorl.learning.distributed import Processes
from locorl.learning.gradient import Descent
from locorl.learning.losses import gaussian_kl
from locorl.learning.networks import ActorCritic
from locorl.learning.storage import Rollout, evaluate_rows


class Regulariser(Protocol):
    """What PPO asks of a regulariser."""

    def penalty(self, value: Tensor) -> Tensor | None:
        """A term () of the critic's loss on a minibatch, of its values (B,)."""
        ...

    def after_update(self, rollout: Rollout) -> dict[str, float]:
        """PPO has learnt from `rollout`; returns metrics."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """What a resumed training needs."""
        ...

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go back to a saved state."""
        ...


def make_regulariser(
    config: PPOConfig, model: ActorCritic, generator: torch.Generator, group: Processes | None = None
) -> Regulariser:
    """The regulariser that `config` names.

    Args:
        config: hyperparameters.
        model: what is trained.
        generator: of the training's random stream.
        group: processes that train together.
    """
    if config.regulariser == "activation":
        return ActivationRegulariser(config.activation_weight, config.v_max)
    if config.regulariser == "ppg":
        return PhasicPolicyGradient(config.ppg, model, config.max_grad_norm, generator, group)
    return NoRegulariser()


class NoRegulariser:
    """Leaves PPO as it is."""

    def penalty(self, value: Tensor) -> Tensor | None:
        """None."""
        return None

    def after_update(self, rollout: Rollout) -> dict[str, float]:
        """Nothing."""
        return {}

    def state_dict(self) -> dict[str, Any]:
        """Nothing to keep."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Nothing to restore."""


class ActivationRegulariser(NoRegulariser):
    """Adds weight * mean(relu(V - v_max)^2) to the critic's loss.

    The paper says that excessively high values are penalised, and not how; this is our reading.

    Args:
        weight: of the penalty.
        v_max: the highest value that is not excessive.
    """

    def __init__(self, weight: float, v_max: float) -> None:
        self.weight, self.v_max = weight, v_max

    def penalty(self, value: Tensor) -> Tensor | None:
        """The penalty, ()."""
        return self.weight * (value - self.v_max).relu().square().mean()


class PhasicPolicyGradient(NoRegulariser):
    """Every few iterations the actor's trunk learns values too, while the policy stays what it is.

    In the auxiliary phase a value head on the last hidden layer of the actor learns the returns of all rollouts
    since the last phase, the KL divergence from the policy before the phase holds the policy in place, and the critic
    goes on learning the same returns. Those rollouts are kept in memory: four bytes for each of
    policy_iterations x steps x N x observed numbers.

    Args:
        config: hyperparameters.
        model: what is trained.
        max_grad_norm: gradients are clipped to this norm.
        generator: of the order of minibatches.
        group: processes that train together.
    """

    def __init__(
        self,
        config: PPGConfig,
        model: ActorCritic,
        max_grad_norm: float,
        generator: torch.Generator,
        group: Processes | None = None,
    ) -> None:
        self.config, self.model, self.generator = config, model, generator
        last = model.actor[-1]
        assert isinstance(last, nn.Linear)
        self.head = nn.Linear(last.in_features, 1).to(last.weight.device)
        self.descent = Descent(
            (*model.parameters(), *self.head.parameters()), config.learning_rate, max_grad_norm, group
        )
        self._obs: list[dict[str, Tensor]] = []
        self._target: list[Tensor] = []

    def after_update(self, rollout: Rollout) -> dict[str, float]:
        """Keep the rollout; when there are enough, run the auxiliary phase and forget them.

        Returns:
            In iterations with a phase `ppg/auxiliary_loss`, `ppg/clone_kl` and `ppg/value_loss`, means over it.
        """
        self._obs.append({group: rollout.obs[group].flatten(0, 1).clone() for group in self.model.groups})
        self._target.append(rollout.target.flatten().clone())
        if len(self._target) < self.config.policy_iterations:
            return {}
        obs = {group: torch.cat([each[group] for each in self._obs]) for group in self.model.groups}
        target = torch.cat(self._target)
        self._obs, self._target = [], []
        return self._phase(obs, target)

    def _phase(self, obs: Mapping[str, Tensor], target: Tensor) -> dict[str, float]:
        config = self.config
        with torch.no_grad():
            old_mean, old_std = evaluate_rows(self.model.act, obs), self.model.std().clone()
        count = config.policy_iterations * config.minibatches
        totals = torch.zeros(3)
        for _ in range(config.epochs):
            order = torch.randperm(len(target), generator=self.generator, device=target.device)
            for rows in order.tensor_split(count):
                self.descent.optimizer.zero_grad(set_to_none=True)
                batch = {group: values.index_select(0, rows) for group, values in obs.items()}
                auxiliary, clone, value = self.losses(batch, target[rows], old_mean[rows], old_std)
                (auxiliary + config.clone_weight * clone + config.value_weight * value).backward()
                found = self.descent.settle(auxiliary_loss=auxiliary, clone_kl=clone, value_loss=value)
                self.descent.optimizer.step()
                totals += torch.tensor([found[name] for name in _TERMS])
        totals /= config.epochs * count
        return {f"ppg/{name}": value for name, value in zip(_TERMS, totals.tolist(), strict=True)}

    def losses(
        self, obs: Mapping[str, Tensor], target: Tensor, old_mean: Tensor, old_std: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Half the mean squared error of the head, the KL divergence, half that of the critic; () each.

        Args:
            obs: group -> (B, dim).
            target: returns, (B,).
            old_mean: mean action of the policy before the phase, (B, A).
            old_std: its noise, (A,).
        """
        features = self.model.features(obs)
        auxiliary = 0.5 * (self.head(features).squeeze(-1) - target).square().mean()
        clone = gaussian_kl(self.model.actor[-1](features), self.model.std(), old_mean, old_std)
        value = 0.5 * (self.model.value(obs) - target).square().mean()
        return auxiliary, clone, value

    def state_dict(self) -> dict[str, Any]:
        """Head, optimiser, and the rollouts that wait for the next phase."""
        return {
            "head": self.head.state_dict(),
            "optimizer": self.descent.optimizer.state_dict(),
            "obs": list(self._obs),
            "target": list(self._target),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go back to a saved state."""
        self.head.load_state_dict(state["head"])
        self.descent.optimizer.load_state_dict(state["optimizer"])
        device = self.head.weight.device
        self._obs = [{group: values.to(device) for group, values in each.items()} for each in state["obs"]]
        self._target = [values.to(device) for values in state["target"]]


_TERMS = ("auxiliary_loss", "clone_kl", "value_loss")
