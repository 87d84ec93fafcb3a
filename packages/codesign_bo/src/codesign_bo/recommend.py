"""Which design to take, and what is known of its gain over the nominal one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import stats

from codesign_bo.confirm import NOMINAL_TRIAL, Gain
from codesign_bo.models.surrogate import Surrogate
from codesign_bo.space import Array, Value

if TYPE_CHECKING:
    from codesign_bo.view import Estimate


@dataclass(frozen=True)
class Recommendation:
    """The design to take.

    Attributes:
        trial: Its trial; 0 if no design is expected to be better than the nominal one.
        params: The design.
        gain: Expected improvement over the nominal design; positive is better, whatever the direction.
        low: Lower end of the interval of the gain.
        high: Upper end.
        probability: Probability that the design is better than the nominal one.
        level: Level of the interval.
        source: `"confirmation"`: measured on fresh seeds, the interval holds for all confirmed designs
            together, and the probability is Student's with a flat prior. `"posterior"`: what the surrogate
            believes of the noise-free objective, its hyperparameters taken as known. The latter is only as
            good as the model, and has not been checked on fresh seeds.
    """

    trial: int
    params: Mapping[str, Value]
    gain: float
    low: float
    high: float
    probability: float
    level: float
    source: Literal["confirmation", "posterior"]

    def sentence(self) -> str:
        """The recommendation in words."""
        design = ", ".join(f"{n}={v:.4g}" if isinstance(v, float) else f"{n}={v}" for n, v in self.params.items())
        if self.trial == 0:
            return f"recommended: the nominal design ({design}); by {self.source}, no other is expected to be better"
        return (
            f"recommended: trial {self.trial} ({design}); by {self.source}, gain over nominal {self.gain:.4g} "
            f"[{self.low:.4g}, {self.high:.4g}] at {self.level:.0%}, better with probability {self.probability:.1%}"
        )


def by_confirmation(confirmed: Gain, nominal: Mapping[str, Value], level: float) -> Recommendation:
    """Return what the confirmation runs recommend.

    Args:
        confirmed: The confirmed design with the greatest gain.
        nominal: The nominal design.
        level: Level of the interval.
    """
    if confirmed.gain <= 0.0:
        return Recommendation(NOMINAL_TRIAL, nominal, 0.0, 0.0, 0.0, 0.0, level, "confirmation")
    measured = (confirmed.gain, confirmed.low, confirmed.high, confirmed.probability)
    return Recommendation(confirmed.trial, dict(confirmed.params), *measured, level, "confirmation")


def by_posterior(
    best: Estimate, nominal: Mapping[str, Value], surrogate: Surrogate, points: Array, maximize: bool, level: float
) -> Recommendation:
    """Return what the surrogate recommends.

    Args:
        best: The evaluated design with the best posterior mean.
        nominal: The nominal design.
        surrogate: The surrogate.
        points: Points (2, dim) of these two in the unit cube.
        maximize: Whether higher values are better.
        level: Level of the interval.
    """
    if dict(best.params) == nominal:
        return Recommendation(NOMINAL_TRIAL, nominal, 0.0, 0.0, 0.0, 0.0, level, "posterior")
    believed = posterior_gain(surrogate, points[0], points[1], maximize, level)
    return Recommendation(best.trial, best.params, *believed, level, "posterior")


def posterior_gain(
    surrogate: Surrogate, point: Array, base: Array, maximize: bool, level: float
) -> tuple[float, float, float, float]:
    """Return what the surrogate believes of the difference between two points.

    Args:
        surrogate: The surrogate.
        point: Point (dim,) of the unit cube.
        base: Point (dim,) to compare it with.
        maximize: Whether higher values are better.
        level: Level of the interval.

    Returns:
        Gain of `point` over `base` (positive is better), lower and upper end of its interval, and the
        probability that it is positive. The correlation of the two counts.
    """
    mean, covariance = surrogate.joint(np.stack([point, base]))
    gain = float(mean[0] - mean[1]) * (1.0 if maximize else -1.0)
    variance = float(covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1])
    std = math.sqrt(max(variance, 0.0))
    half = float(stats.norm.ppf(0.5 + 0.5 * level)) * std
    probability = float(stats.norm.cdf(gain / std)) if std > 0.0 else float(gain > 0.0)
    return gain, gain - half, gain + half, probability
