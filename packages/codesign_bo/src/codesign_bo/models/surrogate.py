"""Surrogate of an expensive, noisy objective: a Gaussian process over the points of a space's unit cube."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from codesign_bo.models.features import Features
from codesign_bo.models.fit import fit
from codesign_bo.models.gp import Hyperparameters, MaternGP, Trend
from codesign_bo.models.priors import PRIORS, Priors
from codesign_bo.space import Array, BoxSpace


@dataclass(frozen=True)
class Surrogate:
    """A fitted surrogate.

    Attributes:
        x: Observed points (n, dim) of the unit cube.
        y: Observed means (n,), in the objective's unit.
        sem: Known standard errors (n,), 0 where unknown.
        gp: The model, in features and standardised outcomes.
        features: What the model sees of a point.
        shift: Mean of `y`.
        scale: Standard deviation of `y`, by which the model's outcomes were divided.
        fit: How the hyperparameters came about: `"map"`, or `"prior"` when no fit succeeded; with `"+scores"`
            if scores at lower fidelities stand in for the prior mean (see `codesign_bo.models.fidelity`).
    """

    x: Array
    y: Array
    sem: Array
    gp: MaternGP
    features: Features
    shift: float
    scale: float
    fit: str

    @property
    def hyperparameters(self) -> Hyperparameters:
        """What was learnt, in standardised outcomes."""
        if self.gp.held is None:
            raise RuntimeError("the model has no hyperparameters yet; fit_surrogate gives it some")
        return self.gp.held

    @property
    def lengthscales(self) -> Array:
        """Length scales (dim,) in unit-cube units; one far above 1 means little effect or little data."""
        return self.hyperparameters.lengthscales.copy()

    @property
    def signal(self) -> float:
        """Prior standard deviation of the noise-free objective around its mean, in the objective's unit."""
        return self.scale * math.sqrt(self.hyperparameters.variance)

    @property
    def extra_noise(self) -> float:
        """Standard deviation of the noise learnt beyond `sem`, in the objective's unit."""
        return self.scale * math.sqrt(self.hyperparameters.extra_variance)

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation of the noise-free objective.

        Args:
            points: Points (m, dim) of the unit cube.

        Returns:
            Mean (m,) and standard deviation (m,), in the objective's unit.
        """
        with torch.no_grad():
            x = self.features(torch.as_tensor(points))
            mean, v = self.gp.moments(x)
            variance = (self.gp.kernel.variance - v.square().sum(-2)).clamp_min(0.0)
        return self.shift + self.scale * mean.numpy(), self.scale * variance.sqrt().numpy()

    def joint(self, points: Array) -> tuple[Array, Array]:
        """Return mean (m,) and covariance (m, m) of the noise-free objective at points (m, dim), in its unit."""
        with torch.no_grad():
            posterior = self.gp.posterior(self.features(torch.as_tensor(points)))
        return self.shift + self.scale * posterior.mean.numpy(), self.scale**2 * posterior.covariance_matrix.numpy()


def fit_surrogate(
    x: Array,
    y: Array,
    sem: Array,
    seed: int,
    space: BoxSpace | None = None,
    trend: Trend | None = None,
    priors: Priors = PRIORS,
) -> Surrogate:
    """Fit by maximum a posteriori, from several starts, and never fail.

    Replicates of a design are all kept: that is merging them by inverse variance, and their spread tells of
    the extra noise. See `codesign_bo.models.fit.fit` for the ladder.

    Args:
        x: Points (n, dim) of the unit cube, n >= 1.
        y: Means (n,), finite.
        sem: Standard errors (n,), NaN where unknown (the learnt noise then stands alone).
        seed: Seed of the starting points; same data and seed give the same surrogate.
        space: The space, which knows the kinds of parameters; by default all are continuous.
        trend: What the standardised objective is expected to follow, up to a learnt factor.
        priors: Priors of the hyperparameters.
    """
    x, y = np.array(x, dtype=float), np.array(y, dtype=float)
    sem = np.nan_to_num(np.asarray(sem, dtype=float), nan=0.0)
    spread = float(np.std(y, ddof=1)) if len(y) > 1 else 0.0
    shift = float(np.mean(y))
    scale = spread if spread > 1e-12 * max(1.0, abs(shift)) else 1.0
    features = Features(BoxSpace.box([f"x{i}" for i in range(x.shape[1])], 0, 1, 0) if space is None else space)
    outcomes, variance = torch.as_tensor((y - shift) / scale), torch.as_tensor((sem / scale) ** 2)
    gp = MaternGP(features(torch.as_tensor(x)), outcomes, variance, features.groups, trend)
    return Surrogate(x, y, sem, gp, features, shift, scale, fit(gp, np.random.default_rng(seed), priors))


@dataclass(frozen=True)
class LeaveOneOut:
    """Each observation predicted from all the others, hyperparameters held.

    Attributes:
        y: Observed means (n,).
        mean: Predicted means (n,).
        std: Predicted standard deviations (n,), observation noise included.
    """

    y: Array
    mean: Array
    std: Array

    @property
    def z(self) -> Array:
        """Standardised errors (n,); standard normal if the surrogate is calibrated."""
        return (self.y - self.mean) / self.std

    @property
    def log_density(self) -> Array:
        """Log density of each observation by its prediction (n,); higher is better."""
        return -0.5 * self.z**2 - np.log(self.std) - 0.5 * math.log(2.0 * math.pi)

    @property
    def coverage(self) -> float:
        """Fraction of observations inside their 95 % interval."""
        return float(np.mean(np.abs(self.z) <= 1.959964))

    @property
    def r2(self) -> float:
        """Share of the variance that is predicted; at most 0 where the surrogate knows no better."""
        total = float(np.sum((self.y - self.y.mean()) ** 2))
        return 1.0 - float(np.sum((self.y - self.mean) ** 2)) / total if total > 0 else 0.0


def leave_one_out(surrogate: Surrogate) -> LeaveOneOut:
    """Return the leave-one-out predictions (Rasmussen & Williams 2006, eqs. 5.10 to 5.12)."""
    gp = surrogate.gp
    with torch.no_grad():
        mean, covariance = gp.observed()
        inverse = torch.linalg.inv(covariance)
        variance = 1.0 / inverse.diagonal()
        mean = gp.y - (inverse @ (gp.y - mean)) * variance
    return LeaveOneOut(
        surrogate.y,
        surrogate.shift + surrogate.scale * mean.numpy(),
        surrogate.scale * variance.sqrt().numpy(),
    )


def slices(surrogate: Surrogate, point: Array, n: int) -> tuple[Array, Array, Array]:
    """Evaluate the posterior on lines through a point, one along each axis of the unit cube.

    Args:
        surrogate: The surrogate.
        point: Point (dim,) that all lines pass through.
        n: Number of points per line, spread evenly over [0, 1].

    Returns:
        Positions (n,) along a line, mean (dim, n) and standard deviation (dim, n). Along the axis of an
        integer or a categorical the posterior changes from bin to bin.
    """
    dim = len(point)
    positions = np.linspace(0.0, 1.0, n)
    lines = np.tile(np.asarray(point, dtype=float), (dim, n, 1))
    for axis in range(dim):
        lines[axis, :, axis] = positions
    mean, std = surrogate.predict(lines.reshape(-1, dim))
    return positions, mean.reshape(dim, n), std.reshape(dim, n)
