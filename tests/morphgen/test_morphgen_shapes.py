"""Primitives and meshes under a stretch: the points that define them follow it."""

import io

import numpy as np
import pytest
import trimesh
import yourdfpy
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lxml import etree
from morphgen import BodyFactory, DesignSpace, go2
from morphgen.scaling.shapes import bake_axis, stretch_shape
from numpy.testing import assert_allclose
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

SEEDS = st.integers(0, 2**32 - 1)
SCALES = st.floats(0.3, 3.0)
RIGHT_ANGLES = [Rotation.from_euler("xyz", a, degrees=True).as_matrix() for a in ((0, 0, 0), (0, 90, 0), (90, 0, 90))]


class Case:
    """A random shape on a link and a random stretch of two bodies, the second by 1."""

    def __init__(self, kind: str, seed: int, scale: float, rotation=None, axis=None) -> None:
        rng = np.random.default_rng(seed)
        self.rotation = Rotation.random(random_state=rng).as_matrix() if rotation is None else np.asarray(rotation)
        axis = rng.normal(size=3) if axis is None else np.asarray(axis)
        self.axis = axis / np.linalg.norm(axis)
        self.position = rng.normal(size=3) * 0.1
        self.size = rng.uniform(0.02, 0.3, 3)
        self.map = np.eye(3) + (scale - 1) * np.outer(self.axis, self.axis)
        # two shapes, of which the second is stretched, on two bodies
        self.all = [np.tile(x, (2, 2, *np.ones(x.ndim, int))) for x in (self.position, self.rotation, self.size)]
        stretch_shape(kind, *self.all, 1, self.axis, np.array([scale, 1.0]))
        self.new_position, self.new_rotation, self.new_size = (x[0, 1] for x in self.all)
        assert_allclose(self.new_rotation @ self.new_rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(self.new_rotation) > 0
        for values, before in zip(self.all, (self.position, self.rotation, self.size), strict=True):
            for body, g in ((0, 0), (1, 0), (1, 1)):
                assert_allclose(values[body, g], before, atol=1e-14)


def ends(position, rotation, length, k=2):
    return np.array([position + sign * length / 2 * rotation[:, k] for sign in (-1, 1)])


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(["cylinder", "capsule"]), SEEDS, SCALES)
def test_the_ends_of_tilted_cylinders_follow_and_their_radius_stays(kind, seed, scale):
    case = Case(kind, seed, scale)
    before = ends(case.position, case.rotation, case.size[1])
    after = ends(case.new_position, case.new_rotation, case.new_size[1])
    assert_allclose(after, before @ case.map, atol=1e-12)
    assert case.new_size[0] == case.size[0]


@pytest.mark.parametrize("tilt", [0.0, -0.2, 0.05, np.pi / 2, np.pi])
def test_cylinders_of_real_legs(tilt):
    """Tilted by 0.2 rad about y and stretched 1.4 times along z: its x stays, its z grows."""
    rotation = Rotation.from_euler("y", tilt).as_matrix()
    case = Case("cylinder", 0, 1.4, rotation, (0, 0, -1))
    x, z = case.size[1] * np.sin(tilt), case.size[1] * np.cos(tilt) * 1.4
    assert case.new_size[1] == pytest.approx(np.hypot(x, z), rel=1e-12)
    assert_allclose(case.new_rotation[:, 2] * case.new_size[1], (x, 0, z), atol=1e-12)
    assert_allclose(case.new_position, case.position * (1, 1, 1.4), rtol=1e-15)


@settings(max_examples=40, deadline=None)
@given(SEEDS, SCALES)
def test_boxes_grow_along_the_axis_nearest_to_the_stretch(seed, scale):
    case = Case("box", seed, scale)
    k = int(np.argmax(np.abs(case.rotation.T @ case.axis)))
    before = ends(case.position, case.rotation, case.size[k], k)
    assert_allclose(ends(case.new_position, case.new_rotation, case.new_size[k], k), before @ case.map, atol=1e-12)
    others = [i for i in range(3) if i != k]
    assert np.array_equal(case.new_size[others], case.size[others])


@settings(max_examples=20, deadline=None)
@given(SEEDS, SCALES, st.sampled_from(range(len(RIGHT_ANGLES))), st.sampled_from(range(3)))
@example(395, 1.1850223572285388, 2, 0)
def test_all_corners_of_boxes_at_right_angles_follow(seed, scale, rotation, axis):
    case = Case("box", seed, scale, RIGHT_ANGLES[rotation], np.eye(3)[axis])

    def corners(position, rotation, size):
        box = trimesh.creation.box(size).vertices
        return box @ rotation.T + position

    wanted = corners(case.position, case.rotation, case.size) @ case.map
    after = corners(case.new_position, case.new_rotation, case.new_size)
    # a flip of an axis may list the corners in another order
    apart = cdist(after, wanted)
    assert_allclose(apart.min(axis=0), 0.0, atol=1e-11)
    assert_allclose(apart.min(axis=1), 0.0, atol=1e-11)


@settings(max_examples=20, deadline=None)
@given(SEEDS, SCALES)
def test_spheres_move_and_stay_spheres(seed, scale):
    case = Case("sphere", seed, scale)
    assert_allclose(case.new_position, case.map @ case.position, atol=1e-14)
    assert np.array_equal(case.new_size, case.size)
    assert np.array_equal(case.new_rotation, case.rotation)


@settings(max_examples=20, deadline=None)
@given(SEEDS, SCALES, st.sampled_from(range(3)), st.sampled_from([-1, 1]))
def test_meshes_stretch_along_an_own_axis_and_keep_their_mirror(seed, scale, k, sign):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=rng).as_matrix()
    case = Case("mesh", seed, scale, rotation, rotation[:, k] * sign)
    assert bake_axis(rotation, case.axis) == k
    points = rng.normal(size=(10, 3))
    before = points * case.size @ rotation.T + case.position
    after = points * case.new_size @ case.new_rotation.T + case.new_position
    assert_allclose(after, before @ case.map, atol=1e-12)


def test_right_angles_that_were_rounded_count_as_right():
    """Files write 3.1415 and 1.57 for pi and pi / 2: 9e-5 and 8e-4 off; a leg of 14 degrees is oblique."""
    down = np.array([0.0, 0.0, -1.0])
    for angle, expected in ((3.1415, 2), (1.57, 0), (1.571, 0), (np.radians(14), None), (0.01, None)):
        assert bake_axis(Rotation.from_euler("y", angle).as_matrix(), down) == expected


MESHES = {"FL_thigh": ("0.01 0.02 -0.03", "0 0.25 0", "1 -1 1"), "FL_calf": ("0 0 -0.01", "3.1415 0 0", "0.5 1 2")}


@pytest.fixture
def robot_with_meshes(go2_tree, tmp_path):
    """Go2 whose left thigh has an oblique, mirrored mesh and whose left shank one along z."""
    mesh = trimesh.creation.box((0.04, 0.03, 0.2))
    mesh.vertices += (0.003, 0.01, -0.1)
    (tmp_path / "meshes").mkdir()
    mesh.export(tmp_path / "meshes" / "part.stl")
    for link, (xyz, rpy, scale) in MESHES.items():
        visual = go2_tree.find(f"link[@name='{link}']/visual")
        visual.find("origin").set("xyz", xyz)
        visual.find("origin").set("rpy", rpy)
        geometry = visual.find("geometry")
        geometry.clear()
        etree.SubElement(geometry, "mesh", filename="meshes/part.stl", scale=scale)
    path = tmp_path / "robot.urdf"
    path.write_bytes(etree.tostring(go2_tree))
    space = DesignSpace.of(front_thigh=(0.5, 2.0), front_shank=(0.5, 2.0))
    return BodyFactory("meshes", path.read_text(), rule="stretch", space=space, source=path)


def placed(robot: yourdfpy.URDF, link: str, folder) -> tuple[np.ndarray, np.ndarray, trimesh.Trimesh]:
    """Vertices (m, 3) of the only visual of a link in link axes, its scale, and the mesh."""
    visual = robot.link_map[link].visuals[0]
    file = visual.geometry.mesh
    mesh = trimesh.load_mesh(folder / file.filename)
    scale = np.ones(3) if file.scale is None else np.asarray(file.scale, dtype=float)
    return trimesh.transform_points(mesh.vertices * scale, visual.origin), scale, mesh


def test_oblique_meshes_are_made_anew_and_others_scaled(robot_with_meshes, tmp_path):
    """Vertices in the link's frame follow S = diag(1, 1, xi), whichever way they are stored."""
    nominal = yourdfpy.URDF.load(io.BytesIO(robot_with_meshes.urdf([1, 1]).encode()), load_meshes=False)
    scaled = robot_with_meshes.scaled_urdf([1.3, 0.8])
    assert ["FL_thigh" in name for name in scaled.meshes] == [True]
    for name, content in scaled.meshes.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    body = yourdfpy.URDF.load(io.BytesIO(scaled.text.encode()), load_meshes=False)
    for link, scale, tolerance in (("FL_thigh", 1.3, 1e-7), ("FL_calf", 0.8, 1e-5)):
        before, own, mesh = placed(nominal, link, tmp_path)
        after, _, made = placed(body, link, tmp_path)
        # a baked STL in single precision has its corners in any order
        expected = before * (1, 1, scale)
        distance = np.linalg.norm(after[:, None] - expected, axis=-1)
        assert distance.min(axis=1).max() < tolerance
        assert distance.min(axis=0).max() < tolerance
        assert made.volume > 0  # a mirrored mesh is not inside out
        if link == "FL_thigh":
            assert made.volume == pytest.approx(mesh.volume * abs(np.prod(own)) * scale, rel=1e-5)


def test_nominal_bodies_need_no_new_mesh(robot_with_meshes):
    scaled = robot_with_meshes.scaled_urdf([1, 1])
    assert scaled.meshes == {}
    assert scaled.text.count("meshes/part.stl") == 2


def test_visuals_of_built_in_robots_follow_their_collisions():
    """Both are the same box, so they must stay so."""
    root = etree.fromstring(go2().urdf([0.7, 1.2, 1.3, 0.9]).encode())
    for link in root.findall("link"):
        shapes = [[etree.tostring(child) for child in link.find(tag)] for tag in ("visual", "collision")]
        assert shapes[0] == shapes[1]
