"""Integer, categorical and log parameters: values, the unit cube, features, files."""

import itertools
import json
import math
import pickle
import struct

import numpy as np
import pytest
from codesign_bo import BoxSpace
from codesign_bo.space import Categorical, Continuous, Integer, LinearConstraint, sobol_points
from hypothesis import assume, given
from hypothesis import strategies as st

FOOT = Categorical("foot", ("ball", "flat", "hoof"), "flat")


@pytest.fixture
def mixed() -> BoxSpace:
    return BoxSpace(
        (
            Continuous("thigh", 0.6, 1.4, 1.0),
            Continuous("stiffness", 1.0, 1000.0, 10.0, log=True),
            Integer("teeth", 8, 11, 9),
            FOOT,
            Categorical("damped", (False, True), True),
        )
    )


# --- hand-computed --------------------------------------------------------------------------------------


def test_every_kind_maps_by_hand(mixed):
    points = np.array([[0.0, 0.0, 0.0, 0.0, 0.0], [0.25, 0.5, 0.25, 0.34, 0.5], [1.0, 1.0, 1.0, 1.0, 1.0]])
    low, middle, high = [mixed.params(row) for row in mixed.from_unit(points)]
    assert low == {"thigh": 0.6, "stiffness": 1.0, "teeth": 8, "foot": "ball", "damped": False}
    assert middle["thigh"] == pytest.approx(0.8)
    assert middle["stiffness"] == pytest.approx(math.sqrt(1000.0))  # the geometric mean
    assert (middle["teeth"], middle["foot"], middle["damped"]) == (9, "flat", True)
    assert high["stiffness"] == pytest.approx(1000.0)
    assert (high["thigh"], high["teeth"], high["foot"], high["damped"]) == (1.4, 11, "hoof", True)
    assert {n: type(v) for n, v in middle.items()} == {
        "thigh": float, "stiffness": float, "teeth": int, "foot": str, "damped": bool,
    }  # fmt: skip


def test_discrete_values_stand_in_arrays_as_value_and_index_and_in_the_cube_as_middles(mixed):
    designs = mixed.designs([mixed.nominal])
    np.testing.assert_array_equal(designs, [[1.0, 10.0, 9.0, 1.0, 1.0]])
    np.testing.assert_allclose(mixed.to_unit(designs), [[0.5, 1 / 3, 3 / 8, 1 / 2, 3 / 4]])


def test_bins_are_equally_wide():
    space = BoxSpace((Integer("teeth", -1, 2, 0), FOOT))
    grid = (np.arange(1200) + 0.5) / 1200
    designs = space.from_unit(np.column_stack([grid, grid]))
    assert np.unique(designs[:, 0], return_counts=True)[1].tolist() == [300] * 4
    assert np.unique(designs[:, 1], return_counts=True)[1].tolist() == [400] * 3


def test_choices_are_as_far_apart_as_the_ends_of_a_continuous_parameter(mixed):
    def features(**changes):
        return mixed.features(mixed.to_unit(mixed.designs([{**mixed.nominal, **changes}])))[0]

    ends = np.linalg.norm(features(thigh=0.6) - features(thigh=1.4))
    assert ends == pytest.approx(1.0)
    for one, other in itertools.combinations(FOOT.choices, 2):
        assert np.linalg.norm(features(foot=one) - features(foot=other)) == pytest.approx(ends)
    assert np.linalg.norm(features(damped=True) - features(damped=False)) == pytest.approx(ends)
    assert np.linalg.norm(features(teeth=9) - features(teeth=11)) == pytest.approx(2 / 4)
    assert features().shape == (mixed.feature_dim,) == (1 + 1 + 1 + 3 + 2,)
    changed = np.flatnonzero(features(foot="hoof") != features())
    assert mixed.feature_slices[3] == slice(3, 6)
    assert set(changed) == {4, 5}


def test_features_of_a_continuous_space_are_its_points(space):
    points = np.random.default_rng(0).uniform(size=(20, 2))
    np.testing.assert_array_equal(space.features(points), points)
    np.testing.assert_array_equal(space.snap(points), points)


def test_all_combinations_of_discrete_choices(mixed):
    points = mixed.discrete_choices(24)
    assert points is not None
    assert np.isnan(points[:, :2]).all()
    whole = mixed.fix({"thigh": 1.0, "stiffness": 10.0})
    found = {tuple(whole.params(row).values())[2:] for row in whole.from_unit(points[:, 2:])}
    assert found == set(itertools.product(range(8, 12), FOOT.choices, (False, True)))
    assert len(points) == 24
    assert mixed.discrete_choices(23) is None
    assert np.isnan(mixed.features(points)).sum() == 2 * 24  # continuous ones stay open


def test_a_continuous_space_has_one_combination_and_a_huge_integer_is_not_enumerated(space):
    np.testing.assert_array_equal(space.discrete_choices(1), [[np.nan, np.nan]])
    assert BoxSpace((Integer("seed", 0, 2**40, 0),)).discrete_choices(10_000) is None


def test_sobol_points_spread_over_discrete_values_evenly(mixed):
    points = sobol_points(mixed, 64, seed=5)
    designs = mixed.from_unit(points)
    assert np.unique(designs[:, 2], return_counts=True)[1].tolist() == [16] * 4  # a net in each dimension
    assert np.unique(designs[:, 4], return_counts=True)[1].tolist() == [32] * 2
    assert np.unique(designs[:, 3], return_counts=True)[1].min() >= 21
    np.testing.assert_array_equal(points[:, 2:], mixed.to_unit(designs)[:, 2:])  # middles of bins


# --- properties -----------------------------------------------------------------------------------------

numbers = st.floats(-1e3, 1e3)
choices = st.lists(
    st.one_of(st.text(max_size=3), st.booleans(), st.integers(-5, 5), numbers), min_size=2, max_size=5, unique=True
)


@st.composite
def parameters(draw, name):
    kind = draw(st.sampled_from(["continuous", "log", "integer", "categorical"]))
    fixed = draw(st.booleans())
    if kind == "integer":
        low = draw(st.integers(-1000, 1000))
        high = low + draw(st.integers(1, 50))
        return Integer(name, low, high, draw(st.integers(low, high)), fixed)
    if kind == "categorical":
        options = draw(choices)
        return Categorical(name, options, draw(st.sampled_from(options)), fixed)
    low = draw(st.floats(1e-3, 1e3)) if kind == "log" else draw(numbers)
    high = low + draw(st.floats(1e-2, 1e3))
    return Continuous(name, low, high, min(low + draw(st.floats(0, 1)) * (high - low), high), fixed, kind == "log")


@st.composite
def spaces(draw):
    made = tuple(draw(parameters(f"p{i}")) for i in range(draw(st.integers(1, 5))))
    assume(not all(p.fixed for p in made))
    return BoxSpace(made)


def cube(space, seed):
    points = np.random.default_rng(seed).uniform(size=(8, space.dim))
    points[0], points[1] = 0.0, 1.0
    return points


def bits(value):
    return struct.pack("<d", value) if isinstance(value, float) else (type(value), value)


@given(spaces(), st.integers(0, 1000))
def test_every_point_of_the_cube_is_a_valid_design_with_fixed_values_to_the_bit(space, seed):
    for row in space.from_unit(cube(space, seed)):
        params = space.params(row)
        assert list(params) == list(space.names)
        checked = space.check(params)
        for p in space.parameters:
            assert bits(checked[p.name]) == bits(params[p.name])
            if p.fixed:
                assert bits(params[p.name]) == bits(p.nominal)
            if isinstance(p, Categorical):
                assert any(params[p.name] is choice or params[p.name] == choice for choice in p.choices)
            else:
                assert p.low <= params[p.name] <= p.high
                assert type(params[p.name]) is (int if isinstance(p, Integer) else float)


@given(spaces(), st.integers(0, 1000))
def test_maps_are_inverse_and_snapping_changes_no_design(space, seed):
    points = cube(space, seed)
    designs, snapped = space.from_unit(points), space.snap(points)
    np.testing.assert_array_equal(space.snap(snapped), snapped)
    np.testing.assert_array_equal(space.from_unit(snapped), designs)
    np.testing.assert_allclose(space.to_unit(designs), snapped, atol=1e-8)
    discrete = [not isinstance(p, Continuous) for p in space.free]
    np.testing.assert_array_equal(space.to_unit(designs)[:, discrete], snapped[:, discrete])
    params = [space.params(row) for row in designs]
    np.testing.assert_array_equal(space.designs(params), designs)


@given(spaces(), st.integers(0, 1000))
def test_features_are_equal_exactly_where_designs_are(space, seed):
    rng = np.random.default_rng(seed)
    # Points on a coarse grid, moved within bins: some pairs are the same design, others are not.
    points = rng.integers(0, 3, size=(12, space.dim)) / 2
    moved = points.copy()
    for column, p in enumerate(space.free):
        if not isinstance(p, Continuous):
            moved[:, column] = np.clip(points[:, column] + rng.uniform(-0.3, 0.3, 12) / p.count, 0.0, 1.0)
    both = np.concatenate([points, moved])
    designs, features = space.from_unit(both), space.features(both)
    assert features.shape == (24, space.feature_dim)
    assert [s.stop - s.start for s in space.feature_slices] == [p.feature_dim for p in space.free]
    same_design = (designs[:, None] == designs[None]).all(axis=-1)
    same_features = (features[:, None] == features[None]).all(axis=-1)
    np.testing.assert_array_equal(same_design, same_features)


@given(spaces())
def test_files_and_pickles_give_the_same_space_back(space):
    text = json.dumps(space.signature(), allow_nan=False)
    again = BoxSpace.from_signature(json.loads(text))
    assert again == space == pickle.loads(pickle.dumps(space))
    assert hash(again) == hash(space)
    assert json.loads(text) == space.signature()  # what a file is compared with
    for p, q in zip(space.parameters, again.parameters, strict=True):
        assert bits(p.nominal) == bits(q.nominal)
        if isinstance(p, Categorical) and isinstance(q, Categorical):
            assert list(map(bits, p.choices)) == list(map(bits, q.choices))


@given(spaces(), st.data())
def test_fixing_and_renewed_bounds_keep_names_and_order(space, data):
    assume(space.dim > 1)
    name = data.draw(st.sampled_from(space.free_names))
    value = space.params(space.from_unit(np.full((1, space.dim), 0.3))[0])[name]
    held = space.fix({name: value})
    assert held.names == space.names
    assert set(held.free_names) == set(space.free_names) - {name}
    assert all(bits(held.params(row)[name]) == bits(value) for row in held.from_unit(cube(held, 1)))
    bounds = {p.name: (p.low, p.high) for p in space.parameters if not isinstance(p, Categorical)}
    assert space.with_bounds(bounds) == space


# --- files ----------------------------------------------------------------------------------------------

OLD = [
    {"name": "thigh", "low": 0.6, "high": 1.4, "nominal": 1.0, "fixed": True},
    {"name": "shank", "low": 0.5, "high": 1.5, "nominal": 1.0, "fixed": False},
]


def test_signatures_of_the_first_version_are_read_and_still_written(space):
    assert BoxSpace.from_signature(OLD) == space.fix({"thigh": 1.0})
    assert json.dumps(space.fix({"thigh": 1.0}).signature()) == json.dumps(OLD)


def test_signature_of_other_kinds(mixed):
    space = mixed.with_constraints(LinearConstraint({"teeth": 0.5, "thigh": -1}, high=4))
    assert space.signature()[1:] == [
        {"name": "stiffness", "low": 1.0, "high": 1000.0, "nominal": 10.0, "fixed": False, "log": True},
        {"name": "teeth", "kind": "integer", "low": 8, "high": 11, "nominal": 9, "fixed": False},
        {"name": "foot", "kind": "categorical", "choices": ["ball", "flat", "hoof"], "nominal": "flat", "fixed": False},
        {"name": "damped", "kind": "categorical", "choices": [False, True], "nominal": True, "fixed": False},
        {
            "name": "-thigh + 0.5*teeth <= 4.0",
            "kind": "linear",
            "coefficients": {"thigh": -1.0, "teeth": 0.5},
            "low": None,
            "high": 4.0,
        },
    ]


@pytest.mark.parametrize(
    ("entry", "word"),
    [
        ({"name": "gear", "kind": "ordinal", "low": 0, "high": 1, "nominal": 0}, "ordinal"),
        ({"name": "gear", "low": 0.0, "high": 1.0}, "gear"),
        ({"name": "gear", "low": 0.0, "high": 1.0, "nominal": 0.5, "unit": "m"}, "unit"),
    ],
)
def test_what_a_signature_must_not_hold(entry, word):
    with pytest.raises(ValueError, match=word):
        BoxSpace.from_signature([entry])


# --- values ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"teeth": True}, ["teeth", "True", r"\[8, 11\]"]),
        ({"teeth": 9.5}, ["teeth", "9.5", "integer"]),
        ({"teeth": 12}, ["teeth", "12", r"\[8, 11\]"]),
        ({"teeth": "9"}, ["teeth", "'9'", "integer"]),
        ({"foot": "paw"}, ["foot", "'paw'", "ball"]),
        ({"foot": 1}, ["foot", "1", "ball"]),
        ({"damped": 1}, ["damped", "1", "True"]),
        ({"damped": "True"}, ["damped", "'True'", "False"]),
        ({"thigh": True}, ["thigh", "True", "number"]),
        ({"thigh": "1.0"}, ["thigh", "'1.0'", "number"]),
        ({"thigh": math.nan}, ["thigh", "nan", "0.6"]),
        ({"thigh": 1.5}, ["thigh", "1.5", "1.4"]),
        ({"tail": 1.0}, ["tail", "thigh"]),
    ],
)
def test_wrong_values_are_refused_by_name_value_and_what_is_allowed(mixed, change, words):
    for word in words:
        with pytest.raises(ValueError, match=word):
            mixed.check({**mixed.nominal, **change})


def test_scalars_of_numpy_and_whole_floats_become_plain_values_in_the_spaces_order(mixed):
    given_values = {
        "damped": np.True_,
        "foot": np.str_("hoof"),
        "teeth": np.int64(10),
        "stiffness": 10,
        "thigh": np.float32(1.0),
    }
    checked = mixed.check(given_values)
    assert json.dumps(checked) == '{"thigh": 1.0, "stiffness": 10.0, "teeth": 10, "foot": "hoof", "damped": true}'
    assert type(mixed.check({**given_values, "teeth": 10.0})["teeth"]) is int


def test_numeric_choices_come_back_as_they_were_given():
    space = BoxSpace((Categorical("batch", (1, 2.5, "auto"), 1),))
    assert [type(space.check({"batch": v})["batch"]) for v in (1.0, 2.5, "auto")] == [int, float, str]
    with pytest.raises(ValueError, match="batch"):
        space.check({"batch": True})


def test_a_fixed_zero_keeps_its_sign():
    space = BoxSpace((Continuous("a", -1.0, 1.0, -0.0, fixed=True), Continuous("b", 0.0, 1.0, 0.5)))
    assert math.copysign(1.0, float(space.check({"a": 0.0, "b": 0.5})["a"])) == -1.0
    assert math.copysign(1.0, space.from_unit(np.array([[0.5]]))[0, 0]) == -1.0


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Integer("teeth", 1, 2.5, 2), "teeth.*high"),
        (lambda: Integer("teeth", True, 3, 2), "teeth.*low"),
        (lambda: Integer("teeth", 3, 3, 3), "teeth.*fix"),
        (lambda: Integer("teeth", 1, 3, 4), "teeth.*4"),
        (lambda: Integer("teeth", 0, 2**60, 0), "teeth.*2\\*\\*48"),
        (lambda: Categorical("foot", ("ball",), "ball"), "foot.*2"),
        (lambda: Categorical("foot", (), "ball"), "foot.*2"),
        (lambda: Categorical("foot", ("ball", "ball"), "ball"), "foot.*different"),
        (lambda: Categorical("foot", (True, 1), 1), "foot.*different"),
        (lambda: Categorical("foot", ("ball", math.nan), "ball"), "foot.*finite"),
        (lambda: Categorical("foot", ("ball", None), "ball"), "foot.*None"),
        (lambda: Categorical("foot", "ball", "b"), "foot.*list"),
        (lambda: Categorical("foot", ("ball", "flat"), "paw"), "foot.*paw"),
        (lambda: Continuous("gain", 0.0, 1.0, 0.5, log=True), "gain.*log"),
        (lambda: Continuous("gain", "0", 1.0, 0.5), "gain.*low"),
        (lambda: Continuous("gain", -1e308, 1e308, 0.5), "gain.*finite"),
        (lambda: BoxSpace((FOOT, Integer("teeth", 1, 3, 2))).with_bounds({"foot": (0, 1)}), "foot.*choices"),
        (lambda: BoxSpace((FOOT, Integer("teeth", 1, 3, 2))).with_bounds({"teeth": (1, 2.5)}), "teeth"),
        (lambda: BoxSpace((FOOT, Integer("teeth", 1, 3, 2))).fix({"foot": "paw"}), "foot.*paw"),
        (lambda: BoxSpace((FOOT, Integer("teeth", 1, 3, 2))).with_nominal({"teeth": 9}), "teeth.*9"),
        (lambda: BoxSpace((FOOT,)).params(np.array([3.0])), "foot.*3"),
    ],
)
def test_bad_parameters_are_refused_by_name(make, word):
    with pytest.raises(ValueError, match=word):
        make()


def test_another_nominal_design(mixed):
    assert mixed.with_nominal({"teeth": 11, "foot": "ball"}).nominal == {
        **mixed.nominal, "teeth": 11, "foot": "ball",
    }  # fmt: skip
