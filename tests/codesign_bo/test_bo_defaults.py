"""The comparison by which the defaults were chosen."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from codesign_bo.baselines import make_optimiser
from scipy.optimize import minimize, rosen

sys.path.append(str(Path(__file__).parents[2]))

from benchmarks import bo_defaults as defaults
from benchmarks.bo_problems import PROBLEMS
from benchmarks.bo_runs import simulate


def test_rosenbrock_agrees_with_scipy():
    x = np.random.default_rng(0).uniform(-2, 2, (5, 4))
    np.testing.assert_allclose(defaults.rosenbrock(x), [-np.log1p(rosen(row)) for row in x])


@pytest.mark.parametrize("problem", defaults.FURTHER.values(), ids=list(defaults.FURTHER))
def test_optima_are_where_they_are_said_to_be(problem):
    at = np.array(problem.best_design)
    found = minimize(lambda x: -problem.value(x), at, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-10})
    assert problem.best == pytest.approx(-found.fun, abs=1e-6)
    assert problem.best == pytest.approx(float(problem.value(at)), abs=1e-6)
    draws = np.random.default_rng(0).uniform(problem.low, problem.high, (20_000, 4))
    assert problem.value(draws).max() <= problem.best


@pytest.mark.slow
@pytest.mark.parametrize("name", ["noisy-hartmann4", "legs4"])
def test_a_run_without_a_file_is_what_a_study_does(name):
    problem = PROBLEMS[name]
    trace = simulate(make_optimiser("codesign-bo", problem.space(7), 7), problem, 7, 12)
    assert defaults.run("default", problem, 7, 12) == trace.regret[-1]


def test_the_table_by_hand():
    regrets = {("a", "p", 0): math.e - 1e-3, ("a", "p", 1): 1 - 1e-3, ("b", "p", 0): 1 - 1e-3, ("b", "p", 1): 1 - 1e-3}
    regrets["b", "p", 2] = 50.0  # the first variant has not done this seed
    first, second = defaults.table(regrets, ("a", "b"), ("p", "q"))
    assert "a" in first
    assert "log regret +0.00 +- 0.00" in first
    assert "2 seeds, median    0.999, log regret -0.50 +- 0.50" in second
