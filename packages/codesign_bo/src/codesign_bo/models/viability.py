"""The probability that a design can be evaluated at all, learnt from those that failed.

A Gaussian-process classifier with a logistic likelihood by Laplace's approximation (Rasmussen & Williams
2006, algorithms 3.1 and 3.2): a constant for how often designs fail, plus a Matern-5/2 for where. Its
hyperparameters are those of a small grid with the highest evidence. That a model of viability beats dropping
failures, and replacing their scores, is what Bussemaker et al. (2025) found for Bayesian optimisation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from codesign_bo.data import Viability
from codesign_bo.models.features import Features
from codesign_bo.space import Array, BoxSpace

THRESHOLD = 0.5
"""Designs that are less likely viable than this are not proposed, as long as there are others."""

_LENGTHSCALES = (0.2, 0.4, 0.8, 1.6)
_VARIANCES = (1.0, 4.0, 16.0)
_BASE_VARIANCE = 4.0
_ITERATIONS = 100
_TOLERANCE = 1e-10


@dataclass(frozen=True)
class ViabilityModel:
    """A fitted classifier.

    Attributes:
        features: What it sees of a point.
        x: Features (n, f) of the designs that were tried.
        slope: Derivative of the log likelihood at the latent mode (n,).
        weight: Square root of minus its second derivative (n,).
        root: Cholesky factor (n, n) of `1 + weight K weight`.
        lengthscale: Length scale, in edges of the unit cube.
        variance: Prior variance of the latent function.
        evidence: Approximate log evidence.
    """

    features: Features
    x: torch.Tensor
    slope: torch.Tensor
    weight: torch.Tensor
    root: torch.Tensor
    lengthscale: float
    variance: float
    evidence: float

    def log_probability(self, points: torch.Tensor) -> torch.Tensor:
        """Return the logarithm (b,) of the probability that points (b, dim) are viable; differentiable."""
        cross = covariance(self.x, self.features(points), self.lengthscale, self.variance)
        mean = self.slope @ cross
        half = torch.linalg.solve_triangular(self.root, self.weight[:, None] * cross, upper=False)
        variance = (self.variance + _BASE_VARIANCE - half.square().sum(0)).clamp_min(0.0)
        # the mean of the logistic function under a normal distribution (MacKay 1992)
        return torch.nn.functional.logsigmoid(mean / (1.0 + 0.125 * math.pi * variance).sqrt())

    def probability(self, points: Array) -> Array:
        """Return the probability (m,) that points (m, dim) of the unit cube are viable."""
        with torch.no_grad():
            return self.log_probability(torch.as_tensor(points)).exp().numpy()


def fit_viability(space: BoxSpace, data: Viability) -> ViabilityModel | None:
    """Return a classifier of designs, or None as long as none has failed.

    Args:
        space: The space.
        data: Which designs could be evaluated; lost evaluations are not among them.
    """
    if data.viable.all():
        return None
    features = Features(space)
    x, sign = features(torch.as_tensor(data.x)), torch.as_tensor(np.where(data.viable, 1.0, -1.0))
    models = [_laplace(features, x, sign, scale, variance) for scale in _LENGTHSCALES for variance in _VARIANCES]
    return max(models, key=lambda model: model.evidence)


def covariance(a: torch.Tensor, b: torch.Tensor, lengthscale: float, variance: float) -> torch.Tensor:
    """Return the prior covariance (m, n) of the latent function at features (m, f) and (n, f)."""
    r = (5.0 * (a[:, None] - b[None]).square().sum(-1)).clamp_min(1e-20).sqrt() / lengthscale
    return _BASE_VARIANCE + variance * (1.0 + r + r.square() / 3.0) * torch.exp(-r)


def _laplace(
    features: Features, x: torch.Tensor, sign: torch.Tensor, lengthscale: float, variance: float
) -> ViabilityModel:
    """Find the latent mode by Newton's method, halving steps that do not climb."""
    with torch.no_grad():
        prior = covariance(x, x, lengthscale, variance)
        target, latent, a = (sign + 1.0) / 2.0, torch.zeros_like(sign), torch.zeros_like(sign)
        objective = -math.inf
        for _ in range(_ITERATIONS):
            chance = torch.sigmoid(latent)
            weight = (chance * (1.0 - chance)).sqrt()
            root = _root(prior, weight)
            b = weight.square() * latent + target - chance
            half = torch.cholesky_solve((weight * (prior @ b))[:, None], root)[:, 0]
            step = b - weight * half - a
            size, before = 1.0, objective
            while size > 1e-4:
                trial = a + size * step
                there = prior @ trial
                value = (torch.nn.functional.logsigmoid(sign * there).sum() - 0.5 * trial @ there).item()
                if value >= objective:
                    a, latent, objective = trial, there, value
                    break
                size *= 0.5
            if objective - before < _TOLERANCE:
                break
        chance = torch.sigmoid(latent)
        weight = (chance * (1.0 - chance)).sqrt()
        root = _root(prior, weight)
        evidence = objective - root.diagonal().log().sum().item()
    return ViabilityModel(features, x, target - chance, weight, root, lengthscale, variance, evidence)


def _root(prior: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    return torch.linalg.cholesky(torch.eye(len(weight), dtype=torch.float64) + weight[:, None] * prior * weight)
