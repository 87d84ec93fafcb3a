"""The order of proposals, and what holds when the models fail."""

import numpy as np
import pytest
from codesign_bo import BoxSpace, Integer
from codesign_bo.acquisition import proposal
from codesign_bo.acquisition.functions import Objective
from codesign_bo.acquisition.proposal import MIN_SEPARATION, Belief, fingerprint, propose, suggest
from codesign_bo.models.surrogate import fit_surrogate
from codesign_bo.seeds import derive_seed

SPACE = BoxSpace.box(["a", "b"], 0, 1, 0.5)
NONE = np.empty((0, 2))


@pytest.fixture
def belief():
    x = np.random.default_rng(3).uniform(size=(10, 2))
    return Belief((Objective(fit_surrogate(x, -np.sum((x - 0.6) ** 2, axis=1), np.full(10, 0.1), 0)),))


def point(made):
    return np.array(list(made.params.values()))


def test_the_models_take_over_after_the_initial_trials(belief):
    assert propose(SPACE, 0, 4, 0, belief, NONE).origin == "nominal"
    assert propose(SPACE, 3, 4, 0, belief, NONE).origin == "sobol"
    made = propose(SPACE, 4, 4, 0, belief, NONE)
    assert made.origin == "surrogate"
    seed = derive_seed(0, 4, 1)
    np.testing.assert_array_equal(point(made), suggest(SPACE, belief, NONE, seed))
    assert propose(SPACE, 4, 4, 0, belief, NONE, queued={"a": 0.1, "b": 0.2}).origin == "queued"


def test_when_the_models_fail_a_sobol_point_is_taken(belief, monkeypatch):
    def broken(*args, **kwargs):
        raise RuntimeError("not positive definite")

    expected = propose(SPACE, 4, 99, 0, belief, NONE)
    monkeypatch.setattr(proposal, "maximise", broken)
    made = propose(SPACE, 4, 4, 0, belief, NONE)
    assert (made.origin, made.params) == ("sobol", expected.params)


def test_near_duplicates_of_pending_and_failed_points_are_nudged():
    plain = point(propose(SPACE, 4, 99, 0, None, NONE))
    for pending, failed in ((plain[None] + 1e-5, NONE), (NONE, plain[None] + 1e-5)):
        gap = np.abs(point(propose(SPACE, 4, 99, 0, None, pending, failed)) - plain).max()
        assert MIN_SEPARATION * 0.9 < gap < 20 * MIN_SEPARATION
    np.testing.assert_array_equal(point(propose(SPACE, 4, 99, 0, None, plain[None] + 0.1)), plain)


def test_a_pending_integer_is_not_proposed_twice():
    space = BoxSpace((Integer("n", 0, 5, 0),))
    pending = np.empty((0, 1))
    seen = set()
    for _ in range(5):
        made = propose(space, 3, 99, 0, None, pending)
        seen.add(made.params["n"])
        pending = np.concatenate([pending, space.to_unit(space.designs([made.params]))])
    assert len(seen) == 5


def test_the_fingerprint_tells_models_apart(belief):
    s = belief.objectives[0].surrogate
    same = Belief((Objective(fit_surrogate(s.x, s.y, s.sem, 0)),))
    other = Belief((Objective(fit_surrogate(s.x, s.y + np.arange(10), s.sem, 0)),))
    assert fingerprint(same) == fingerprint(belief) != fingerprint(other)
