"""Means, standard errors and Welch's test, by hand and against scipy; choosing and stopping; before and after."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from locorl import EvalConfig, Evaluation
from locorl.evaluation.choice import Candidate, best, stalled
from locorl.evaluation.evaluate import Course
from locorl.evaluation.fitness import gains
from locorl.evaluation.obstacles import ObstacleBin, success_by_obstacle
from locorl.evaluation.statistics import estimate, welch
from scipy import stats


def evaluation(bodies: int = 1, robots: int = 4, **arrays: np.ndarray) -> Evaluation:
    """An evaluation of nothing in particular."""
    shape = (bodies, robots)
    ones = np.ones(shape)
    plain = Evaluation(
        designs=np.ones((bodies, 4)),
        config=EvalConfig(robots_per_body=robots),
        command=0.5 * ones,
        weight=150 * ones,
        survived=np.ones(shape, dtype=bool),
        returns=ones,
        tracking_error=0.1 * ones,
        distance=9 * ones,
        energy=500 * ones,
        cost_of_transport=0.4 * ones,
        mean_power=25 * ones,
    )
    return replace(plain, **arrays)


def test_an_estimate_by_hand():
    # deviations of -3, -1, 1, 3: variance 20/3, standard error sqrt(20/3/4)
    value = estimate(np.array([[2.0, 4.0], [6.0, 8.0]]))
    assert (value.mean, value.n) == (5.0, 4)
    assert value.sem == pytest.approx(math.sqrt(20 / 12))
    assert math.isnan(estimate(np.array([3.0])).sem)
    with pytest.raises(ValueError, match="no mean of nothing"):
        estimate(np.array([]))


def test_welch_by_hand():
    # variances 5/3 and 10, of the means 5/12 and 2
    test = welch(np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 4.0, 6.0, 8.0, 10.0]))
    squared = 5 / 12 + 2
    freedom = squared**2 / ((5 / 12) ** 2 / 3 + 2**2 / 4)
    assert test.value == 3.5
    assert test.freedom == pytest.approx(freedom)
    assert freedom == pytest.approx(5.52, abs=0.005)
    # tables: t(0.975; 5) = 2.571, t(0.975; 6) = 2.447
    assert 3.5 - 2.571 * math.sqrt(squared) < test.low < 3.5 - 2.447 * math.sqrt(squared)
    assert test.high - test.value == pytest.approx(test.value - test.low)
    assert test.p == pytest.approx(2 * stats.t.sf(3.5 / math.sqrt(squared), freedom))


def test_welch_agrees_with_a_permutation_test():
    rng = np.random.default_rng(0)
    a, b = rng.normal(0, 1, 40), rng.normal(0.0, 1, 40)
    shuffled = stats.permutation_test(
        (b, a), lambda x, y, axis: x.mean(axis) - y.mean(axis), n_resamples=4000, vectorized=True, rng=1
    )
    assert welch(a, b).p == pytest.approx(shuffled.pvalue, abs=0.02)
    assert 0.001 < shuffled.pvalue < 0.2


samples = arrays(np.float64, st.integers(2, 12), elements=st.integers(-50, 50).map(float), unique=True)


@given(a=samples, b=samples)
def test_welch_is_scipys_and_antisymmetric(a, b):
    ours, back = welch(a, b), welch(b, a)
    theirs = stats.ttest_ind(a, b, equal_var=False)
    assert ours.p == pytest.approx(theirs.pvalue)
    assert (ours.value, ours.low, ours.high) == pytest.approx((-back.value, -back.high, -back.low))
    assert (ours.low <= 0 <= ours.high) == (ours.p >= 0.05) or ours.p == pytest.approx(0.05)


def test_a_single_run_proves_nothing():
    with pytest.raises(ValueError, match="two values or more on each side, got 1 and 3"):
        welch(np.ones(1), np.ones(3))


def candidates(*returns: list[float]) -> list[Candidate]:
    none = np.zeros(0)
    return [Candidate(k, None, np.array(values), none, 1.0) for k, values in enumerate(returns)]  # pyright: ignore


def test_the_best_is_the_highest_mean_and_of_equals_the_earliest():
    assert best(candidates([1, 2], [4, 2], [5, 1], [2, 2])).iteration == 1
    with pytest.raises(ValueError):
        best([])


@pytest.mark.parametrize(
    ("returns", "stop"),
    [
        ([[1.0, 2.0]], False),
        # every robot gains the same: a difference without error, however small
        ([[1.0, 2.0], [1.1, 2.1]], False),
        # gains of 3 and -1: mean 1, standard error 2
        ([[1.0, 2.0], [4.0, 1.0]], True),
        # the third is compared with the first, on which the second was no improvement: gains of 2 and 1, error 0.5
        ([[1.0, 2.0], [4.0, 1.0], [3.0, 3.0]], False),
        # worse than the last improvement, better than the first
        ([[1.0, 2.0], [3.0, 4.0], [2.0, 3.0]], True),
        ([[5.0], [5.0]], True),
        ([[5.0], [5.5]], False),
    ],
)
def test_a_plateau_by_hand(returns, stop):
    assert stalled(candidates(*returns), patience=1) is stop


def test_patience_counts_evaluations_in_a_row():
    level, up = [1.0, 2.0], [2.0, 3.0]
    assert not stalled(candidates(level, level), 2)
    assert stalled(candidates(level, level, level), 2)
    assert not stalled(candidates(level, level, up, up), 2)
    assert stalled(candidates(level, level, up, up, up), 2)


def test_gains_are_robot_by_robot():
    before = evaluation(returns=np.array([[1.0, 2.0, 3.0, 4.0]]), survived=np.array([[True, True, False, True]]))
    after = replace(before, returns=np.array([[2.0, 3.0, 4.0, 7.0]]), survived=np.ones((1, 4), dtype=bool))
    result = gains(before, after)
    # gains of 1, 1, 1, 3: mean 1.5, standard deviation 1
    assert result["returns"].difference.mean == 1.5
    assert result["returns"].difference.sem == pytest.approx(0.5)
    assert result["returns"].before.sem == pytest.approx(math.sqrt(5 / 3 / 4))
    assert result["survived"].before.mean == 0.75
    assert result["energy"].difference.mean == 0.0
    with pytest.raises(ValueError, match="same bodies under the same protocol and seed"):
        gains(before, replace(after, config=EvalConfig(robots_per_body=4, seed=1)))


def course(
    obstacle: list[float], hip: list[float], succeeded: list[bool], kinds: list[str] | None = None
) -> Evaluation:
    size, height = np.array([obstacle]), np.array([hip])
    return evaluation(
        robots=len(obstacle),
        succeeded=np.array([succeeded]),
        course=Course(size, height, length=np.full_like(size, 8.0), kind=np.array([kinds or ["gaps"] * len(hip)])),
    )


def test_success_is_binned_by_the_bodys_own_hip_height():
    # the same obstacle of 0.3 m is 1 hip height for one body and 1.5 for another
    result = course([0.3, 0.3, 0.3, 0.2, 0.06], [0.3, 0.2, 0.2, 0.4, 0.3], [True, False, True, True, True])
    assert success_by_obstacle(result, 0.5) == [
        ObstacleBin("gaps", 0.0, 0.5, 1, 1),
        ObstacleBin("gaps", 0.5, 1.0, 1, 1),
        ObstacleBin("gaps", 1.0, 1.5, 1, 1),
        ObstacleBin("gaps", 1.5, 2.0, 2, 1),
    ]
    # of 10 m commanded, the course asks for 8
    assert result.summary()["commanded_distance"] == 8.0


def test_kinds_of_courses_have_bins_of_their_own():
    result = course([0.3] * 3, [0.3] * 3, [True, False, True], ["hurdles", "gaps", "hurdles"])
    assert success_by_obstacle(result, 0.5) == [
        ObstacleBin("gaps", 1.0, 1.5, 1, 0),
        ObstacleBin("hurdles", 1.0, 1.5, 2, 2),
    ]


def test_wilsons_interval():
    low, high = ObstacleBin("gaps", 0, 1, robots=10, succeeded=8).interval
    assert (low, high) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    for k in (0, 3, 7):
        theirs = stats.binomtest(k, 7).proportion_ci(method="wilson")
        assert ObstacleBin("gaps", 0, 1, 7, k).interval == pytest.approx((theirs.low, theirs.high), abs=1e-9)
    # Wilson's definition: the rates from which the one seen is 1.96 standard deviations away
    for rate in (low, high):
        assert abs(0.8 - rate) == pytest.approx(1.959964 * math.sqrt(rate * (1.0 - rate) / 10), rel=1e-5)


def test_level_ground_has_no_obstacles():
    with pytest.raises(ValueError, match="needs an evaluation on a course"):
        success_by_obstacle(evaluation())
