"""What holds for every optimiser behind the interface, whatever library is inside."""

import importlib.util
import math
import subprocess
import sys

import numpy as np
import pytest
from codesign_bo import BoxSpace
from codesign_bo.baselines import OPTIMISERS, RandomSearch, SobolSearch, make_optimiser
from codesign_bo.space import Categorical, Continuous, Integer, LinearConstraint
from hypothesis import given
from hypothesis import strategies as st

LIBRARIES = {"hyperopt-tpe": "hyperopt", "optuna-tpe": "optuna", "optuna-gp": "optuna", "cma-es": "cma"}


@pytest.fixture(params=[*OPTIMISERS])
def method(request):
    if request.param in LIBRARIES:
        pytest.importorskip(LIBRARIES[request.param])
    return request.param


@pytest.fixture
def mixed():
    """Log and linear numbers, a whole one, a choice, and a fixed one."""
    parameters = (
        Continuous("thigh", 0.6, 1.4, 1.1),
        Continuous("stiffness", 1.0, 1000.0, 30.0, log=True),
        Integer("teeth", 3, 5, 4),
        Categorical("foot", ("ball", "flat"), "flat"),
        Continuous("height", 0.3, 0.3, 0.3, fixed=True),
    )
    return BoxSpace(parameters)


def score(params):
    return -((params["thigh"] - 1.2) ** 2) - (params["shank"] - 0.8) ** 2


def trace(method, space, seed, n, maximize=True, fail=()):
    """Designs asked for in turns with tells of `score`, or of its negative; those numbered in `fail` fail."""
    optimiser, designs = make_optimiser(method, space, seed, maximize), []
    for number in range(n):
        designs.append(optimiser.ask())
        mean = math.nan if number in fail else score(designs[-1]) * (1 if maximize else -1)
        optimiser.tell(designs[-1], mean, None if number in fail else 0.01)
    return designs, optimiser.recommend()


def length(method):
    """Evaluations enough for each to use its model: 20 at random are Hyperopt's, 10 Optuna's, 4 ours in 2-D."""
    return {"hyperopt-tpe": 22, "codesign-bo": 6}.get(method, 13)


def test_the_same_seed_gives_the_same_trace_and_another_seed_another(method, space):
    n = length(method)
    first = trace(method, space, 3, n, fail={2})
    assert first == trace(method, space, 3, n, fail={2})
    assert first[0] != trace(method, space, 4, n, fail={2})[0]


def test_minimising_the_negative_is_maximising(method, space):
    n = length(method)
    designs, recommended = trace(method, space, 5, n, maximize=False)
    if method == "codesign-bo":  # its Monte Carlo samples have a direction
        assert score(recommended) >= np.median([score(params) for params in designs])
    else:
        assert trace(method, space, 5, n) == (designs, recommended)


def test_what_is_told_matters_once_a_model_is_used(method, space):
    if method in ("random", "sobol"):
        pytest.skip("learns nothing")
    n = length(method)
    designs, _ = trace(method, space, 3, n)
    best = int(np.argmax([score(params) for params in designs[: n - 2]]))
    assert trace(method, space, 3, n, fail={best})[0] != designs


def test_designs_lie_in_the_space_whatever_its_kinds(method, mixed):
    optimiser = make_optimiser(method, mixed, 0)
    for _ in range(length(method) + 4):
        params = optimiser.ask()
        assert mixed.check(params) == params
        assert params["height"] == 0.3
        assert isinstance(params["teeth"], int)
        optimiser.tell(params, float(params["teeth"]), 0.0)
    assert optimiser.recommend()["teeth"] == 5


def test_several_designs_may_be_out_and_come_back_in_any_order(method, space):
    optimiser = make_optimiser(method, space, 1)
    out, told = [optimiser.ask() for _ in range(4)], []
    for _ in range(length(method)):
        params = out.pop(2)
        optimiser.tell(params, score(params), 0.0)
        told.append(params)
        out.append(optimiser.ask())
    assert len({tuple(p.values()) for p in told + out}) == len(told + out)
    assert optimiser.recommend() in told


def test_only_designs_that_are_out_can_be_told_and_only_once(method, space):
    optimiser = make_optimiser(method, space, 0)
    with pytest.raises(LookupError, match="no design has a score"):
        optimiser.recommend()
    params = optimiser.ask()
    with pytest.raises(ValueError, match="not asked for"):
        optimiser.tell({"thigh": 0.61, "shank": 0.51}, 1.0)
    for mean, sem in ((math.inf, 0.1), (1.0, -0.1), (1.0, math.nan)):
        with pytest.raises(ValueError, match=r"mean is inf|sem is"):
            optimiser.tell(params, mean, sem)
    optimiser.tell(params, math.nan)
    with pytest.raises(LookupError, match="no design has a score"):
        optimiser.recommend()
    with pytest.raises(ValueError, match="told already"):
        optimiser.tell(params, 1.0)


def test_numpys_global_random_numbers_are_left_alone(method, space):
    before = np.random.get_state()  # noqa: NPY002
    trace(method, space, 3, length(method))
    assert repr(np.random.get_state()) == repr(before)  # noqa: NPY002


def test_a_bad_seed_and_an_unknown_name_are_refused(method, space):
    with pytest.raises(ValueError, match="seed is -1"):
        make_optimiser(method, space, -1)
    with pytest.raises(ValueError, match=r"'annealing'.*random.*cma-es"):
        make_optimiser("annealing", space, 0)


def test_baselines_refuse_linear_constraints(method, space):
    held = space.with_constraints(LinearConstraint({"thigh": 1, "shank": 1}, high=2.2))
    if method == "codesign-bo":
        assert sum(make_optimiser(method, held, 0).ask().values()) <= 2.2
    else:
        with pytest.raises(ValueError, match="linear constraints"):
            make_optimiser(method, held, 0)


@given(st.lists(st.one_of(st.just(math.nan), st.integers(-5, 5).map(float)), min_size=1, max_size=12), st.booleans())
def test_baselines_recommend_the_best_observed_design(means, maximize):
    optimiser = RandomSearch(BoxSpace.box(["thigh", "shank"], 0.6, 1.4, 1.0), 0, maximize)
    designs = [optimiser.ask() for _ in means]
    for params, mean in zip(designs, means, strict=True):
        optimiser.tell(params, mean)
    scored = [m for m in means if not math.isnan(m)]
    if scored:
        assert optimiser.recommend() == designs[means.index(max(scored) if maximize else min(scored))]
    else:
        with pytest.raises(LookupError):
            optimiser.recommend()


def test_a_study_recommends_by_its_model_and_not_the_luckiest_score(space):
    optimiser = make_optimiser("codesign-bo", space, 0)
    for _ in range(4):
        params = optimiser.ask()
        # the nominal design is lucky by 1, and says how uncertain it is
        lucky = params == space.nominal
        optimiser.tell(params, score(params) + lucky, 2.0 if lucky else 0.001)
    assert optimiser.recommend() != space.nominal


def test_designs_that_are_out_twice_can_be_told_twice():
    space = BoxSpace((Integer("teeth", 3, 4, 3), Continuous("height", 0.3, 0.3, 0.3, fixed=True)))
    optimiser = RandomSearch(space, 0)
    designs = [optimiser.ask() for _ in range(6)]
    assert designs.count(designs[0]) > 1
    for params in designs:
        optimiser.tell(params, 1.0)
    with pytest.raises(ValueError, match="not out"):
        optimiser.tell(designs[0], 1.0)


@pytest.mark.parametrize("dim", [1, 3])
def test_sobol_points_fill_every_stratum_once(dim):
    """The first 2^m points of a scrambled Sobol sequence have one in each of 2^m equal slices of each axis."""
    optimiser = SobolSearch(BoxSpace.box([f"x{i}" for i in range(dim)], 0.0, 1.0, 0.5), seed=11)
    points = np.array([list(optimiser.ask().values()) for _ in range(32)])
    for axis in points.T:
        assert sorted(np.floor(32 * axis).astype(int)) == list(range(32))


@pytest.mark.parametrize(("name", "library"), LIBRARIES.items())
def test_a_missing_library_is_named_with_the_way_to_install_it(name, library, space, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    if name == "hyperopt-tpe":
        monkeypatch.setitem(sys.modules, "hyperopt.base", None)
    with pytest.raises(ImportError, match=rf"needs {library}.*legged-codesign-bo\[baselines\]"):
        make_optimiser(name, space, 0)


def test_libraries_are_imported_only_when_they_are_used():
    if not any(map(importlib.util.find_spec, LIBRARIES.values())):
        pytest.skip("none of the libraries is installed")
    code = f"import sys, codesign_bo.baselines; print(sorted({set(LIBRARIES.values())} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_cma_es_refuses_a_single_free_parameter(space):
    pytest.importorskip("cma")
    with pytest.raises(ValueError, match=r"at least 2 free parameters.*shank"):
        make_optimiser("cma-es", space.fix({"thigh": 1.0}), 0)
