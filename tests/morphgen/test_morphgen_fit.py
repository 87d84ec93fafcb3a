import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree
from morphgen import MorphologyError
from morphgen.urdf.fit import SNAP, fit_primitive, fit_sphere, with_primitives
from morphgen.urdf.meshes import MeshFinder
from morphgen.urdf.tree import read_tree, rotation_of

ROBOT = """<robot name="r"><!-- kept -->
  <link name="leg">
    <visual><geometry><mesh filename="leg.stl"/></geometry></visual>
    <collision>
      <origin xyz="0 0 -0.1" rpy="0 0.3 0"/>
      <geometry><mesh filename="leg.stl" scale="1 -1 2"/></geometry>
    </collision>
    <collision><geometry><sphere radius="0.01"/></geometry></collision>
  </link>
  <link name="foot"><collision><geometry><mesh filename="ball.stl"/></geometry></collision></link>
  <joint name="j" type="fixed"><parent link="leg"/><child link="foot"/></joint>
</robot>"""


def surface(primitive):
    """The primitive as trimesh builds it, in the mesh's axes."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = primitive.rotation, primitive.position
    radius, length, _ = primitive.size
    if primitive.kind == "box":
        return trimesh.creation.box(primitive.size, pose)
    if primitive.kind == "cylinder":
        return trimesh.creation.cylinder(radius, length, sections=256, transform=pose)
    return trimesh.creation.icosphere(5, radius).apply_transform(pose)


def outside(primitive, points):
    """Greatest distance by which points stick out of the primitive, from its definition."""
    local = (points - primitive.position) @ primitive.rotation
    if primitive.kind == "box":
        return (np.abs(local) - primitive.size / 2).max()
    if primitive.kind == "sphere":
        return np.linalg.norm(local, axis=1).max() - primitive.size[0]
    radius, length, _ = primitive.size
    return max(np.linalg.norm(local[:, :2], axis=1).max() - radius, np.abs(local[:, 2]).max() - length / 2)


@pytest.fixture
def folder(tmp_path):
    trimesh.creation.box((0.04, 0.06, 0.2)).export(tmp_path / "leg.stl")
    trimesh.creation.icosphere(3, 0.02).apply_translation([0.01, 0, 0]).export(tmp_path / "ball.stl")
    return tmp_path


def test_a_box_is_its_own_fit():
    mesh = trimesh.creation.box((0.1, 0.2, 0.3)).apply_translation([1, 2, 3])
    fit = fit_primitive(mesh)
    assert fit.kind == "box"
    np.testing.assert_allclose(fit.size, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(fit.position, [1, 2, 3])
    np.testing.assert_array_equal(fit.rotation, np.eye(3))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_cylinder_is_its_own_fit_along_any_axis(axis):
    turn = {0: (0, np.pi / 2, 0), 1: (np.pi / 2, 0, 0), 2: (0, 0, 0)}[axis]
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(np.array(turn))
    fit = fit_primitive(trimesh.creation.cylinder(0.03, 0.2, transform=pose))
    assert fit.kind == "cylinder"
    np.testing.assert_allclose(fit.size, [0.03, 0.2, 0], rtol=1e-6)
    assert abs(fit.rotation[axis, 2]) == pytest.approx(1)


def test_an_oblique_box_is_turned_but_a_nearly_straight_one_is_not():
    def turned(angle):
        return trimesh.creation.box((0.04, 0.05, 0.3)).apply_transform(
            trimesh.transformations.rotation_matrix(angle, [0, 1, 0])
        )

    oblique = fit_primitive(turned(0.3))
    np.testing.assert_allclose(oblique.rotation, rotation_of(np.array([0, 0.3, 0])), atol=1e-6)
    np.testing.assert_allclose(oblique.size, [0.04, 0.05, 0.3], rtol=1e-6)
    np.testing.assert_array_equal(fit_primitive(turned(0.005)).rotation, np.eye(3))


def test_scale_acts_before_the_fit_and_may_mirror():
    mesh = trimesh.creation.box((0.1, 0.2, 0.3)).apply_translation([0, 1, 0])
    fit = fit_primitive(mesh, (1, -2, 0.5))
    np.testing.assert_allclose(fit.size, [0.1, 0.4, 0.15])
    np.testing.assert_allclose(fit.position, [0, -2, 0], atol=1e-12)


def test_a_flat_mesh_gets_a_thickness():
    plate = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.2, 0], [0, 0.2, 0]], [[0, 1, 2], [0, 2, 3]])
    fit = fit_primitive(plate)
    assert fit.kind == "box"
    np.testing.assert_allclose(fit.size, [0.1, 0.2, 1e-3])
    assert fit_sphere(plate).size[0] == pytest.approx(np.hypot(0.05, 0.1))


def test_a_sphere_is_found_where_it_is():
    fit = fit_sphere(trimesh.creation.icosphere(4, 0.02).apply_translation([0.1, 0, -0.2]))
    np.testing.assert_allclose(fit.position, [0.1, 0, -0.2], atol=1e-6)
    assert fit.size[0] == pytest.approx(0.02, rel=1e-5)


coordinate = st.floats(-1, 1).map(lambda x: round(x, 3))
cloud = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=5, max_size=20, unique=True)


@settings(max_examples=60, deadline=None)
@given(cloud)
def test_fits_enclose_every_vertex_and_beat_the_upright_box(points):
    points = np.array(points)
    mesh = trimesh.Trimesh(points, np.arange(3)[None], process=False)
    fit = fit_primitive(mesh)
    assert outside(fit, points) < 1e-9
    assert outside(fit_sphere(mesh), points) < 1e-9
    assert fit.volume <= (1 + SNAP) * np.maximum(np.ptp(points, axis=0), 1e-3).prod() * (1 + 1e-9)
    np.testing.assert_allclose(fit.rotation @ fit.rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(fit.rotation) == pytest.approx(1)


def test_the_volume_is_that_of_the_shape():
    tapered = trimesh.creation.cone(0.05, 0.3)
    fit = fit_primitive(tapered)
    assert surface(fit).volume == pytest.approx(fit.volume, rel=1e-3)
    assert surface(fit_sphere(tapered)).volume == pytest.approx(fit_sphere(tapered).volume, rel=1e-2)


def test_collision_meshes_of_a_robot_become_primitives(folder):
    tree = read_tree(ROBOT)
    before = etree.tostring(tree.element)
    fitted = with_primitives(tree, MeshFinder(None, [folder]), [tree.link("foot")])
    assert etree.tostring(tree.element) == before
    assert [shape.kind for shape in fitted.shapes] == ["mesh", "box", "sphere", "sphere"]
    leg, foot = fitted.shapes[1], fitted.shapes[3]
    np.testing.assert_allclose(leg.size, [0.04, 0.06, 0.4], rtol=1e-6)
    np.testing.assert_allclose(leg.position, [0, 0, -0.1], atol=1e-9)
    np.testing.assert_allclose(leg.rotation, rotation_of(np.array([0, 0.3, 0])), atol=1e-9)
    np.testing.assert_allclose(foot.position, [0.01, 0, 0], atol=1e-6)


def test_the_text_of_the_copy_says_the_same(folder):
    tree = read_tree(ROBOT)
    fitted = with_primitives(tree, MeshFinder(None, [folder]), [tree.link("foot")])
    text = etree.tostring(fitted.element, encoding="unicode")
    again = read_tree(text)
    assert "kept" in text
    assert text.count("<mesh") == 1
    for one, other in zip(fitted.shapes, again.shapes, strict=True):
        assert (one.kind, one.link) == (other.kind, other.link)
        np.testing.assert_array_equal(one.size, other.size)
        np.testing.assert_allclose(one.position, other.position)
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-12)
    assert all(link.element.getroottree().getroot() is fitted.element for link in fitted.links)


def test_a_long_mesh_is_no_foot(folder):
    tree = read_tree(ROBOT)
    with pytest.raises(MorphologyError, match=r"link 'leg' collision.*0\.400 m long.*<sphere>"):
        with_primitives(tree, MeshFinder(None, [folder]), [tree.link("leg")])
