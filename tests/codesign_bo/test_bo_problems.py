"""The problems of benchmarks/bo.py are what they say: formulas, optima, noise, failures."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from botorch.test_functions import Ackley, Hartmann, Levy
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import differential_evolution, minimize
from scipy.stats import qmc

sys.path.append(str(Path(__file__).parents[2]))

from benchmarks.bo_problems import PROBLEMS, legs4

BOTORCH = {
    "noisy-hartmann4": Hartmann(dim=4, negate=True),
    "ackley4": Ackley(dim=4, negate=True, bounds=[(-5.0, 10.0)] * 4),
    "hartmann6": Hartmann(dim=6, negate=True),
    "levy4": Levy(dim=4, negate=True),
}


@pytest.fixture(params=[*PROBLEMS])
def problem(request):
    return PROBLEMS[request.param]


def designs(problem, n, seed=0):
    unit = qmc.Halton(len(problem.parameters), rng=seed).random(n)
    return problem.low + (problem.high - problem.low) * unit


@pytest.mark.parametrize("name", BOTORCH)
def test_functions_bounds_and_known_optima_agree_with_botorch(name):
    problem, function = PROBLEMS[name], BOTORCH[name].double()
    x = designs(problem, 500)
    torch.testing.assert_close(torch.as_tensor(problem.value(x)), function.evaluate_true(torch.as_tensor(x)) * -1)
    assert function.bounds.T.tolist() == [[problem.low, problem.high]] * len(problem.parameters)
    if name != "noisy-hartmann4":  # BoTorch does not know this one
        assert problem.best == pytest.approx(function.optimal_value, abs=1e-5)
        assert problem.best_design == pytest.approx(function.optimizers[0].tolist(), abs=1e-5)


def test_the_best_value_is_that_of_a_global_optimiser(problem):
    """Differential evolution, then a simplex from where it ends; neither uses gradients."""

    def loss(x):
        """Of x (d,) or, all at once, of (d, n)."""
        rows = np.atleast_2d(x.T)
        values = np.where([problem.feasible(row) for row in rows], -problem.value(rows), 1e3)
        return values if x.ndim == 2 else values[0]

    bounds = [(problem.low, problem.high)] * len(problem.parameters)
    settings = {"popsize": 40, "tol": 1e-6, "maxiter": 300, "vectorized": True, "updating": "deferred"}
    found = differential_evolution(loss, bounds, rng=1, polish=False, **settings)
    end = minimize(loss, found.x, method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-13, "maxiter": 4000})
    assert -end.fun == pytest.approx(problem.best, abs=1e-6)
    assert end.x == pytest.approx(problem.best_design, abs=1e-5)


def test_nothing_in_the_box_is_better(problem):
    x = designs(problem, 20_000)
    assert problem.value(x).max() <= problem.best
    best = dict(zip(problem.parameters, problem.best_design, strict=True))
    assert 0.0 <= problem.regret(best) + 1e-9 <= 1e-6


def test_regret_counts_from_the_noise_free_value(problem):
    for x in designs(problem, 50):
        params = dict(zip(problem.parameters, x, strict=True))
        expected = problem.best - float(problem.value(x)) if problem.feasible(x) else math.inf
        assert problem.regret(params) == expected


@given(st.sampled_from([*PROBLEMS]), st.integers(0, 200), st.floats(-4, 4))
def test_a_score_is_the_value_with_its_noise_or_a_failure(name, number, draw):
    problem = PROBLEMS[name]
    x = designs(problem, 201)[number]
    params = dict(zip(problem.parameters, x, strict=True))
    score = problem.evaluate(params, draw)
    if not problem.feasible(x):
        assert math.isnan(score.mean)
        return
    assert score.mean - float(problem.value(x)) == pytest.approx(problem.noise(x) * draw, abs=1e-9)
    assert score.sem is not None
    if name == "noisy-hartmann4":
        assert score.sem == problem.noise(x) == pytest.approx(0.1 + 0.4 * x[0])
    elif name == "legs4":
        assert score.sem < problem.noise(x)  # a lower bound
        assert math.hypot(score.sem, 0.4) == pytest.approx(problem.noise(x))
    else:
        assert score.sem == problem.noise(x) == 0.0


def test_the_nominal_design_belongs_to_the_seed_and_gives_nothing_away(problem):
    spaces = [problem.space(seed) for seed in range(60)]
    assert problem.space(7) == spaces[7] != spaces[8]
    assert {(p.low, p.high) for p in spaces[0].parameters} == {(problem.low, problem.high)}
    nominal = np.array([list(space.nominal.values()) for space in spaces])
    unit = (nominal - problem.low) / (problem.high - problem.low)
    assert np.abs(unit.mean(axis=0) - 0.5).max() < 5 * math.sqrt(1 / 12 / 60)


def test_legs_by_hand():
    # f = h = a = b = 0, r = -0.1: 4 + 6 exp(-(1 + 0.5289256 + 0.0816327 + 0.1836735) / 2) + 2.5 exp(-(4 + 2.25) / 2)
    assert legs4(np.ones(4)) == pytest.approx(4 + 6 * 0.4077440 + 2.5 * 0.0439369, abs=1e-5)
    # f = 0.1, h = 0, a = b = 0.2: r = -0.032
    x = np.array([1.2, 1.0, 1.1, 0.9])
    ridge = 6 * math.exp(-(0.1024 + 0.0743802 + 0.7346939 + 0.0204082) / 2)
    small = 2.5 * math.exp(-(9 + 2.25 + 2 * 0.3265306) / 2)
    assert legs4(x) == pytest.approx(4 - 0.05 + ridge + small, abs=1e-5)


def test_legs_fail_in_a_corner_of_a_known_size():
    """f - h = 0.4 (S - 2) with S a sum of four uniform numbers, so the share is Irwin and Hall's P(S > 2.625)."""
    problem = PROBLEMS["legs4"]
    share = (1.375**4 - 4 * 0.375**4) / 24
    assert share == pytest.approx(1 / 7, abs=0.005)
    x = designs(problem, 20_000)
    assert np.mean([not problem.feasible(row) for row in x]) == pytest.approx(share, abs=0.005)
    assert not problem.feasible(np.array([1.4, 1.4, 0.6, 0.6]))
    assert problem.feasible(np.ones(4))
    front, _, hind, _ = np.array(problem.best_design).reshape(2, 2).mean(axis=1).repeat(2)
    assert 0.05 < 0.25 - (front - hind) < 0.2  # the best design is near the corner, and not in it


def test_legs_trade_front_for_hind_length_along_a_curved_ridge():
    hind = np.linspace(0.6, 1.4, 801)
    best = []
    for front in (1.0, 1.1, 1.2, 1.3):
        x = np.stack([np.full(801, front - 0.05), np.full(801, front + 0.05), hind + 0.075, hind - 0.075], axis=-1)
        best.append(hind[np.argmax(legs4(x))])
    steps = np.diff(best)
    assert np.all(steps < 0)
    assert np.all(np.diff(steps) > 0)  # ever less: curved


def test_legs_have_one_mild_local_optimum_beside_the_best():
    """Where ascents from all over the box end, gradients and bounds only."""
    problem, ends = PROBLEMS["legs4"], set()
    for x in designs(problem, 120):
        end = minimize(lambda x: -float(legs4(x)), x, bounds=[(0.6, 1.4)] * 4)
        ends.add((round(-float(end.fun), 2), tuple(np.round(end.x, 1))))
    low, high = sorted(ends)
    assert high[0] == pytest.approx(problem.best, abs=0.01)
    assert low[1] == (0.8, 0.8, 0.9, 0.9)
    assert 2.0 < high[0] - low[0] < 5.0
