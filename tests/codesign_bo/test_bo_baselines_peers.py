"""The baselines are the libraries as their own users run them: the same designs, to the bit."""

import math

import numpy as np
import pytest
from codesign_bo import BoxSpace
from codesign_bo.baselines import make_optimiser

SPACE = BoxSpace.box("abcd", 0.0, 1.0, [0.3, 0.6, 0.8, 0.2])


def loss(point):
    return float(np.sum((np.asarray(point) - 0.4) ** 2))


def points_asked_for(method, n, seed, fail=()):
    optimiser, points = make_optimiser(method, SPACE, seed, maximize=False), []
    for number in range(n):
        params = optimiser.ask()
        points.append(list(params.values()))
        optimiser.tell(params, math.nan if number in fail else loss(points[-1]))
    return points


@pytest.mark.parametrize("fail", [(), (4, 21)])
def test_hyperopt_is_fmin_with_its_defaults(fail):
    hyperopt = pytest.importorskip("hyperopt")
    points = []

    def objective(design):
        points.append([design[f"x{i}"] for i in range(4)])
        if len(points) - 1 in fail:
            return {"status": hyperopt.STATUS_FAIL}
        return loss(points[-1])

    hyperopt.fmin(
        objective,
        {f"x{i}": hyperopt.hp.uniform(f"x{i}", 0, 1) for i in range(4)},
        algo=hyperopt.tpe.suggest,
        max_evals=30,
        rstate=np.random.default_rng(5),
        show_progressbar=False,
    )
    assert points_asked_for("hyperopt-tpe", 30, 5, fail) == points


@pytest.mark.parametrize(("method", "sampler"), [("optuna-tpe", "TPESampler"), ("optuna-gp", "GPSampler")])
def test_optuna_is_optimize_with_the_samplers_defaults(method, sampler):
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=getattr(optuna.samplers, sampler)(seed=5))
    study.optimize(lambda t: loss([t.suggest_float(f"x{i}", 0.0, 1.0) for i in range(4)]), n_trials=13)
    asked = points_asked_for(method, 13, 5)
    assert asked == [list(t.params.values()) for t in study.trials]


def test_a_failure_keeps_optunas_gaussian_process_away():
    """Half of the cube fails, and the loss falls towards it: told so, it does not keep asking for the same."""
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    optimiser, failed = make_optimiser("optuna-gp", SPACE, 0, maximize=False), []
    for _ in range(26):
        params = optimiser.ask()
        failed.append(params["a"] > 0.5)
        optimiser.tell(params, math.nan if failed[-1] else -params["a"])
    assert sum(failed[10:]) <= 8
    assert optimiser.recommend()["a"] > 0.45


def test_cma_es_is_pycmas_ask_and_tell():
    cma = pytest.importorskip("cma")
    state = np.random.get_state()  # noqa: NPY002
    strategy = cma.CMAEvolutionStrategy([0.3, 0.6, 0.8, 0.2], 0.3, {"bounds": [0, 1], "seed": 5, "verbose": -9})
    points = []
    for _ in range(5):
        population = strategy.ask()
        points += [list(p) for p in population]
        strategy.tell(population, [loss(p) for p in population])
    np.random.set_state(state)  # noqa: NPY002
    assert points_asked_for("cma-es", len(points), 5) == points


def test_cma_es_converges_with_several_designs_out_and_with_failures():
    pytest.importorskip("cma")
    optimiser = make_optimiser("cma-es", SPACE, 0, maximize=False)
    out = [optimiser.ask() for _ in range(5)]
    for _ in range(800):
        params = out.pop(1)  # so the first never comes back
        point = list(params.values())
        optimiser.tell(params, math.nan if point[0] < 0.35 else loss(point))
        out.append(optimiser.ask())
    assert loss(list(optimiser.recommend().values())) < 1e-6
    assert all(loss(list(params.values())) < 1e-3 for params in out[1:])


def test_cma_es_goes_on_when_a_whole_population_fails():
    pytest.importorskip("cma")
    asked = points_asked_for("cma-es", 40, 0, fail=range(16))
    assert loss(min(asked[16:], key=loss)) < loss(SPACE.designs([SPACE.nominal])[0])
