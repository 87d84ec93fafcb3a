"""Supervised learning on a rollout that belongs to someone else's training."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import torch
from torch import Tensor, nn

from distill.adaptation.modules import AdaptationModule
from distill.errors import TrainingDiverged
from distill.interfaces import Observation

Average: TypeAlias = Callable[[list[Tensor]], object]
"""Averages tensors in place over the processes that train together."""


class RolloutLike(Protocol):
    """A rollout of T steps of N robots."""

    @property
    def obs(self) -> Observation:
        """Observations, group -> (T, N, dim)."""
        ...


class BatchLike(Protocol):
    """A minibatch of B transitions."""

    @property
    def obs(self) -> Observation:
        """Observations, group -> (B, dim)."""
        ...


@dataclass(frozen=True)
class FitConfig:
    """How a network is fitted to a rollout."""

    learning_rate: float = 1e-3
    """Of Adam."""
    epochs: int = 4
    """Passes over a rollout."""
    minibatches: int = 32
    """Minibatches in a pass."""
    max_grad_norm: float = 1.0
    """Gradients are scaled down to this norm."""

    def __post_init__(self) -> None:
        if min(self.epochs, self.minibatches) < 1 or self.learning_rate <= 0.0:
            raise ValueError(f"FitConfig: epochs and minibatches must be at least 1, learning_rate above 0, got {self}")


class Fit:
    """Adam on a mean squared error, with an own random stream for the minibatches.

    Args:
        network: trained.
        config: hyperparameters.
        seed: of the minibatches.
        average: of gradients over the processes that train together; None if there is one.
    """

    def __init__(self, network: nn.Module, config: FitConfig, seed: int, average: Average | None = None) -> None:
        self._network, self._config, self._average = network, config, average
        self._optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        self._generator = torch.Generator().manual_seed(seed)

    def __call__(self, predict: Callable[[Tensor], Tensor], target: Tensor) -> float:
        """Fit `predict`, which maps rows (b,) to predictions (b, k), to `target` (R, k).

        Returns:
            Root mean square error over the pass before the last step of each minibatch.

        Raises:
            TrainingDiverged: the loss is not finite; the network is as it was before that minibatch.
        """
        errors: list[float] = []
        for _ in range(self._config.epochs):
            order = torch.randperm(len(target), generator=self._generator).to(target.device)
            errors = [self._step(predict(rows), target[rows]) for rows in order.tensor_split(self._config.minibatches)]
        return (sum(errors) / len(errors)) ** 0.5

    def _step(self, found: Tensor, wanted: Tensor) -> float:
        loss = (found - wanted).square().mean()
        if not torch.isfinite(loss):
            raise TrainingDiverged(
                "the loss of an estimator or history encoder is not finite; lower FitConfig.learning_rate"
            )
        self._optimizer.zero_grad()
        loss.backward()
        if self._average is not None:
            self._average([p.grad for p in self._network.parameters() if p.grad is not None])
        nn.utils.clip_grad_norm_(self._network.parameters(), self._config.max_grad_norm)
        self._optimizer.step()
        return loss.item()

    def state_dict(self) -> dict[str, object]:
        """Optimiser and random stream; the network is saved by its owner."""
        return {"optimizer": self._optimizer.state_dict(), "generator": self._generator.get_state()}

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Go back to a saved state."""
        optimizer, generator = state["optimizer"], state["generator"]
        assert isinstance(optimizer, dict)
        assert isinstance(generator, Tensor)
        self._optimizer.load_state_dict(optimizer)
        self._generator.set_state(generator.cpu())


def windows_of(rollout: RolloutLike, adaptation: AdaptationModule) -> Callable[[Tensor | slice], Tensor]:
    """What gives the windows (B, H, P) of these rows (B,) of a rollout: all at once may not fit into memory."""
    obs = {group: rollout.obs[group].flatten(0, 1) for group in ("proprio", "history") if group in rollout.obs}
    return lambda rows: adaptation.window({group: values[rows] for group, values in obs.items()})
