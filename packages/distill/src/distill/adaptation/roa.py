"""Regularised online adaptation: a history encoder learnt while the policy is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias

import torch
from torch import Tensor, nn

from distill.adaptation.fitting import Average, BatchLike, Fit, FitConfig, RolloutLike, windows_of
from distill.adaptation.identification import fit_probe
from distill.adaptation.modules import AdaptationModule
from distill.adaptation.schedule import RoaSchedule
from distill.errors import InterfaceError
from distill.interfaces import Observation

ENCODER_FIT = FitConfig(learning_rate=3e-3)
"""Faster than the estimator's, as fewer rollouts are learnt from."""

Latent: TypeAlias = Callable[[Observation], Tensor]
"""The policy's privileged encoder with its gradient: observation -> (B, L)."""


class RegularisedAdaptation:
    """A rollout hook that brings the privileged latent and the history latent together (Fu et al. 2022).

    The loss is `w |z - sg(h)| + |sg(z) - h|^2` with the privileged latent z, the history latent h and sg the stop of
    the gradient. Its first part keeps the policy's encoder from telling what no history shows; it joins PPO's loss,
    its weight w rises by a schedule. The second trains the history encoder after a rollout: first on rollouts of the
    privileged latent, then in the adaptation phases, in which the policy acts on h (observation group "latent",
    which a policy must take in place of its encoder's output). Beyond the paper, the history encoder also learns to
    tell the bodies apart (group "implicit", where there is one): by what the best linear probe of h misses of them.

    Args:
        adaptation: whose history encoder is trained.
        schedule: weight and phases.
        fit: how the history encoder is trained after a rollout that it learns from.
        seed: of the minibatches.
        average: of gradients over the processes that train together.

    Attributes:
        name: key in the checkpoint, and prefix of the metrics.

    Example:
        The trainer makes the policy, so the encoder is attached afterwards::

            roa = RegularisedAdaptation(adaptation)
            trainer = Trainer(factory, config, start=generalist, hooks=[roa])
            roa.attach(trainer.model.latent)
    """

    def __init__(
        self,
        adaptation: AdaptationModule,
        schedule: RoaSchedule | None = None,
        fit: FitConfig | None = None,
        seed: int = 0,
        average: Average | None = None,
    ) -> None:
        self.name = "roa"
        self._adaptation, self._schedule = adaptation, schedule or RoaSchedule()
        self._fit = Fit(adaptation.encoder, fit or ENCODER_FIT, seed, average)
        self._latent: Latent | None = None
        self._weight, self._acts, self._learns = 0.0, False, False

    def attach(self, latent: Latent) -> None:
        """Take `latent`, the privileged encoder of the policy in training."""
        self._latent = latent

    def begin(self, iteration: int) -> None:
        """Iteration `iteration`, counted from 0, starts.

        Raises:
            InterfaceError: no privileged encoder was attached.
        """
        if self._latent is None:
            raise InterfaceError("ROA knows no privileged encoder: call attach(trainer.model.latent) before training")
        schedule = self._schedule
        self._weight = schedule.regularisation(iteration)
        self._acts, self._learns = schedule.acts(iteration), schedule.learns(iteration)

    def observe(self, obs: Observation) -> Observation:
        """The observation with the history latent in group "latent", in adaptation phases."""
        return {**obs, "latent": self._history_latent(obs)} if self._acts else obs

    def end(self, rollout: RolloutLike) -> Mapping[str, float]:
        """Train the history encoder on a rollout, where the schedule says so.

        Returns:
            `error`: root mean square distance of the latents before that, per element. `weight`: of the
            regularisation. `acts`: 1 where the policy acted on the history latent.
        """
        windows = windows_of(rollout, self._adaptation)
        with torch.no_grad():
            obs = {group: values.flatten(0, 1) for group, values in rollout.obs.items()}
            target = self._privileged_latent(obs)
            error = (self._adaptation.latent(windows(slice(None))) - target).square().mean().sqrt().item()
        if self._learns:
            body = self._body(obs, target)
            self._fit(lambda rows: self._told(windows(rows), body[rows]), torch.cat((target, body), dim=1))
        return {"error": error, "weight": self._weight, "acts": float(self._acts)}

    def _body(self, obs: Observation, target: Tensor) -> Tensor:
        """What robots (R,) are told of their bodies, (R, k): standardised, and weighted against `target` (R, L)."""
        weight = self._schedule.identification
        if weight == 0.0 or "implicit" not in obs:
            return target[:, :0]
        body = obs["implicit"]
        body = body[:, body.std(dim=0) > 1e-4 * body.abs().mean(dim=0).clamp(min=1e-6)]
        body = (body - body.mean(dim=0)) / body.std(dim=0)
        # a mean over columns on either side, in units of the variance
        size = target.std(dim=0).square().sum() / max(body.shape[1], 1)
        return (weight * size).sqrt() * body

    def _told(self, window: Tensor, body: Tensor) -> Tensor:
        """History latent, and what the best linear probe of it makes of the bodies."""
        latent = self._adaptation.latent(window)
        if not body.shape[1]:
            return latent
        weights, offsets = fit_probe(latent, body, ridge=1e-2)
        # at its best the probe itself has no part in the gradient
        return torch.cat((latent, latent @ weights + offsets), dim=1)

    def loss(self, batch: BatchLike) -> Tensor | None:
        """The regularisation: mean distance of the privileged latent from the history latent, weighted."""
        if self._weight == 0.0:
            return None
        with torch.no_grad():
            anchor = self._history_latent(batch.obs)
        distance = torch.linalg.vector_norm(self._privileged_latent(batch.obs) - anchor, dim=1)
        return self._weight * distance.mean()

    def parameters(self) -> Iterable[nn.Parameter]:
        """None for the policy's optimiser."""
        return ()

    def state_dict(self) -> dict[str, object]:
        """History encoder, optimiser and random stream."""
        return {"network": self._adaptation.encoder.state_dict(), "fit": self._fit.state_dict()}

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Go back to a saved state."""
        network, fit = state["network"], state["fit"]
        assert isinstance(network, dict)
        assert isinstance(fit, dict)
        with torch.no_grad():
            self._adaptation.encoder.load_state_dict(network)
        self._fit.load_state_dict(fit)

    def _history_latent(self, obs: Observation) -> Tensor:
        return self._adaptation.latent(self._adaptation.window(obs))

    def _privileged_latent(self, obs: Observation) -> Tensor:
        assert self._latent is not None
        return self._latent(obs)
