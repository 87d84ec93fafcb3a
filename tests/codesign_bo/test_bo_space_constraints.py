"""Linear constraints: verdicts against exact arithmetic, and points spread over what they leave."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from codesign_bo import BoxSpace, StudyError, sobol_designs
from codesign_bo.space import Categorical, Continuous, Integer, LinearConstraint, is_feasible, sobol_points
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

LEG = LinearConstraint({"thigh": 1, "shank": 1}, high=2.4)
FEW = settings(max_examples=40)  # each example solves several linear programs


# --- by hand --------------------------------------------------------------------------------------------


def test_a_constraint_reads_like_one():
    assert str(LEG) == "thigh + shank <= 2.4"
    assert str(LinearConstraint({"a": -2, "b": 0.5}, low=-1, high=3)) == "-1.0 <= -2.0*a + 0.5*b <= 3.0"
    assert str(LinearConstraint({"a": 1, "b": -1}, low=0, high=0)) == "a - b == 0.0"


def test_a_leg_of_limited_length(space):
    legs = space.with_constraints(LEG)
    designs = np.array([[1.0, 1.4], [1.0, 1.41], [1.4, 1.0], [1.4, 1.5], [0.6, 0.5]])
    np.testing.assert_array_equal(legs.satisfied(designs), [True, False, True, False, True])
    assert is_feasible(legs, legs.to_unit(designs), None).tolist() == [True, False, True, False, True]
    # thigh = 0.6 + 0.8 u, shank = 0.5 + v: 0.8 u + v <= 1.3
    matrix, bound = legs.unit_inequalities()
    np.testing.assert_allclose(matrix / bound[:, None], [[0.8 / 1.3, 1 / 1.3]])
    assert bound[0] < 0


def test_check_names_the_broken_constraint_and_rounding_breaks_none(space):
    legs = space.with_constraints(LEG)
    with pytest.raises(ValueError, match=r"thigh \+ shank <= 2.4"):
        legs.check({"thigh": 1.2, "shank": 1.3})
    assert 1.1 + 1.3 > 2.4  # in floating point
    assert legs.check({"thigh": 1.1, "shank": 1.3}) == {"thigh": 1.1, "shank": 1.3}


def test_a_fixed_parameter_folds_in():
    space = BoxSpace.box(["a", "b", "c"], 0.0, [1.0, 2.0, 4.0], [0.5, 0.5, 0.5])
    held = space.with_constraints(LinearConstraint({"a": 2, "b": 1, "c": 3}, low=1, high=5)).fix({"a": 0.25})
    # 1 - 0.5 <= 2 u + 12 v <= 5 - 0.5
    matrix, bound = held.unit_inequalities()
    scale = np.abs(matrix).sum(axis=1) / 14
    np.testing.assert_allclose(matrix / scale[:, None], [[-2, -12], [2, 12]])
    np.testing.assert_allclose(bound / scale, [-4.5, 0.5])
    assert held.fix({"b": 1.0, "a": 0.25}).dim == 1


def test_a_constraint_among_fixed_parameters_alone_leaves_the_rest_free():
    space = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5).with_constraints(LinearConstraint({"a": 1}, high=0.6))
    held = space.fix({"a": 0.6})
    assert held.satisfied(held.from_unit(np.array([[0.0], [1.0]]))).all()
    assert len(sobol_points(held, 10, 0)) == 10


def test_constraints_belong_to_the_space(space):
    legs = space.with_constraints(LEG)
    assert legs != space
    assert legs == space.with_constraints(LinearConstraint({"shank": 1.0, "thigh": 1.0}, high=2.4), LEG)
    assert BoxSpace.from_signature(legs.signature()) == legs
    assert hash(BoxSpace.from_signature(legs.signature())) == hash(legs)
    assert legs.with_bounds({"thigh": (0.9, 1.1)}).fix({"shank": 1.2}).constraints == legs.constraints


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda s: s.with_constraints(LinearConstraint({"tail": 1}, high=1)), "tail"),
        (lambda s: s.with_constraints(LinearConstraint({"foot": 1}, high=1)), "foot.*categorical"),
        (lambda s: s.with_constraints(LinearConstraint({"gain": 1}, high=1)), "gain.*log"),
        (lambda s: LinearConstraint({"a": 0}, high=1), "a.*0"),
        (lambda s: LinearConstraint({"a": "1"}, high=1), "a.*'1'"),
        (lambda s: LinearConstraint({}, high=1), "other than 0, got {}"),
        (lambda s: LinearConstraint({"a": 1}), "low is None, high is None"),
        (lambda s: LinearConstraint({"a": 1}, low="1"), "low is '1'"),
        (lambda s: LinearConstraint({"a": 1}, low=2, high=1), "low <= high"),
        (lambda s: LinearConstraint({"a": 1}, high=float("inf")), "finite"),
        (lambda s: s.with_constraints(LinearConstraint({"a": 1, "n": 1}, high=1.5)), r"nominal design breaks.*a \+ n"),
        (lambda s: s.with_constraints(LinearConstraint({"a": 1, "n": 1}, high=2)).fix({"n": 2}), "with_nominal"),
        (lambda s: s.with_constraints(LinearConstraint({"a": 1, "n": 1}, low=4.5)), r"no design.*4.5 <= a \+ n"),
        (lambda s: s.with_constraints(LinearConstraint({"n": 2}, low=3, high=3)), "no design.*2.0.n == 3.0"),
        (
            lambda s: s.with_constraints(
                LinearConstraint({"a": 1, "n": 1}, low=3.5), LinearConstraint({"n": 1}, high=2)
            ),
            r"no design.*n <= 2.0 together with 3.5 <= a \+ n",
        ),
    ],
)
def test_bad_constraints_are_refused_by_name(make, word):
    space = BoxSpace(
        (
            Continuous("a", 0.0, 1.0, 0.8),
            Integer("n", 1, 3, 1),
            Continuous("gain", 0.1, 1.0, 0.5, log=True),
            Categorical("foot", ("ball", "flat"), "ball"),
        )
    )
    with pytest.raises(ValueError, match=word):
        make(space)


def test_a_fixed_value_on_a_log_scale_may_take_part():
    space = BoxSpace((Continuous("gain", 0.1, 1.0, 0.5, log=True), Continuous("a", 0.0, 1.0, 0.2)))
    held = space.fix({"gain": 0.5}).with_constraints(LinearConstraint({"a": 1, "gain": 1}, high=1))
    assert held.satisfied(np.array([[0.5, 0.5], [0.5, 0.6]])).tolist() == [True, False]


# --- verdicts against exact arithmetic ------------------------------------------------------------------

small = st.integers(-3, 3)
limits = st.tuples(st.integers(-8, 8), st.integers(-8, 8)).map(sorted)


@st.composite
def constraints(draw, names):
    weights = draw(st.lists(small, min_size=len(names), max_size=len(names)).filter(any))
    low, high = draw(limits)
    low, high = draw(st.sampled_from([(low, high), (None, high), (low, None)]))
    return LinearConstraint({n: w for n, w in zip(names, weights, strict=True) if w}, low, high)


def holds(constraint, design):
    total = sum(Fraction(c) * Fraction(design[n]) for n, c in constraint.coefficients.items())
    low, high = constraint.bounds
    return low <= total <= high


def verdict(make):
    """Return which of the three verdicts a constructor gives."""
    try:
        make()
    except ValueError as error:
        return "impossible" if "no design" in str(error) else "nominal" if "nominal design" in str(error) else "other"
    return "fine"


def corners(box, halves):
    """Return the exact corners of a polygon: where two of its border lines cross within it.

    `halves` holds (weights, low, high) of sums of both coordinates. A bounded polygon has corners unless it is empty.
    """
    halves = [((1, 0), *box[0]), ((0, 1), *box[1]), *halves]
    lines = [(w, Fraction(b)) for w, *bounds in halves for b in bounds if np.isfinite(float(b))]
    found = set()
    for (p, a), (q, b) in itertools.combinations(lines, 2):
        determinant = p[0] * q[1] - p[1] * q[0]
        if determinant:
            x, y = (a * q[1] - b * p[1]) / determinant, (p[0] * b - q[0] * a) / determinant
            if all(low <= w[0] * x + w[1] * y <= high for w, low, high in halves):
                found.add((float(x), float(y)))
    return sorted(found)


def half(constraint, names, **held):
    """Return a constraint as (weights of names, low, high), with other parameters held."""
    shift = sum(int(constraint.coefficients.get(n, 0)) * v for n, v in held.items())
    low, high = (int(b) - shift if np.isfinite(b) else b for b in constraint.bounds)
    return [int(constraint.coefficients.get(n, 0)) for n in names], low, high


def boxes(n):
    one = st.tuples(small, st.integers(1, 4)).map(lambda row: (row[0], row[0] + row[1]))
    return st.lists(one, min_size=n, max_size=n)


@FEW
@given(st.data(), st.integers(1, 3))
def test_integer_verdicts_and_choices_agree_with_enumeration(data, n):
    names = [f"n{i}" for i in range(n)]
    box = data.draw(boxes(n))
    chosen = data.draw(st.lists(constraints(names), min_size=1, max_size=3))
    nominal = [data.draw(st.integers(*bounds)) for bounds in box]
    space = BoxSpace(tuple(Integer(m, *b, v) for m, b, v in zip(names, box, nominal, strict=True)))
    every = [dict(zip(names, v, strict=True)) for v in itertools.product(*(range(a, b + 1) for a, b in box))]
    allowed = [d for d in every if all(holds(c, d) for c in chosen)]
    expected = "fine" if space.nominal in allowed else "nominal" if allowed else "impossible"
    assert verdict(lambda: space.with_constraints(*chosen)) == expected
    if allowed:
        tied = space.with_nominal(data.draw(st.sampled_from(allowed))).with_constraints(*chosen)
        np.testing.assert_array_equal(tied.satisfied(tied.designs(every)), [d in allowed for d in every])
        points = tied.discrete_choices(1000)
        assert sorted(tied.from_unit(points).tolist()) == sorted(tied.designs(allowed).tolist())
        sampled = tied.from_unit(sobol_points(tied, 300, seed=2))
        assert {tuple(row) for row in sampled} <= {tuple(row) for row in tied.designs(allowed)}


@FEW
@given(st.data())
def test_continuous_verdicts_agree_with_the_exact_corners_and_points_lie_within(data):
    names = ["x", "y"]
    box = data.draw(boxes(2))
    chosen = data.draw(st.lists(constraints(names), min_size=1, max_size=3))
    nominal = [float(data.draw(st.integers(*bounds))) for bounds in box]
    space = BoxSpace.box(names, *zip(*box, strict=True), nominal)
    vertices = corners(box, [half(c, names) for c in chosen])
    good = all(holds(c, space.nominal) for c in chosen)
    expected = "fine" if good else "nominal" if vertices else "impossible"
    assert verdict(lambda: space.with_constraints(*chosen)) == expected
    if vertices:
        middle = dict(zip(names, np.mean(vertices, axis=0).tolist(), strict=True))
        tied = space.with_nominal(middle).with_constraints(*chosen)
        designs = tied.from_unit(sobol_points(tied, 40, seed=1))
        for c in chosen:
            sums = designs @ half(c, names)[0]
            assert ((sums >= c.bounds[0] - 1e-6) & (sums <= c.bounds[1] + 1e-6)).all()
        assert (np.ptp(designs, axis=0) >= 0.3 * np.ptp(vertices, axis=0)).all()  # not all in one corner


MIXED = BoxSpace(
    (
        Continuous("x", -1.0, 2.0, 0.5),
        Integer("n", -2, 2, 0),
        Continuous("y", 0.0, 3.0, 1.0),
        Integer("m", 1, 3, 2),
        Categorical("foot", ("ball", "flat"), "ball"),
    )
)


@FEW
@given(st.data())
def test_inequalities_feasibility_and_choices_of_mixed_spaces_agree_with_plain_sums(data):
    chosen = data.draw(st.lists(constraints(["x", "n", "y", "m"]), min_size=1, max_size=2))
    assume(all(holds(c, MIXED.nominal) for c in chosen))
    space = MIXED.with_constraints(*chosen)
    held = data.draw(st.sampled_from([(), ("x",), ("n",), ("y", "m"), ("foot",)]))
    space = space.fix({n: v for n, v in space.nominal.items() if n in held})

    points = np.random.default_rng(data.draw(st.integers(0, 99))).uniform(size=(50, space.dim))
    matrix, bound = space.unit_inequalities()
    by_rows = (space.snap(points) @ matrix.T - bound).min(axis=1, initial=np.inf)
    designs = [space.params(row) for row in space.from_unit(points)]
    sums = np.array([[sum(w * d[n] for n, w in c.coefficients.items()) for c in chosen] for d in designs])
    low, high = np.array([c.bounds for c in chosen]).T
    gaps = np.concatenate([sums - low, high - sums], axis=1).min(axis=1)
    clear = np.abs(gaps) > 1e-6
    np.testing.assert_array_equal((by_rows >= 0)[clear], (gaps > 0)[clear])
    np.testing.assert_array_equal(is_feasible(space, points, None)[clear], (gaps > 0)[clear])

    if not held:  # integers are possible together when the exact polygon left for x and y is not empty
        found = space.from_unit(np.nan_to_num(space.discrete_choices(30)))[:, [1, 3]]
        every = itertools.product(range(-2, 3), range(1, 4))
        box = [(-1, 2), (0, 3)]
        possible = [(n, m) for n, m in every if corners(box, [half(c, ["x", "y"], n=n, m=m) for c in chosen])]
        assert sorted(map(tuple, found.tolist())) == sorted(possible * 2)  # with either foot


# --- points over thin sets ------------------------------------------------------------------------------


@pytest.mark.parametrize(("dim", "sum_at_most"), [(2, 0.02), (8, 1.0)])
def test_points_are_uniform_over_a_small_simplex(dim, sum_at_most):
    names = [f"x{i}" for i in range(dim)]
    space = BoxSpace.box(names, 0.0, 1.0, 0.0)
    space = space.with_constraints(LinearConstraint(dict.fromkeys(names, 1), high=sum_at_most))
    points = sobol_points(space, 1024, seed=0)
    assert space.satisfied(points).all()
    # A uniform point of a simplex is Dirichlet: its coordinates are beta variates, and so is their sum.
    for column in points.T:
        assert stats.kstest(column / sum_at_most, stats.beta(1, dim).cdf).pvalue > 1e-3
    assert stats.kstest(points.sum(axis=1) / sum_at_most, stats.beta(dim, 1).cdf).pvalue > 1e-3


def test_points_are_uniform_within_a_thin_slab_and_a_net_beside_it():
    space = BoxSpace.box(["front", "hind", "other"], 0.6, 1.4, 1.0)
    space = space.with_constraints(LinearConstraint({"front": 1, "hind": -1}, low=-1e-6, high=1e-6))
    front, hind, other = space.from_unit(sobol_points(space, 1024, seed=0)).T
    assert np.abs(front - hind).max() <= 1.001e-6
    assert stats.kstest((front - 0.6) / 0.8, "uniform").pvalue > 1e-3
    assert stats.kstest((front - hind + 1e-6) / 2e-6, "uniform").pvalue > 1e-3
    assert (np.histogram(other, bins=1024, range=(0.6, 1.4))[0] == 1).all()


def test_equalities_hold_and_leave_a_plane_to_search():
    space = BoxSpace.box(["a", "b", "c"], 0.0, 1.0, 0.5)
    space = space.with_constraints(LinearConstraint({"a": 1, "b": 1, "c": 1}, low=1.5, high=1.5))
    points = sobol_points(space, 512, seed=0)
    np.testing.assert_allclose(points.sum(axis=1), 1.5, atol=1e-8)
    # The plane cuts the cube in a regular hexagon: it is centred, and alike in all six directions.
    np.testing.assert_allclose(points.mean(axis=0), 0.5, atol=0.05)
    counts = np.unique(np.argsort(points, axis=1), axis=0, return_counts=True)[1]
    assert len(counts) == 6
    assert stats.chisquare(counts).pvalue > 1e-3


def test_a_single_possible_design_is_found():
    space = BoxSpace.box(["a", "b"], 0.0, 1.0, 1.0).with_constraints(LinearConstraint({"a": 1, "b": 1}, low=2))
    np.testing.assert_allclose(sobol_points(space, 3, seed=0), 1.0, atol=1e-8)


def test_thin_sets_of_integers_tied_to_continuous_parameters():
    space = BoxSpace(
        (
            Integer("n", 1, 6, 2),
            Integer("m", 1, 6, 2),
            Integer("k", 1, 6, 2),
            Continuous("x", 0.0, 1.0, 0.2),
            Categorical("foot", ("ball", "flat"), "ball"),
        ),
        (
            LinearConstraint({"n": 1, "m": 1, "k": 1}, low=6, high=6),
            LinearConstraint({"x": 1, "n": -0.1}, low=-0.001, high=0.001),
        ),
    )
    designs = sobol_designs(space, 256, seed=1)
    for d in designs:
        assert d["n"] + d["m"] + d["k"] == 6
        assert abs(d["x"] - 0.1 * d["n"]) <= 0.001 + 1e-8
    every = {v for v in itertools.product(range(1, 7), repeat=3) if sum(v) == 6}
    assert {(d["n"], d["m"], d["k"]) for d in designs} == every
    assert sum(d["foot"] == "ball" for d in designs) == 128


@pytest.mark.parametrize("high", [1.5, 0.02])
def test_the_sequence_depends_on_the_seed_alone(high):
    space = BoxSpace.box(["a", "b", "c"], 0.0, 1.0, 0.0)
    space = space.with_constraints(LinearConstraint({"a": 1, "b": 1}, high=high))
    points = sobol_points(space, 300, seed=3)
    np.testing.assert_array_equal(sobol_points(space, 10, seed=3, skip=290), points[290:])
    np.testing.assert_array_equal(sobol_points(space, 1, seed=3), points[:1])
    assert not np.isin(sobol_points(space, 300, seed=4), points).any()


def test_a_predicate_joins_the_constraints_and_sees_only_what_they_leave():
    space = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.0)
    for high in (1.0, 0.02):
        tied = space.with_constraints(LinearConstraint({"a": 1, "b": 1}, high=high))

        def steep(designs, high=high):
            assert (designs.sum(axis=1) <= high + 1e-6).all()
            return designs[:, 1] > designs[:, 0]

        points = sobol_points(tied, 100, 0, steep)
        assert len(points) == 100
        assert (points[:, 1] > points[:, 0]).all()
        corner = np.array([[0.9, 0.9], [0.0, 0.01]])
        assert is_feasible(tied, corner, steep).tolist() == [False, True]
        assert is_feasible(tied, corner[:1], steep).tolist() == [False]


def test_a_predicate_against_the_constraints_is_named(space):
    legs = space.with_constraints(LEG)
    with pytest.raises(StudyError, match="predicate"):
        sobol_points(legs, 1, 0, lambda designs: designs.sum(axis=1) > 2.5)
