"""Which design to take, and what is known of its gain over the nominal one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from codesign_bo.space import Array, Value
from codesign_bo.surrogate import Surrogate


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
