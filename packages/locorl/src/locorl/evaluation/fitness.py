"""What a fine-tune was good for: before and after on common random numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from locorl.evaluation.evaluate import Evaluation
from locorl.evaluation.statistics import Estimate, estimate

MEASURES: Mapping[str, str] = {
    "returns": "return (eq. 9)",
    "energy": "positive joint work, J (eq. 10)",
    "distance": "distance, m",
    "tracking_error": "tracking error, m/s",
    "survived": "survived, share",
}
"""What is compared, under the names of `Evaluation`. Energy means little where robots fall or stand still, so
distance, tracking error and survival stand beside it."""


@dataclass(frozen=True)
class Gain:
    """Mean and standard error of one measure before and after, and of the difference robot by robot."""

    before: Estimate
    after: Estimate
    difference: Estimate


def gains(before: Evaluation, after: Evaluation) -> dict[str, Gain]:
    """Name of each of `MEASURES` -> gain; the standard errors are over robots, which differ in commands and starts.

    Raises:
        ValueError: the evaluations differ in bodies or protocol, so that their robots do not belong together.
    """
    if before.config != after.config or not np.array_equal(before.designs, after.designs):
        raise ValueError("before and after must be evaluated on the same bodies under the same protocol and seed")
    result = {}
    for name in MEASURES:
        old, new = (getattr(each, name).astype(np.float64) for each in (before, after))
        result[name] = Gain(estimate(old), estimate(new), estimate(new - old))
    return result
