"""The estimator, learnt from the rollouts of a teacher in training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor, nn

from distill.adaptation.fitting import Average, BatchLike, Fit, FitConfig, RolloutLike, windows_of
from distill.adaptation.modules import AdaptationModule
from distill.interfaces import Observation


class VelocityEstimation:
    """A rollout hook that learns the base velocity from proprioception, and has the policy act on it.

    The estimate is supervised with simulator truth in every iteration (paper, section III-D). Once the policy acts on
    it, PPO improves it on the estimates that it saw, so that it learns to live with their errors; values go on seeing
    the truth.

    Args:
        adaptation: whose estimator is trained.
        use_after: iterations after which the policy acts on the estimate; None: never.
        fit: how it is trained.
        seed: of the minibatches.
        average: of gradients over the processes that train together.

    Attributes:
        name: key in the checkpoint, and prefix of the metrics.
    """

    def __init__(
        self,
        adaptation: AdaptationModule,
        use_after: int | None = 10,
        fit: FitConfig | None = None,
        seed: int = 0,
        average: Average | None = None,
    ) -> None:
        self.name = "estimator"
        self._adaptation, self._use_after, self._used = adaptation, use_after, False
        self._fit = Fit(adaptation.estimator, fit or FitConfig(), seed, average)

    def begin(self, iteration: int) -> None:
        """Iteration `iteration`, counted from 0, starts."""
        self._used = self._use_after is not None and iteration >= self._use_after

    def observe(self, obs: Observation) -> Observation:
        """The observation with the estimate in group "explicit", once it is used."""
        if not self._used:
            return obs
        return {**obs, "explicit": self._adaptation.velocity(self._adaptation.window(obs))}

    def end(self, rollout: RolloutLike) -> Mapping[str, float]:
        """Train on a rollout.

        Returns:
            `error`: root mean square per axis, m/s. `used`: 1 where the policy acted on the estimate.
        """
        windows, truth = windows_of(rollout, self._adaptation), rollout.obs["explicit"].flatten(0, 1)
        error = self._fit(lambda rows: self._adaptation.velocity(windows(rows)), truth)
        return {"error": error, "used": float(self._used)}

    def loss(self, batch: BatchLike) -> Tensor | None:
        """None: the estimator has an optimiser of its own, so that it does not disturb the policy's gradients."""
        return None

    def parameters(self) -> Iterable[nn.Parameter]:
        """None for the policy's optimiser."""
        return ()

    def state_dict(self) -> dict[str, object]:
        """Estimator, optimiser and random stream."""
        return {"network": self._adaptation.estimator.state_dict(), "fit": self._fit.state_dict()}

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Go back to a saved state."""
        network, fit = state["network"], state["fit"]
        assert isinstance(network, dict)
        assert isinstance(fit, dict)
        with torch.no_grad():
            self._adaptation.estimator.load_state_dict(network)
        self._fit.load_state_dict(fit)
