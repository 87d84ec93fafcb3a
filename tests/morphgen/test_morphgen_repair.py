"""Which inertias are refused and what they become, judged by MuJoCo and by scipy."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import robot_defects as defects
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from morphgen import MorphologyError
from morphgen.urdf.repair import check_inertia, find_defects, repair_inertia, repair_tree, with_valid_inertia
from morphgen.urdf.tree import Inertial, read_tree
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation


def compiles(inertia: np.ndarray) -> bool:
    """Whether MuJoCo takes it for a moving body."""
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    body = spec.worldbody.add_body(mass=1.0, explicitinertial=True)
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    body.add_freejoint()
    try:
        spec.compile()
    except ValueError:
        return False
    return True


def body_of(inertia: np.ndarray) -> Inertial:
    return Inertial(1.0, np.array([0.1, -0.2, 0.3]), inertia)


moments = st.floats(1e-3, 1.0)
angles = arrays(np.float64, 3, elements=st.floats(-3, 3))


def turned(principal: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    turn = Rotation.from_rotvec(rotation).as_matrix()
    inertia = turn @ np.diag(principal) @ turn.T
    return (inertia + inertia.T) / 2


@given(st.tuples(moments, moments, moments), angles)
@settings(max_examples=100, deadline=None)
def test_what_is_refused_is_what_mujoco_refuses(principal, rotation):
    a, b, c = sorted(principal)
    assume(abs(a + b - c) > 1e-6)  # rounding decides there
    inertia = turned(np.array(principal), rotation)
    assert (check_inertia(body_of(inertia)) is None) == compiles(inertia)


@given(arrays(np.float64, (3, 3), elements=st.floats(-1, 1)))
@settings(max_examples=100, deadline=None)
def test_what_is_repaired_is_what_mujoco_takes(matrix):
    inertia = (matrix + matrix.T) / 2
    assume(np.abs(inertia).max() > 1e-3)
    repaired = repair_inertia(body_of(inertia))
    assert check_inertia(repaired) is None
    assert compiles(repaired.inertia)
    assert repaired.mass == 1.0
    assert_allclose(repaired.com, (0.1, -0.2, 0.3))


@given(st.tuples(moments, moments, moments), angles)
@settings(max_examples=50, deadline=None)
def test_a_possible_inertia_is_left_as_it_is(second_moments, rotation):
    inertia = turned(np.sum(second_moments) - np.array(second_moments), rotation)
    assert_allclose(repair_inertia(body_of(inertia)).inertia, inertia, atol=1e-12)


def test_the_repaired_inertia_is_the_nearest_possible_one():
    inertia = turned(np.array([0.2, 0.3, 0.9]), np.array([0.3, -0.5, 0.8]))

    def sigma(tensor: np.ndarray) -> np.ndarray:
        return np.trace(tensor) / 2 * np.eye(3) - tensor

    def distance(entries: np.ndarray) -> float:  # any Sig = L L^T is possible
        root = np.zeros((3, 3))
        root[np.tril_indices(3)] = entries
        return float(((root @ root.T - sigma(inertia)) ** 2).sum())

    found = minimize(distance, np.full(6, 0.3), tol=1e-14).fun
    ours = ((sigma(repair_inertia(body_of(inertia)).inertia) - sigma(inertia)) ** 2).sum()
    assert ours == pytest.approx(found, rel=1e-4)


def test_a_point_mass_is_possible_and_a_negative_mass_is_not():
    assert check_inertia(Inertial(0.02, np.zeros(3), np.zeros((3, 3)))) is None
    assert check_inertia(Inertial(0.0, np.zeros(3), np.zeros((3, 3)))) is None
    assert "negative" in (check_inertia(Inertial(-0.02, np.zeros(3), np.eye(3))) or "")


def tree_of(name: str, tmp_path):
    return read_tree(defects.write(name, tmp_path).read_text(encoding="utf-8"), name)


@pytest.mark.parametrize("name", ["clean", *defects.SAME, *defects.OTHER])
def test_sound_robots_are_not_touched(tmp_path, name):
    tree = tree_of(name, tmp_path)
    assert find_defects(tree) == []
    assert with_valid_inertia(tree) == (tree, [])


def test_a_moving_point_mass_becomes_a_ball_of_the_volume_of_its_collision(tmp_path):
    tree, notes = repair_tree(tree_of("zero_shank", tmp_path))
    volume = np.pi * 0.012**2 * 0.14
    radius = (3 * volume / (4 * np.pi)) ** (1 / 3)
    shank = tree.links[tree.link("FL_shank")].inertial
    assert_allclose(shank.inertia, 2 / 5 * 0.19 * radius**2 * np.eye(3), rtol=1e-12)
    assert len(notes) == 4
    assert find_defects(tree) == []


def test_repair_changes_only_the_impossible(tmp_path):
    before = tree_of("indefinite_thigh", tmp_path)
    after, notes = repair_tree(before)
    assert len(notes) == 1
    for old, new in zip(before.links, after.links, strict=True):
        same = np.array_equal(old.inertial.inertia, new.inertial.inertia)
        assert same == (old.name != "FL_thigh")
        assert (old.inertial.mass, *old.inertial.com) == (new.inertial.mass, *new.inertial.com)


def test_a_rotated_inertial_is_repaired_in_place(tmp_path):
    text = defects.write("invalid_sensor", tmp_path).read_text()
    assert text.count('rpy="0 0 0"/><mass value="0.06"/>') == 1
    turned_text = text.replace('rpy="0 0 0"/><mass value="0.06"/>', 'rpy="0.4 -0.3 1.1"/><mass value="0.06"/>')
    plain, rotated = (repair_tree(read_tree(t))[0] for t in (text, turned_text))
    tensors = [tree.links[tree.link("camera")].inertial.inertia for tree in (plain, rotated)]
    turn = Rotation.from_euler("xyz", (0.4, -0.3, 1.1)).as_matrix()  # fixed axes, as in URDF
    assert_allclose(tensors[1], turn @ tensors[0] @ turn.T, rtol=1e-9)


def test_placeholders_need_no_permission(tmp_path):
    text = defects.write("dummy_root", tmp_path).read_text()
    fake = " ".join(f'{key}="1e-6"' for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    inertial = f'<inertial><mass value="1e-6"/><inertia {fake}/></inertial>'
    tree, notes = with_valid_inertia(
        read_tree(text.replace('<link name="base"/>', f'<link name="base">{inertial}</link>'))
    )
    assert [note.split(":")[0] for note in notes] == ["link 'base'"]
    assert_allclose(tree.links[tree.link("base")].inertial.inertia, 1e-6 * np.eye(3))


def test_an_inertia_of_next_to_nothing_is_none(tmp_path):
    text = defects.write("dummy_root", tmp_path).read_text()
    tiny = '<inertial><mass value="0.1"/><inertia ixx="1e-27" iyy="1e-27" izz="1e-27"/></inertial>'
    text = text.replace('<link name="base"/>', f'<link name="base">{tiny}</link>')
    tree, notes = with_valid_inertia(read_tree(text))
    assert len(notes) == 1
    assert not tree.links[tree.link("base")].inertial.inertia.any()
    assert tree.links[tree.link("base")].inertial.mass == 0.1
    assert not compiles(1e-27 * np.eye(3))


def test_every_culprit_is_named_at_once(tmp_path):
    with pytest.raises(MorphologyError) as caught:
        with_valid_inertia(tree_of("invalid_shank", tmp_path))
    assert [f"{leg}_shank" in str(caught.value) for leg in defects.SIDES] == [True] * 4
    with pytest.raises(MorphologyError, match=r"RR_shank.*no mass"):
        repair_tree(tree_of("no_inertial", tmp_path))
