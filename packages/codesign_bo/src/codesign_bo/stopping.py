"""Learning-curve stopping: end evaluations that lie behind what finished ones had reached by the same step.

The rule is decided where the evaluation runs, from thresholds that travel with the request. So it needs no
shared folder and no polling, works in any executor, and gives the same decision each time it is run.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Curve = Sequence[tuple[float, float]]
"""Learning curve, pairs (step, value) by rising step."""

_MAX_STEPS = 64


@dataclass(frozen=True)
class Thresholds:
    """What the best value of a learning curve must have reached by when.

    Attributes:
        steps: Steps, rising.
        values: The value to reach by each of them.
        maximize: Whether higher values are better.
    """

    steps: tuple[float, ...]
    values: tuple[float, ...]
    maximize: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        object.__setattr__(self, "values", tuple(self.values))

    def hopeless(self, curve: Curve) -> bool:
        """Return whether the best value so far misses the threshold of the last step passed."""
        passed = bisect_right(self.steps, curve[-1][0]) if curve else 0
        values = [value for _, value in curve if math.isfinite(value)]
        if not passed or not values:
            return False  # too early, or diverged, which is for the callback to report
        limit = self.values[passed - 1]
        return max(values) < limit if self.maximize else min(values) > limit


@dataclass(frozen=True)
class MedianStopping:
    """Stops an evaluation whose best value lies behind the median of the others' at the same step.

    Golovin et al. 2017, "Google Vizier", section 3.5.2, with the best value so far on both sides. An
    evaluation that was itself stopped stays in the comparison with the best value it had, so that the bar
    does not rise from survivor to survivor.

    Attributes:
        min_trials: Learning curves needed before any evaluation is stopped.
        min_share: No evaluation is stopped before this share of the longest curve's steps.
        quantile: Share of the curves that an evaluation must beat; 0.5 is the median, less stops fewer.

    Raises:
        ValueError: A setting is out of range.
    """

    min_trials: int = 8
    min_share: float = 0.25
    quantile: float = 0.5

    def __post_init__(self) -> None:
        if self.min_trials < 1:
            raise ValueError(f"min_trials is {self.min_trials}; it must be >= 1")
        if not (0.0 <= self.min_share < 1.0 and 0.0 < self.quantile < 1.0):
            raise ValueError(
                f"min_share is {self.min_share} and quantile is {self.quantile}; they must be in [0, 1) and (0, 1)"
            )

    def thresholds(self, curves: Sequence[Curve], maximize: bool = True) -> Thresholds | None:
        """Return the bar for the next evaluation, or None while there are too few curves.

        Args:
            curves: Learning curves of finished evaluations, also of those that were stopped.
            maximize: Whether higher values are better.
        """
        curves = [finite for curve in curves if (finite := [p for p in curve if math.isfinite(p[1])])]
        if len(curves) < self.min_trials:
            return None
        start = self.min_share * max(curve[-1][0] for curve in curves)
        steps = sorted({step for curve in curves for step, _ in curve if step >= start})
        if len(steps) > _MAX_STEPS:
            steps = [steps[i] for i in np.linspace(0, len(steps) - 1, _MAX_STEPS).astype(int)]
        kept: list[tuple[float, float]] = []
        for step in steps:
            best = [b for curve in curves if (b := _best(curve, step, maximize)) is not None]
            if len(best) >= self.min_trials:
                # Between two values the one that stops fewer.
                share, side = (self.quantile, "lower") if maximize else (1.0 - self.quantile, "higher")
                kept.append((step, float(np.quantile(best, share, method=side))))
        return Thresholds(tuple(s for s, _ in kept), tuple(v for _, v in kept), maximize) if kept else None


def _best(curve: Curve, step: float, maximize: bool) -> float | None:
    """Return the best value of a curve up to a step; a curve that ended before keeps its own."""
    values = [value for at, value in curve if at <= step]
    return None if not values else (max(values) if maximize else min(values))


@dataclass(frozen=True)
class Savings:
    """What stopping saved.

    Attributes:
        stopped: Number of trials that were stopped.
        finished: Number of trials that ran in full or were stopped.
        evaluations: Cost saved, in full evaluations.
    """

    stopped: int
    finished: int
    evaluations: float

    @property
    def share(self) -> float:
        """Share of the cost of the same trials without stopping."""
        return self.evaluations / self.finished if self.finished else 0.0
