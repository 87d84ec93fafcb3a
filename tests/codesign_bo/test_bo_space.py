import numpy as np
import pytest
from codesign_bo import BoxSpace, Parameter, StudyError, sobol_designs
from codesign_bo.space import sobol_points
from hypothesis import given
from hypothesis import strategies as st


def test_bounds_override_and_fixing_give_the_papers_hardware_space():
    names = ["front_thigh", "front_shank", "hind_thigh", "hind_shank"]
    space = BoxSpace.box(names, 0.6, 1.4, 1.0)
    space = space.with_bounds({"front_shank": (1.0, 1.4), "hind_shank": (1.0, 1.4)})
    space = space.fix({"front_thigh": 1.0, "hind_thigh": 1.0})
    assert space.free_names == ("front_shank", "hind_shank")
    np.testing.assert_array_equal(space.from_unit(np.array([[0.0, 1.0]])), [[1.0, 1.0, 1.0, 1.4]])


@given(
    st.lists(
        st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.floats(0, 1), st.booleans()),
        min_size=1,
        max_size=5,
    ).filter(lambda rows: not all(fixed for *_, fixed in rows)),
    st.integers(0, 1000),
)
def test_unit_cube_mapping_keeps_bounds_and_fixed_values_exactly(rows, seed):
    space = BoxSpace(
        tuple(
            Parameter(f"p{i}", low, low + span, min(low + at * span, low + span), fixed)
            for i, (low, span, at, fixed) in enumerate(rows)
        )
    )
    unit = np.random.default_rng(seed).uniform(size=(6, space.dim))
    unit[0], unit[1] = 0.0, 1.0
    designs = space.from_unit(unit)
    for row in designs:
        space.check(space.params(row))  # within bounds, and fixed values bit for bit
    np.testing.assert_allclose(space.to_unit(designs), unit, atol=1e-9)
    assert BoxSpace.from_signature(space.signature()) == space


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda s: s.with_bounds({"tail": (0, 1)}), "tail"),
        (lambda s: s.with_bounds({"thigh": (1.4, 0.6)}), "thigh"),
        (lambda s: s.with_bounds({"thigh": (1.1, 1.4)}), "thigh"),
        (lambda s: s.fix({"shank": 9.0}), "shank"),
        (lambda s: s.fix({"thigh": 1.0, "shank": 1.0}), "no free parameter"),
        (lambda s: s.fix({"shank": float("nan")}), "finite"),
        (lambda s: BoxSpace(s.parameters * 2), "unique"),
        (lambda s: s.check({"thigh": 1.0}), "shank"),
        (lambda s: s.check({"thigh": 1.0, "shank": 5.0}), "shank"),
        (lambda s: s.fix({"thigh": 1.0}).check({"thigh": 1.1, "shank": 1.0}), "fixed"),
    ],
)
def test_bad_spaces_and_designs_are_refused_by_name(space, change, word):
    with pytest.raises(ValueError, match=word):
        change(space)


def test_sobol_points_spread_better_than_chance_and_repeat(space):
    points = sobol_points(space, 64, seed=3)
    counts = np.histogram2d(*points.T, bins=8, range=[[0, 1], [0, 1]])[0]
    assert (counts == 1).all()  # a (0, 6, 2)-net in base 2
    np.testing.assert_array_equal(sobol_points(space, 60, seed=3, skip=4), points[4:])
    assert not np.allclose(sobol_points(space, 64, seed=4), points)


def test_screening_designs_honour_the_predicate(space):
    def long_enough(designs):
        return designs.sum(axis=1) > 2.4

    designs = sobol_designs(space, 50, 0, long_enough)
    assert len(designs) == 50
    assert all(d["thigh"] + d["shank"] > 2.4 for d in designs)


def test_a_predicate_that_accepts_nothing_or_returns_rubbish_is_named(space):
    with pytest.raises(StudyError, match="feasib"):
        sobol_points(space, 1, 0, lambda designs: np.zeros(len(designs), bool))
    with pytest.raises(ValueError, match="bool"):
        sobol_points(space, 1, 0, lambda designs: np.zeros(len(designs)))
