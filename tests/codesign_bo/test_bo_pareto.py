"""Pareto fronts, hypervolumes, and a study with two objectives."""

import numpy as np
import pytest
import torch
from botorch.utils.multi_objective.hypervolume import Hypervolume
from botorch.utils.multi_objective.pareto import is_non_dominated
from codesign_bo import BoxSpace, EvalResult, Study
from codesign_bo.acquisition.pareto import hypervolume, non_dominated, pareto_front, reference_point
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

tables = st.integers(1, 3).flatmap(
    lambda m: arrays(float, st.tuples(st.integers(1, 8), st.just(m)), elements=st.integers(-5, 5).map(float))
)


@given(tables)
def test_the_front_agrees_with_botorch(values):
    got = non_dominated(values)
    np.testing.assert_array_equal(got, is_non_dominated(torch.as_tensor(values), deduplicate=False).numpy())
    assert got.any()


@settings(max_examples=60)
@given(tables)
def test_the_hypervolume_agrees_with_botorch(values):
    reference = np.full(values.shape[1], -2.0)
    front = torch.as_tensor(values[non_dominated(values)])
    peer = Hypervolume(torch.as_tensor(reference)).compute(front) if values.shape[1] > 1 else None
    truth = max(values.max() + 2.0, 0.0) if peer is None else peer
    assert hypervolume(values, reference) == pytest.approx(truth)


@given(tables, st.integers(0, 7))
def test_more_designs_never_dominate_less(values, drop):
    reference = np.full(values.shape[1], -6.0)
    assert (
        hypervolume(np.delete(values, drop % len(values), axis=0), reference) <= hypervolume(values, reference) + 1e-9
    )


def test_hypervolume_by_hand():
    # boxes of 3 x 1 and 1 x 2 from the origin share 1 x 1
    assert hypervolume(np.array([[3.0, 1.0], [1.0, 2.0], [1.0, 1.0]]), np.zeros(2)) == 4.0
    assert hypervolume(np.array([[2.0, 2.0, 2.0]]), np.array([1.0, 1.0, 0.0])) == 2.0
    assert hypervolume(np.array([[3.0, -1.0]]), np.zeros(2)) == 0.0


def test_the_reference_point_by_hand():
    # the front is (0, 10) and (5, 0): ranges 5 and 10, a tenth of each below the worst
    np.testing.assert_allclose(reference_point(np.array([[0.0, 10.0], [5.0, 0.0], [-9.0, -9.0]])), [-0.5, -1.0])
    # a single best design: the ranges of all designs count
    np.testing.assert_allclose(reference_point(np.array([[5.0, 5.0], [1.0, 3.0]])), [4.6, 4.8])
    np.testing.assert_allclose(reference_point(np.array([[5.0, 5.0]])), [4.9, 4.9])


def test_the_front_is_told_in_the_objectives_own_directions():
    mean = np.array([[10.0, 200.0], [8.0, 100.0], [7.0, 150.0], [12.0, 300.0]])
    front = pareto_front(["mean", "energy"], [0, 3, 4, 7], mean, np.ones((4, 2)), [True, False])
    assert front.trials == (7, 0, 3)
    np.testing.assert_allclose(front.reference, [7.6, 320.0])
    # by hand: 4.4 x 20, then 2.4 x 100 further down in energy, then 0.4 x 100
    assert front.hypervolume == pytest.approx(4.4 * 20 + 2.4 * 100 + 0.4 * 100)


def tradeoff(params):
    """Reward and energy both rise with a; b = 0.5 is best for both."""
    loss = (params["b"] - 0.5) ** 2
    return params["a"] - loss, 10 * (params["a"] ** 2 + loss)


@pytest.mark.slow
def test_a_study_with_two_objectives_spreads_along_the_front(tmp_path):
    space = BoxSpace.box(["a", "b"], 0, 1, 0.2)
    with Study(space, tmp_path / "s.sqlite", seed=1, objectives={"energy": "minimize"}) as study:
        for _ in range(20):
            (request,) = study.ask()
            reward, energy = tradeoff(request.params)
            study.tell(request.trial, EvalResult(reward, 0.01, extras={"energy": energy, "energy_sem": 0.1}))
        front = study.pareto()
        found = [t.params for t in study.trials() if t.origin == "surrogate"]
    assert front.objectives == ("mean", "energy")
    assert len(front.trials) >= 5
    assert front.mean[0, 0] == front.mean[:, 0].max()
    assert np.ptp([p["a"] for p in found]) > 0.5  # from frugal to strong
    assert np.median([abs(p["b"] - 0.5) for p in found]) < 0.1
    # of the whole front: a in [0, 1], energy 10 a^2, beyond (0, 10): the integral of 10 - 10 a^2
    values = np.array([[reward, -energy] for reward, energy in map(tradeoff, found)])
    assert hypervolume(values, np.array([0.0, -10.0])) > 0.7 * 20 / 3
