"""Which parameters matter: length scales, Sobol indices of the posterior mean, and whether the data can tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import stats
from torch.distributions import MultivariateNormal

from codesign_bo.errors import StudyError
from codesign_bo.models.fidelity import fit_with_scores
from codesign_bo.models.surrogate import Surrogate
from codesign_bo.records import ScoreRecord
from codesign_bo.seeds import derive_seed
from codesign_bo.space import Array
from codesign_bo.view import StudyView

LEVEL = 0.95
"""Confidence at which a parameter's effect is told from noise."""

_POINTS = 1024
_BLOCK = 512
_LOG_NOISES = np.linspace(-14.0, 3.0, 341)  # variances to choose from, fine enough for two decimals


@dataclass(frozen=True)
class Effect:
    """What one free parameter does to the objective, as far as the study can tell.

    Attributes:
        name: The parameter.
        lengthscale: Its length scale in the surrogate, in widths of the space; far above 1 means no effect.
        first: First-order Sobol index: share of the variance of the posterior mean that the parameter explains alone.
        total: Total-order index: share that it explains alone or together with others.
        ratio: Likelihood ratio, twice the difference of log marginal likelihoods: how much better the surrogate
            explains the scores than one that does not see the parameter, or than noise alone.
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
    full, constant = log_likelihood(_blind(view, surrogate, [])), constant_log_likelihood(surrogate)
    bar = float(stats.chi2.ppf(LEVEL, 1))
    effects: list[Effect] = []
    for axis, name in enumerate(view.space.free_names):
        without = max(log_likelihood(_blind(view, surrogate, [axis])), constant)
        ratio, scale = 2.0 * (full - without), float(surrogate.lengthscales[axis])
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
    ratio = 2.0 * (log_likelihood(_blind(view, surrogate, [])) - constant_log_likelihood(surrogate))
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


def constant_log_likelihood(surrogate: Surrogate) -> float:
    """Return the highest log likelihood of the standardised scores if all designs are equal.

    Mean and noise beyond the known errors are free, without the prior by which the surrogate expects little noise.
    """
    y, known = (surrogate.y - surrogate.shift) / surrogate.scale, (surrogate.sem / surrogate.scale) ** 2
    variance = known[:, None] + np.exp(_LOG_NOISES)
    mean = np.sum(y[:, None] / variance, axis=0) / np.sum(1.0 / variance, axis=0)
    density = -0.5 * np.sum((y[:, None] - mean) ** 2 / variance + np.log(2.0 * np.pi * variance), axis=0)
    return float(density.max())


def refit(view: StudyView, x: Array, y: Array, sem: Array, scores: Sequence[ScoreRecord] = ()) -> Surrogate:
    """Return the surrogate that the study would fit to other data.

    Args:
        view: The study.
        x: Points (n, dim) of the unit cube.
        y: Means (n,).
        sem: Standard errors (n,), NaN where unknown.
        scores: Scores at lower fidelities.
    """
    return fit_with_scores(x, y, sem, derive_seed(view.seed, 0, 3), view.space, scores)[0]


def _blind(view: StudyView, surrogate: Surrogate, axes: list[int]) -> Surrogate:
    """Return a surrogate of the scores in full, and of these alone, to which some parameters look all the same."""
    points = surrogate.x.copy()
    points[:, axes] = 0.5
    return refit(view, points, surrogate.y, surrogate.sem)
