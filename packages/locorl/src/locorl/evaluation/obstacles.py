"""Success against the size of the obstacles, measured by the body that meets them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from locorl.evaluation.evaluate import Evaluation


@dataclass(frozen=True)
class ObstacleBin:
    """Robots whose obstacles are at least `low` and less than `high` hip heights large.

    Attributes:
        kind: of terrain that they met.
        low: of the bin, in hip heights of each robot's own body.
        high: likewise.
        robots: number of them.
        succeeded: number of those that reached their last waypoint.
    """

    kind: str
    low: float
    high: float
    robots: int
    succeeded: int

    @property
    def rate(self) -> float:
        """Share that succeeded."""
        return self.succeeded / self.robots

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the rate; it takes robots as independent, so let them have different bodies."""
        # takes a second, which commands without courses need not wait for
        from scipy.stats import binomtest

        low, high = binomtest(self.succeeded, self.robots).proportion_ci(method="wilson")
        return float(low), float(high)


def success_by_obstacle(result: Evaluation, width: float = 0.25) -> list[ObstacleBin]:
    """Bins of `width` hip heights for each kind of course, from the smallest obstacles to the largest.

    Empty ones are left out.

    Raises:
        ValueError: the evaluation was not on a course, or the width is not above 0.
    """
    if result.course is None or result.succeeded is None:
        raise ValueError("success against obstacle size needs an evaluation on a course, a parkour task")
    if width <= 0.0:
        raise ValueError(f"bins must be wider than 0 hip heights, got {width}")
    size = (result.course.obstacle / result.course.hip_height).ravel()
    # 0.5 hip heights must not fall below 0.5 by rounding
    number = np.floor(size / width + 1e-6).astype(int)
    kinds, success = result.course.kind.ravel(), result.succeeded.ravel()
    bins = []
    for kind in np.unique(kinds).tolist():
        for k in np.unique(number[kinds == kind]).tolist():
            here = (kinds == kind) & (number == k)
            bins.append(ObstacleBin(kind, k * width, (k + 1) * width, int(here.sum()), int(success[here].sum())))
    return bins
