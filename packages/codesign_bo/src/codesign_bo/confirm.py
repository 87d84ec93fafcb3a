"""Is a design better than the nominal one? Statistics of evaluations on fresh, shared seeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from codesign_bo.records import ConfirmationRecord
from codesign_bo.space import Value

NOMINAL_TRIAL = 0


@dataclass(frozen=True)
class Gain:
    """Improvement of one design over the nominal one; positive is better, whatever the direction.

    Attributes:
        trial: Trial whose design this is.
        params: The design.
        mean: Its mean score over the fresh seeds.
        nominal_mean: Mean score of the nominal design over the same seeds.
        gain: `mean - nominal_mean`, or its negative where the objective is minimised.
        low: Lower end of the confidence interval of the gain; -inf with fewer than 2 seeds.
        high: Upper end.
        repeats: Number of fresh seeds.
        probability: Probability that this design is better than the nominal one: Student's t with a flat prior,
            not corrected for the number of designs; NaN with fewer than 2 seeds.
    """

    trial: int
    params: Mapping[str, Value]
    mean: float
    nominal_mean: float
    gain: float
    low: float
    high: float
    repeats: int
    probability: float

    @property
    def relative(self) -> tuple[float, float, float]:
        """Gain, low and high as fractions of the nominal mean (taken as exact)."""
        size = abs(self.nominal_mean)
        if size == 0.0:
            return (math.nan, math.nan, math.nan)
        return (self.gain / size, self.low / size, self.high / size)

    @property
    def significant(self) -> bool:
        """Whether the interval excludes 0."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True)
class Confirmation:
    """What the confirmation runs say.

    Attributes:
        gains: Gain of each confirmed design, the highest first.
        failed: Trials left out, because a confirmation run of theirs failed or is missing.
        level: Confidence level at which all intervals hold together.
    """

    gains: tuple[Gain, ...]
    failed: tuple[int, ...]
    level: float

    @property
    def best(self) -> Gain | None:
        """The design with the highest gain, or None if none was confirmed."""
        return self.gains[0] if self.gains else None


def analyse(
    records: Iterable[ConfirmationRecord],
    params: Mapping[int, Mapping[str, Value]],
    maximize: bool = True,
    level: float = 0.95,
) -> Confirmation:
    """Compare each design with the nominal one, seed by seed.

    All designs run on the same seeds, so seeds are blocks: what a seed does to every design cancels. The
    residual variance of the two-way table (designs, nominal included, by seeds) is pooled over the k
    designs and has k (r - 1) degrees of freedom with r seeds; the interval is Student's with Bonferroni's
    correction for k comparisons, so that it holds for the design that came out best. For k = 1 this is the
    paired t interval. It assumes that designs differ in their mean but not in their variance.

    Seeds on which the nominal design failed are dropped; a design that failed on any other is left out.

    Args:
        records: The confirmation runs.
        params: Design of each trial.
        maximize: Whether higher scores are better.
        level: Confidence level.
    """
    scores: dict[int, dict[int, float]] = {}
    for record in records:
        row = scores.setdefault(record.trial, {})
        if record.result is not None and record.result.ok:
            row[record.repeat] = record.result.mean
    nominal = scores.pop(NOMINAL_TRIAL, {})
    repeats = sorted(nominal)
    complete = [t for t, row in scores.items() if repeats and all(r in row for r in repeats)]
    failed = tuple(sorted(set(scores) - set(complete)))
    if not complete:
        return Confirmation((), failed, level)
    base = np.array([nominal[r] for r in repeats])
    table = np.array([[scores[t][r] for r in repeats] for t in complete])
    error = _pooled(np.vstack([base, table]))
    gains = [
        _gain(trial, params[trial], row, base, error, 1.0 - (1.0 - level) / (2 * len(complete)), maximize)
        for trial, row in zip(complete, table, strict=True)
    ]
    return Confirmation(tuple(sorted(gains, key=lambda g: (-g.gain, g.trial))), failed, level)


def _pooled(table: np.ndarray) -> tuple[float, int]:
    """Return the standard error of a difference of two rows of `table` (k + 1 designs, r seeds).

    Returns:
        The standard error, infinite for one seed, and its degrees of freedom.
    """
    k, r = table.shape[0] - 1, table.shape[1]
    if r < 2:
        return math.inf, 1
    residual = table - table.mean(axis=1, keepdims=True) - table.mean(axis=0) + table.mean()
    freedom = k * (r - 1)
    variance = float(np.sum(residual**2)) / freedom
    return math.sqrt(2.0 * variance / r), freedom


def _gain(
    trial: int,
    params: Mapping[str, Value],
    scores: np.ndarray,
    base: np.ndarray,
    error: tuple[float, int],
    quantile: float,
    maximize: bool,
) -> Gain:
    gain = float(np.mean(scores - base)) * (1.0 if maximize else -1.0)
    width, freedom = error
    half = float(stats.t.ppf(quantile, freedom)) * width
    if width == math.inf:
        probability = math.nan
    elif width == 0.0:
        probability = float(gain > 0.0)
    else:
        probability = float(stats.t.cdf(gain / width, freedom))
    return Gain(
        trial,
        dict(params),
        float(scores.mean()),
        float(base.mean()),
        gain,
        gain - half,
        gain + half,
        len(base),
        probability,
    )
