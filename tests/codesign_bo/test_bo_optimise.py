"""Where an acquisition is highest, in spaces of all kinds."""

import itertools

import numpy as np
import pytest
import torch
from codesign_bo import BoxSpace, Categorical, Continuous, Integer, LinearConstraint, StudyError
from codesign_bo.acquisition.optimise import maximise
from codesign_bo.models.features import Features
from hypothesis import given, settings
from hypothesis import strategies as st

MIXED = BoxSpace(
    (
        Continuous("a", 0, 1, 0.5),
        Integer("b", 0, 3, 0),
        Categorical("c", ("x", "y", "z"), "x"),
        Continuous("e", -1, 1, 0.0),
    )
)


def centre(space):
    return np.full((1, space.dim), 0.5)


def bowl(top):
    top = torch.as_tensor(np.asarray(top, dtype=float))
    return lambda at: -(at - top).square().sum(-1)


def in_features(space, weights, top):
    """A smooth function of a space's features whose optimum is known only by trying all combinations."""
    features = Features(space)
    top, weights = torch.as_tensor(top), torch.as_tensor(weights)
    return lambda at: -(weights * (features(at) - top).square()).sum(-1)


def test_a_continuous_optimum_is_found_to_high_accuracy():
    space = BoxSpace.box(list("abcd"), 0, 1, 0.5)
    top = [0.123, 0.877, 0.5, 0.999]
    np.testing.assert_allclose(maximise(space, bowl(top), centre(space), 0), top, atol=1e-4)
    outside = [1.5, -0.2, 0.3, 0.4]  # then the nearest point of the cube
    np.testing.assert_allclose(maximise(space, bowl(outside), centre(space), 0), [1, 0, 0.3, 0.4], atol=1e-4)


def test_a_narrow_peak_near_a_centre_is_found():
    space = BoxSpace.box(list("abcdef"), 0, 1, 0.5)
    top = torch.full((6,), 0.31, dtype=torch.float64)
    point = maximise(space, lambda at: torch.exp(-((at - top) / 0.02).square().sum(-1)), np.full((1, 6), 0.3), 0)
    assert np.abs(point - 0.31).max() < 2e-3


@pytest.mark.parametrize("seed", range(4))
def test_in_a_mixed_space_it_is_the_best_of_all_combinations(seed):
    rng = np.random.default_rng(seed)
    value = in_features(MIXED, rng.uniform(0.2, 2, 6), rng.uniform(0, 1, 6))
    point = maximise(MIXED, value, centre(MIXED), seed)
    np.testing.assert_array_equal(MIXED.snap(point[None])[0], point)
    axis = np.linspace(0, 1, 201)
    grid = np.array(list(itertools.product(axis, [0.125, 0.375, 0.625, 0.875], [1 / 6, 0.5, 5 / 6], axis)))
    best = value(torch.as_tensor(grid)).max().item()
    assert value(torch.as_tensor(point[None])).item() >= best - 1e-6


def test_all_designs_of_a_small_discrete_space_are_compared():
    space = BoxSpace((Integer("a", 0, 4, 0), Categorical("b", ("p", "q", "r", "s"), "p")))
    designs = space.to_unit(np.array(list(itertools.product(range(5), range(4))), dtype=float))
    for seed in range(5):
        table = np.random.default_rng(seed).normal(size=(5, 4))

        def value(at, table=table):
            rows = space.from_unit(at.numpy()).astype(int)
            return torch.as_tensor(table[rows[:, 0], rows[:, 1]])

        found = space.from_unit(maximise(space, value, centre(space), 0)[None])[0]
        best = space.from_unit(designs[[int(np.argmax(table.reshape(-1)))]])[0]
        np.testing.assert_array_equal(found, best)


def test_a_large_discrete_space_is_searched_from_neighbour_to_neighbour():
    space = BoxSpace(tuple(Integer(name, 0, 40, 0) for name in "abcdef"))
    top = (np.array([3, 37, 20, 11, 29, 8]) + 0.5) / 41
    np.testing.assert_allclose(maximise(space, bowl(top), centre(space), 0), top, atol=2.5 / 41)


def test_linear_constraints_hold_on_the_boundary():
    space = BoxSpace.box(list("abc"), 0, 1, 0.1).with_constraints(LinearConstraint({"a": 1, "b": 1, "c": 1}, high=1.2))
    # projecting (1, 0.8, 0.3) on the plane a + b + c = 1.2 takes 0.3 off each
    point = maximise(space, bowl([1.0, 0.8, 0.3]), centre(space), 0)
    np.testing.assert_allclose(point, [0.7, 0.5, 0.0], atol=2e-3)
    assert space.satisfied(space.from_unit(point[None]))[0]


def test_linear_constraints_tie_integers_to_continuous_parameters():
    space = BoxSpace(
        (Continuous("a", 0, 10, 1), Integer("n", 0, 5, 0), Categorical("c", ("x", "y"), "x")),
        (LinearConstraint({"a": 1, "n": 2}, high=9),),
    )
    # a weighs most: n must give way, to 0, for a to come near 10
    weights = torch.tensor([100.0, 1.0, 1.0], dtype=torch.float64)
    top = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    point = maximise(space, lambda at: -(weights * (at - top).square()).sum(-1), np.full((1, 3), 0.3), 0)
    assert space.satisfied(space.from_unit(point[None]))[0]
    design = space.params(space.from_unit(point[None])[0])
    assert (design["n"], design["c"]) == (0, "x")
    assert design["a"] == pytest.approx(9.0, abs=0.02)


def test_points_on_a_plane_are_found():
    space = BoxSpace.box(list("abc"), 0, 1, 0.5).with_constraints(LinearConstraint({"a": 1, "b": 1, "c": 1}, 1.5, 1.5))
    point = maximise(space, bowl([0.9, 0.3, 0.3]), centre(space), 0)
    assert space.satisfied(space.from_unit(point[None]))[0]
    assert np.abs(point - [0.9, 0.3, 0.3]).max() < 0.2


def test_a_predicate_is_never_broken():
    space = BoxSpace.box(["a", "b"], 0, 1, 0.1)
    for seed in range(3):
        point = maximise(space, bowl([0.6, 0.6]), centre(space), seed, lambda d: d.sum(axis=1) < 0.5)
        assert point.sum() < 0.5
        assert point.sum() > 0.4


def test_what_is_not_allowed_is_kept_out_unless_nothing_is_allowed():
    space = BoxSpace.box(["a", "b"], 0, 1, 0.1)
    left = maximise(space, bowl([0.8, 0.5]), centre(space), 0, allowed=lambda at: 0.5 - at[:, 0])
    assert 0.4 < left[0] < 0.5
    anywhere = maximise(space, bowl([0.8, 0.5]), centre(space), 0, allowed=lambda at: -torch.ones(len(at)))
    np.testing.assert_allclose(anywhere, [0.8, 0.5], atol=1e-3)


def test_an_acquisition_that_is_not_a_number_somewhere_is_survived():
    space = BoxSpace.box(["a", "b"], 0, 1, 0.1)

    def value(at):
        return torch.where(at[:, 0] > 0.5, torch.nan, 1.0) * bowl([0.4, 0.2])(at)

    np.testing.assert_allclose(maximise(space, value, centre(space), 0), [0.4, 0.2], atol=0.05)


def test_an_empty_space_is_an_error():
    space = BoxSpace.box(["a", "b"], 0, 1, 0.1)
    with pytest.raises(StudyError, match="feasible"):
        maximise(space, bowl([0.5, 0.5]), centre(space), 0, lambda d: np.zeros(len(d), dtype=bool))


def test_the_same_seed_gives_the_same_point_whatever_the_global_random_state():
    points, threads = [], torch.get_num_threads()
    for state in (0, 1):
        torch.manual_seed(state)
        np.random.seed(state)  # noqa: NPY002
        before = torch.random.get_rng_state()
        points.append(maximise(MIXED, bowl([0.3, 0.4, 0.9, 0.2]), centre(MIXED), 7))
        assert torch.equal(torch.random.get_rng_state(), before)
    np.testing.assert_array_equal(*points)
    assert torch.get_num_threads() == threads


@settings(max_examples=15)
@given(st.data())
def test_random_mixed_spaces_give_feasible_snapped_points(data):
    kinds = data.draw(st.lists(st.sampled_from(["continuous", "integer", "categorical"]), min_size=1, max_size=4))
    made = {
        "continuous": lambda n: Continuous(n, -1, 3, 0.0),
        "integer": lambda n: Integer(n, 0, 5, 0),
        "categorical": lambda n: Categorical(n, ("x", "y", "z"), "x"),
    }
    space = BoxSpace(tuple(made[kind](f"p{i}") for i, kind in enumerate(kinds)))
    numeric = [f"p{i}" for i, kind in enumerate(kinds) if kind != "categorical"]
    if numeric and data.draw(st.booleans()):
        space = space.with_constraints(LinearConstraint(dict.fromkeys(numeric, 1.0), high=data.draw(st.floats(0.1, 4))))
    top = data.draw(st.lists(st.floats(0, 1), min_size=space.dim, max_size=space.dim))
    point = maximise(space, bowl(top), centre(space), data.draw(st.integers(0, 99)))
    assert space.satisfied(space.from_unit(point[None]))[0]
    np.testing.assert_array_equal(space.snap(point[None])[0], point)
    assert ((point >= 0) & (point <= 1)).all()


def test_gradients_pass_through_continuous_coordinates_only():
    features = Features(MIXED)
    at = torch.tensor([[0.3, 0.6, 0.9, 0.1]], dtype=torch.float64, requires_grad=True)
    np.testing.assert_allclose(features(at).detach().numpy(), MIXED.features(at.detach().numpy()))
    (gradient,) = torch.autograd.grad(features(at).sum(), at)
    np.testing.assert_array_equal(gradient.numpy(), [[1, 0, 0, 1]])
