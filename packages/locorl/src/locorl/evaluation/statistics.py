"""Means with standard errors, and differences with confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from locorl.interfaces import Array


@dataclass(frozen=True)
class Estimate:
    """A mean of `n` values and its standard error, which is NaN for a single value."""

    mean: float
    sem: float
    n: int


def estimate(values: Array) -> Estimate:
    """Mean and standard error of values of any shape.

    Raises:
        ValueError: there are none.
    """
    values = np.asarray(values, dtype=np.float64)
    if not values.size:
        raise ValueError("there is no mean of nothing")
    sem = float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
    return Estimate(float(values.mean()), sem, values.size)


@dataclass(frozen=True)
class Difference:
    """How much larger one mean is than another.

    Attributes:
        value: mean of the second sample minus mean of the first.
        low: lower end of its confidence interval.
        high: upper end.
        p: probability of a difference at least as large, either way, if the means are equal.
        freedom: degrees of freedom (Welch and Satterthwaite).
    """

    value: float
    low: float
    high: float
    p: float
    freedom: float


def welch(first: Array, second: Array, confidence: float = 0.95) -> Difference:
    """Welch's t-test: the two samples may have different variances and sizes.

    Raises:
        ValueError: a sample has fewer than two values.
    """
    # takes a second, which commands without tests need not wait for
    from scipy.stats import ttest_ind

    if min(len(first), len(second)) < 2:
        raise ValueError(f"a t-test needs two values or more on each side, got {len(first)} and {len(second)}")
    test = ttest_ind(second, first, equal_var=False)
    interval = test.confidence_interval(confidence)
    return Difference(
        value=float(np.mean(second) - np.mean(first)),
        low=float(interval.low),
        high=float(interval.high),
        p=float(test.pvalue),  # pyright: ignore[reportAttributeAccessIssue]
        freedom=float(test.df),  # pyright: ignore[reportAttributeAccessIssue]
    )
