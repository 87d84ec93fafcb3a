"""Which parameters matter: length scales, Sobol indices of the posterior mean, and whether the data can tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from gpytorch.distributions import MultivariateNormal
from scipy import stats

from codesign_bo.errors import StudyError
from codesign_bo.proposal import derive_seed
from codesign_bo.space import Array
from codesign_bo.surrogate import Surrogate, fit_surrogate
from codesign_bo.view import StudyView

LEVEL = 0.95
"""Confidence at which a parameter's effect is told from noise."""

_POINTS = 1024
_BLOCK = 512


@dataclass(frozen=True)
class Effect:
    """What one free parameter does to the objective, as far as the study can tell.

    Attributes:
        name: The parameter.
        lengthscale: Its length scale in the surrogate, in widths of the space; far above 1 means no effect.
        first: First-order Sobol index: share of the variance of the posterior mean that the parameter explains alone.
        total: Total-order index: share that it explains alone or together with others.
        ratio: Likelihood ratio, twice the difference of log marginal likelihoods: how much better the surrogate
            explains the scores than one that does not see the parameter.
        identifiable: Whether `ratio` is more than chance gives in 95 % of cases (chi-squared, one degree of freedom).
    """

    name: str
    lengthscale: float
    first: float
    total: float
    ratio: float
    identifiable: bool


def sensitivity(view: StudyView) -> list[Effect]:
    """Return the effect of each free parameter, in the space's order.

    The Sobol indices are over the whole box, all values of a parameter being equally likely; linear constraints are
    not regarded. The surrogate is fitted once more for each parameter.

    Raises:
        StudyError: Fewer than 3 scores.
    """
    surrogate = view.surrogate()
    if len(surrogate.y) < 3:
        raise StudyError(f"{view.path} has {len(surrogate.y)} scores; effects of parameters need at least 3")
    first, total = posterior_indices(view, surrogate)
    full = log_likelihood(surrogate)
    bar = float(stats.chi2.ppf(LEVEL, 1))
    effects: list[Effect] = []
    for axis, name in enumerate(view.space.free_names):
        ratio = 2.0 * (full - log_likelihood(_blind(view, surrogate, [axis])))
        scale = float(surrogate.lengthscales[axis])
        effects.append(Effect(name, scale, float(first[axis]), float(total[axis]), ratio, ratio > bar))
    return effects


def any_effect(view: StudyView) -> bool:
    """Return whether the surrogate explains the scores better than a constant and noise do, beyond chance.

    A likelihood-ratio test at 95 %, with one degree of freedom for each free parameter.

    Raises:
        StudyError: Fewer than 3 scores.
    """
    surrogate = view.surrogate()
    if len(surrogate.y) < 3:
        raise StudyError(f"{view.path} has {len(surrogate.y)} scores; effects of parameters need at least 3")
    constant = _blind(view, surrogate, list(range(view.space.dim)))
    ratio = 2.0 * (log_likelihood(surrogate) - log_likelihood(constant))
    return ratio > float(stats.chi2.ppf(LEVEL, view.space.dim))


def posterior_indices(view: StudyView, surrogate: Surrogate) -> tuple[Array, Array]:
    """Return first and total Sobol indices (dim,) of the posterior mean over the unit cube."""

    def mean(points: Array) -> Array:
        snapped = view.space.snap(points)
        blocks = np.array_split(snapped, -(-len(snapped) // _BLOCK))
        return np.concatenate([surrogate.predict(block)[0] for block in blocks])

    return sobol_indices(mean, view.space.dim, derive_seed(view.seed, 0, 4))


def sobol_indices(function: Callable[[Array], Array], dim: int, seed: int, n: int = _POINTS) -> tuple[Array, Array]:
    """Return first-order and total-order indices of a function over the unit cube, each (dim,).

    Estimators of Saltelli et al. 2010 (first order) and Jansen 1999 (total order) on scrambled Sobol points,
    n (dim + 2) evaluations. A constant function has indices of 0.

    Args:
        function: Maps points (m, dim) to values (m,).
        dim: Number of coordinates.
        seed: Seed of the scrambling.
        n: Number of base points, a power of 2.
    """
    base = torch.quasirandom.SobolEngine(2 * dim, scramble=True, seed=seed % 2**31)
    points = base.draw(n, dtype=torch.float64).numpy()
    a, b = points[:, :dim], points[:, dim:]
    mixed = np.repeat(a[None], dim, axis=0)
    for axis in range(dim):
        mixed[axis, :, axis] = b[:, axis]
    fa, fb = function(a), function(b)
    fm = function(mixed.reshape(-1, dim)).reshape(dim, n)
    both = np.concatenate([fa, fb])
    variance = float(np.var(both))
    if variance <= (1e-9 * (1.0 + float(np.abs(both).max()))) ** 2:
        return np.zeros(dim), np.zeros(dim)
    centre = float(both.mean())
    first = np.mean((fb - centre) * (fm - fa), axis=1) / variance
    total = 0.5 * np.mean((fa - fm) ** 2, axis=1) / variance
    return np.clip(first, 0.0, 1.0), np.clip(total, 0.0, 1.0)


def log_likelihood(surrogate: Surrogate) -> float:
    """Return the log marginal likelihood of the standardised scores."""
    with torch.no_grad():
        return float(MultivariateNormal(*surrogate.gp.observed()).log_prob(surrogate.gp.y))


def refit(view: StudyView, x: Array, y: Array, sem: Array) -> Surrogate:
    """Return the surrogate that the study would fit to other data: points (n, dim), means (n,), errors (n,)."""
    return fit_surrogate(x, y, sem, derive_seed(view.seed, 0, 3), view.space)


def _blind(view: StudyView, surrogate: Surrogate, axes: list[int]) -> Surrogate:
    """Return a surrogate of the same scores to which some parameters look the same in all designs."""
    points = surrogate.x.copy()
    points[:, axes] = 0.5
    return refit(view, points, surrogate.y, surrogate.sem)
