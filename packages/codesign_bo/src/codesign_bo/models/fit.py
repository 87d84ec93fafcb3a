"""Hyperparameters of the surrogate by maximum a posteriori.

The gradient is written out in numpy, because on some dozens of points automatic differentiation takes ten
times as long as the mathematics (Rasmussen & Williams 2006, eq. 5.9).
"""

from __future__ import annotations

import logging
import math

import numpy as np
import torch
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize

from codesign_bo.models.gp import Hyperparameters, MaternGP, TrendMean
from codesign_bo.models.priors import PRIORS, Priors
from codesign_bo.space import Array

logger = logging.getLogger(__name__)

_STARTS = 3
_MAX_STARTS = 8
_ITERATIONS = 200
_LENGTHSCALES = (2.5e-2, 1e3)
_VARIANCES = (1e-3, 1e3)
_EXTRA_VARIANCES = (1e-6, 10.0)
_potrf, _potrs, _potri = get_lapack_funcs(("potrf", "potrs", "potri"), dtype=np.float64)


class LogPosterior:
    """Log density of outcomes and hyperparameters, as a function of the latter.

    They come as a vector: logarithms of length scales (dim,), variance and extra variance, then the constant
    and, if there is a trend, its weight. Densities are of the numbers themselves, not of their logarithms.

    Args:
        gp: The model; its own hyperparameters are left alone.
        priors: The priors.
    """

    def __init__(self, gp: MaternGP, priors: Priors = PRIORS) -> None:
        self._gaps = 5.0 * gp.squared_gaps()
        self._y, self._known = gp.y.numpy(), gp.known.numpy()
        columns = [np.ones_like(self._y)]
        if isinstance(gp.mean, TrendMean):
            with torch.no_grad():
                columns.append(gp.mean.trend(gp.x).numpy())
        self._means = np.array(columns)
        self._priors = priors
        self.dim = len(self._gaps)
        """Number of length scales."""

    def __call__(self, at: Array) -> tuple[float, Array]:
        """Return the log density and its gradient; -inf where the covariance is not positive definite."""
        dim, n = self.dim, len(self._y)
        inverse_squares, variance, extra = np.exp(-2.0 * at[:dim]), math.exp(at[dim]), math.exp(at[dim + 1])
        squares = np.tensordot(inverse_squares, self._gaps, 1)
        r = np.sqrt(squares)
        decay = variance * np.exp(-r)
        signal = (1.0 + r + squares / 3.0) * decay
        covariance = signal.copy()
        covariance.flat[:: n + 1] += self._known + extra
        root, failed = _potrf(covariance, lower=1)
        if failed:
            return -math.inf, np.zeros_like(at)
        rest = self._y - at[dim + 2 :] @ self._means
        weights, _ = _potrs(root, rest, lower=1)
        value = -0.5 * rest @ weights - np.log(root.diagonal()).sum() - 0.5 * n * math.log(2.0 * math.pi)
        inverse, _ = _potri(root, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        slope = 0.5 * (np.outer(weights, weights) - inverse)
        gradient = np.empty_like(at)
        gradient[:dim] = inverse_squares * np.tensordot(self._gaps, slope * (1.0 + r) * decay, 2) / 3.0
        gradient[dim : dim + 2] = np.sum(slope * signal), extra * slope.trace()
        gradient[dim + 2 :] = self._means @ weights
        return self._add_priors(at, float(value), gradient)

    def _add_priors(self, at: Array, value: float, gradient: Array) -> tuple[float, Array]:
        dim, priors = self.dim, self._priors
        parts = ((slice(dim), priors.lengthscale), (dim, priors.variance), (dim + 1, priors.extra_variance))
        for where, prior in parts:
            if prior is None:
                continue
            density, slope = prior.log_density(at[where])
            value += float(np.sum(density))
            gradient[where] += slope
        weights = at[dim + 3 :]
        gradient[dim + 3 :] -= weights / priors.weight**2
        return value - 0.5 * float(weights @ weights) / priors.weight**2, gradient

    def typical(self) -> Array:
        """Return hyperparameters to start from, and to fall back on."""
        rest = [0.0] * len(self._means)
        return np.array([math.log(0.4)] * self.dim + [0.0, math.log(3e-3)] + rest)

    def random(self, rng: np.random.Generator) -> Array:
        """Return hyperparameters to start from, over the range that data may call for."""
        scales = rng.uniform(math.log(0.1), math.log(2.0), self.dim)
        noise = rng.uniform(math.log(1e-4), math.log(0.1))
        return np.concatenate([scales, [0.0, noise], np.zeros(len(self._means))])

    @property
    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Bounds of the vector."""
        variance = (1.0, 1.0) if self._priors.variance is None else _VARIANCES
        logs = [_LENGTHSCALES] * self.dim + [variance, _EXTRA_VARIANCES]
        return [*((math.log(a), math.log(b)) for a, b in logs), *[(None, None)] * len(self._means)]

    def hyperparameters(self, at: Array) -> Hyperparameters:
        """Return the vector by name."""
        dim = self.dim
        weight = float(at[dim + 3]) if len(at) > dim + 3 else 0.0
        return Hyperparameters(np.exp(at[:dim]), math.exp(at[dim]), math.exp(at[dim + 1]), float(at[dim + 2]), weight)


def fit(gp: MaternGP, rng: np.random.Generator, priors: Priors = PRIORS) -> str:
    """Give a model its hyperparameters, and never fail.

    The ladder: L-BFGS from typical hyperparameters and from random ones, the best of three climbs wins; climbs
    that raise or end nowhere are replaced by further ones; if all do, the typical ones are taken.

    Args:
        gp: The model.
        rng: Where random starts come from.
        priors: Priors of the hyperparameters.

    Returns:
        `"map"`, or `"prior"` for the last step of the ladder.
    """
    posterior = LogPosterior(gp, priors)
    found: list[tuple[float, Array]] = []
    for attempt in range(_MAX_STARTS):
        loss, at = _minimise(posterior, posterior.random(rng) if attempt else posterior.typical())
        if math.isfinite(loss):
            found.append((loss, at))
        if len(found) == _STARTS:
            break
    for _, at in sorted(found, key=lambda item: item[0]):
        try:
            gp.hold(posterior.hyperparameters(at))
        except RuntimeError:  # torch's LinAlgError is one
            continue
        return "map"
    logger.warning("no fit of the surrogate succeeded on %d points; using typical hyperparameters", len(gp.y))
    gp.hold(posterior.hyperparameters(posterior.typical()))
    return "prior"


def _minimise(posterior: LogPosterior, start: Array) -> tuple[float, Array]:
    """Return the least negative log posterior on the way down from `start`, inf on failure, and where it is."""

    def negative(at: Array) -> tuple[float, Array]:
        value, gradient = posterior(at)
        return -value, -gradient

    try:
        result = minimize(
            negative, start, jac=True, method="L-BFGS-B", bounds=posterior.bounds, options={"maxiter": _ITERATIONS}
        )
    except (ArithmeticError, ValueError) as error:
        logger.info("a fit of the surrogate failed: %s", error)
        return math.inf, start
    return float(result.fun), np.asarray(result.x)
