"""Learning from scores at lower fidelities, if leave-one-out says that they help.

Where policies have been scored before their fine-tuning, or on the way, the objective may follow those
scores: `objective(x) = constant + weight * score(x) + rest(x)` (Kennedy & O'Hagan 2000), with the posterior
mean of a Gaussian process of the scores, and a learnt weight. That scores before and after fine-tuning rank
designs alike is not to be taken for granted, and misleading scores make a search worse than none (Mikkola et
al. 2023, "Multi-Fidelity Bayesian Optimization with Unreliable Information Sources"). So with each fit the
full evaluations are predicted from one another with and without the scores, and these are used only where
the log density gains clearly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from codesign_bo.models.gp import Trend
from codesign_bo.models.surrogate import Surrogate, fit_surrogate, leave_one_out
from codesign_bo.records import ScoreRecord
from codesign_bo.space import Array, BoxSpace

MIN_FULL = 6
"""Evaluations in full below which leave-one-out has no say, and scores are not used."""

_MAX_SCORES = 256


@dataclass(frozen=True)
class Level:
    """Scores of one kind.

    Attributes:
        name: `"zero"`: without any fine-tuning; `"partial"`: on the way.
        x: Points (n, dim) of the unit cube, each once.
        y: Scores (n,).
        sem: Standard errors (n,), NaN where unknown.
    """

    name: str
    x: Array
    y: Array
    sem: Array


@dataclass(frozen=True)
class Verdict:
    """What leave-one-out says of the scores of a level.

    Attributes:
        level: Name of the level.
        gain: Mean gain in log density of an evaluation in full, in nats.
        error: Its standard error.
        weight: What the standardised objective gains for one standard deviation of the scores.
        used: Whether the gain exceeds twice its standard error and the weight is positive.
    """

    level: str
    gain: float
    error: float
    weight: float
    used: bool


def levels(space: BoxSpace, scores: Sequence[ScoreRecord]) -> list[Level]:
    """Sort scores into levels: fidelity 0, and those in between, of each design the one at the highest fidelity.

    A level needs a score more than there are parameters, at least 5; of more than 256 the newest count.
    """
    found: list[Level] = []
    for name, chosen in (
        ("zero", [s for s in scores if s.fidelity == 0]),
        ("partial", [s for s in scores if s.fidelity > 0]),
    ):
        newest: dict[tuple[float, ...], ScoreRecord] = {}
        points = space.to_unit(space.designs(s.params for s in chosen))
        for key, score in zip(map(tuple, points.tolist()), chosen, strict=True):
            if key not in newest or score.fidelity >= newest[key].fidelity:
                newest.pop(key, None)
                newest[key] = score
        kept = list(newest.items())[-_MAX_SCORES:]
        if len(kept) < max(5, space.dim + 1):
            continue
        sems = [math.nan if s.sem is None else s.sem for _, s in kept]
        found.append(Level(name, np.array([k for k, _ in kept]), np.array([s.mean for _, s in kept]), np.array(sems)))
    return found


def fit_with_scores(
    x: Array, y: Array, sem: Array, seed: int, space: BoxSpace, scores: Sequence[ScoreRecord]
) -> tuple[Surrogate, list[Verdict]]:
    """Fit a surrogate, with the level of scores that helps most, if one does.

    Args:
        x: Points (n, dim) of evaluations in full.
        y: Their means (n,).
        sem: Their standard errors (n,), NaN where unknown.
        seed: As for `fit_surrogate`.
        space: The space.
        scores: Scores at lower fidelities.

    Returns:
        The surrogate, and what was found about each level.
    """
    plain = fit_surrogate(x, y, sem, seed, space)
    if len(y) < MIN_FULL:
        return plain, []
    without = leave_one_out(plain).log_density
    chosen, best, verdicts = plain, 0.0, []
    for level in levels(space, scores):
        trend = fit_surrogate(level.x, level.y, level.sem, seed, space)
        model = fit_surrogate(x, y, sem, seed, space, _standardised(trend))
        gains = leave_one_out(model).log_density - without
        gain, error = float(gains.mean()), float(gains.std(ddof=1)) / math.sqrt(len(gains))
        weight = model.hyperparameters.weight
        used = model.fit == "map" and weight > 0 and gain > 2.0 * error
        verdicts.append(Verdict(level.name, gain, error, weight, used))
        if used and gain > best:
            chosen, best = replace(model, fit="map+scores"), gain
    return chosen, verdicts


def _standardised(trend: Surrogate) -> Trend:
    """Return the posterior mean of standardised scores, as a function of features."""
    return lambda features: trend.gp.moments(features)[0]
