"""What vendors' files do differently: the same robot stays the same, other robots stay sound, the rest is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import robot_defects as defects
import yourdfpy
from lxml import etree
from morphgen import BodyFactory, MorphologyError
from numpy.testing import assert_allclose
from plain_mujoco import ball_centre, compile_urdf, mass_matrix, pose, random_poses

DESIGN = (0.7, 1.3, 1.2, 0.8)
SOUND = ["clean", *defects.SAME, *defects.OTHER]
LOCKS = {
    "five_legs": [f"arm{i}_joint" for i in range(3)],
    "wheels": [f"{leg}_foot_joint" for leg in defects.SIDES],
}
NEW_SHAPES = ("no_foot_link", "no_ball", "mirrored_meshes", "mesh_shanks")
MASSES = {  # of all thighs and shanks that stretch, and what comes or goes besides [kg]
    "heavy_foot_link": (1.18, 0.19 + 0.24, -4 * 0.05),
    "rotors": (1.18, 0.19, 12 * 0.08),
    "knee_drive": (1.18, 0.19, 4 * 1.1),
    "no_foot_link": (1.18, 0.19, -4 * 0.05),
    "no_ball": (1.18, 0.19, -4 * 0.05),
    "invalid_sensor": (1.18, 0.19, 0.06),
    "zero_shank": (1.18, 0.19, -4 * 0.05),
    "five_legs": (1.18, 0.19, 3 * 0.5),
}


@pytest.fixture
def load(tmp_path):
    def load(name: str, **options) -> BodyFactory:
        path = defects.write(name, tmp_path)
        text = path.read_text(encoding="utf-8")
        factory = BodyFactory(name, text, rule="stretch", source=path, **options)
        factory.drive = replace(factory.drive, torque_limit=60.0)
        return factory

    return load


def assert_same_body(factory: BodyFactory, design, seed: int = 0) -> None:
    """The exported URDF, compiled by MuJoCo alone, moves as the factory's own model does."""
    ours, plain = factory.spec(design).compile(), compile_urdf(factory.urdf(design))
    joints = factory.layout.joints
    for base, angles in random_poses(3, seed):
        data, other = pose(ours, base, joints, angles), pose(plain, base, joints, angles)
        assert_allclose(mass_matrix(plain, other, joints), mass_matrix(ours, data, joints), atol=1e-9)
        for foot in factory.layout.feet:
            assert_allclose(ball_centre(plain, other, foot), data.site(foot).xpos, atol=1e-9)


def expected_mass(name: str, design) -> float:
    thigh, shank, extra = MASSES.get(name, (1.18, 0.19, 0.0))
    stretched = 2 * (thigh * design[0] + shank * design[1] + thigh * design[2] + shank * design[3])
    return 7.5 + 4 * (0.74 + 0.05) + stretched + extra


@pytest.mark.parametrize("name", SOUND)
def test_the_exported_urdf_is_the_body_that_is_simulated(load, name):
    factory = load(name)
    assert_same_body(factory, DESIGN)
    plain = compile_urdf(factory.urdf(DESIGN))
    assert plain.body_mass.sum() == pytest.approx(expected_mass(name, DESIGN), rel=1e-12)
    assert factory.batch([DESIGN]).total_mass[0] == pytest.approx(expected_mass(name, DESIGN), rel=1e-12)


@pytest.mark.parametrize("name", [*defects.SAME, "wheels"])
def test_other_words_for_the_same_robot_change_nothing(load, name):
    clean, other = load("clean"), load(name, lock=LOCKS.get(name, []))
    ours, theirs = clean.spec(DESIGN).compile(), other.spec(DESIGN).compile()
    for base, angles in random_poses(3, 1):
        data, twin = (
            pose(model, base, factory.layout.joints, angles) for model, factory in ((ours, clean), (theirs, other))
        )
        assert_allclose(
            mass_matrix(theirs, twin, other.layout.joints), mass_matrix(ours, data, clean.layout.joints), atol=1e-9
        )
        for foot, twin_foot in zip(clean.layout.feet, other.layout.feet, strict=True):
            assert_allclose(twin.site(twin_foot).xpos, data.site(foot).xpos, atol=1e-9)
    if name != "continuous_joints":  # without limits, another stance may be as good
        assert_allclose(other.stance([DESIGN]).joints, clean.stance([DESIGN]).joints, atol=1e-9)


def test_hinges_the_other_way_round_only_change_signs(load):
    clean, other = load("clean"), load("negative_axes")
    assert_allclose(other.stance([DESIGN]).joints, -clean.stance([DESIGN]).joints, atol=1e-9)
    joints, sign = clean.layout.joints, np.diag([1.0] * 6 + [-1.0] * 12)
    ours, theirs = clean.spec(DESIGN).compile(), other.spec(DESIGN).compile()
    for base, angles in random_poses(2, 4):
        data, twin = pose(ours, base, joints, angles), pose(theirs, base, joints, -angles)
        matrix = sign @ mass_matrix(theirs, twin, joints) @ sign
        assert_allclose(matrix, mass_matrix(ours, data, joints), atol=1e-9)


def test_feet_of_the_clean_robot_by_hand(load):
    model = compile_urdf(load("clean").urdf(DESIGN))
    data = pose(model, np.array([0, 0, 0, 1, 0, 0, 0]), (), np.array([]))
    for leg, (x, y) in defects.SIDES.items():
        thigh, shank = DESIGN[:2] if x > 0 else DESIGN[2:]
        foot = (0.205 * x, (0.068 + 0.094) * y, -0.22 * thigh - 0.225 * shank)
        assert_allclose(ball_centre(model, data, f"{leg}_foot"), foot, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in SOUND if name not in ("asymmetric", "strange_names")])
def test_left_and_right_stay_mirror_images(load, name):
    factory = load(name)
    model, joints = compile_urdf(factory.urdf(DESIGN)), factory.layout.joints
    left = np.random.default_rng(2).uniform(-1, 1, (2, 3))
    angles = np.stack([left[0], left[0] * (-1, 1, 1), left[1], left[1] * (-1, 1, 1)]).ravel()
    data = pose(model, np.array([0, 0, 0, 1, 0, 0, 0]), joints, angles)
    inertia = np.diag(mass_matrix(model, data, joints))[6:].reshape(4, 3)
    assert_allclose(inertia[[1, 3]], inertia[[0, 2]], rtol=1e-9)
    for near, far in ((0, 1), (2, 3)):
        feet = [ball_centre(model, data, factory.layout.feet[leg]) for leg in (near, far)]
        assert_allclose(feet[1], feet[0] * (1, -1, 1), atol=1e-9)
        hips = [model.jnt_bodyid[model.joint(joints[3 * leg]).id] for leg in (near, far)]
        assert_allclose(data.subtree_com[hips[1]], data.subtree_com[hips[0]] * (1, -1, 1), atol=1e-9)


@pytest.mark.parametrize("name", defects.OTHER)
def test_bodies_stand_on_their_feet(load, name):
    factory = load(name)
    design = factory.sample(1, np.random.default_rng(3))[0]
    batch = factory.batch([design])
    model = factory.spec(design).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = batch.stance_qpos[0], batch.stance_ctrl[0]
    mujoco.mj_step(model, data, 300)
    assert data.qpos[2] > 0.9 * batch.stance_qpos[0, 2]
    assert abs(2 * np.arcsin(data.qpos[5])) < np.radians(5)
    touching = {model.body(model.geom_bodyid[g]).name for g in data.contact.geom.ravel()} - {"world"}
    assert touching == set(factory.layout.feet)
    assert all(data.sensor(name).data[0] > 0 for name in factory.layout.foot_contact)


@pytest.mark.parametrize("name", [name for name in SOUND if name not in NEW_SHAPES])
def test_the_nominal_body_is_the_file_as_it_was(load, tmp_path, name):
    written = etree.fromstring(load(name).urdf((1, 1, 1, 1)).encode())
    original = etree.fromstring((tmp_path / f"{name}.urdf").read_bytes())
    assert etree.tostring(written, method="c14n") == etree.tostring(original, method="c14n")


def test_what_is_not_the_robot_survives(load):
    text = load("extra_tags").urdf(DESIGN)
    root = etree.fromstring(text.encode())
    assert root.find("gazebo[@reference='FL_foot']/kp").text == "1e6"
    assert root.find("transmission/joint/hardwareInterface").text == "EffortJointInterface"
    assert root.find("mujoco/compiler").get("meshdir") == "../meshes/"
    assert root.find("joint[@name='FL_foot_joint']").get("dont_collapse") == "true"
    assert root.find("link[@name='FL_shank']/contact/lateral_friction") is not None
    assert "<!-- soft sole -->" in text
    assert '<material name="不锈钢">' in load("windows_file").urdf(DESIGN)
    materials = etree.fromstring(load("several_materials").urdf(DESIGN).encode())
    assert len(materials.findall("link[@name='RR_thigh']/visual/material")) == 2


def vector(root, path: str, attribute: str = "xyz") -> np.ndarray:
    return np.array([float(x) for x in root.find(path).get(attribute).split()])


def test_offsets_beside_the_leg_are_kept(load):
    root = etree.fromstring(load("lateral_knee").urdf(DESIGN).encode())
    assert_allclose(vector(root, "joint[@name='FL_shank_joint']/origin"), (0.007, 0.08, -0.22 * 0.7), atol=1e-15)
    assert_allclose(vector(root, "joint[@name='RR_shank_joint']/origin"), (0.012, -0.08, -0.22 * 1.2), atol=1e-15)
    root = etree.fromstring(load("oblique_foot").urdf(DESIGN).encode())
    assert_allclose(vector(root, "joint[@name='FR_foot_joint']/origin"), (0.07 * 1.3, 0.02, -0.22 * 1.3), atol=1e-15)


def test_rotated_boxes_grow_along_the_leg(load):
    for name in ("rotated_boxes", "rounded_angles"):
        root = etree.fromstring(load(name).urdf(DESIGN).encode())
        box = "link[@name='FL_thigh']/collision"
        assert_allclose(vector(root, f"{box}/geometry/box", "size"), (0.18 * 0.7, 0.025, 0.034), rtol=1e-6)
        assert_allclose(vector(root, f"{box}/origin"), (0, 0, -0.1 * 0.7), atol=1e-15)


def test_both_ends_of_a_tilted_cylinder_follow_the_stretch(load, tmp_path):
    def ends(text: str) -> np.ndarray:
        root = etree.fromstring(text.encode())
        found = []
        for collision in root.findall("link[@name='RL_shank']/collision"):
            place = defects.placement(collision)
            half = float(collision.find("geometry/cylinder").get("length")) / 2
            found += [place[:3, 3] + sign * half * place[:3, 2] for sign in (-1, 1)]
        return np.array(found)

    factory = load("tilted_cylinders")
    before = ends((tmp_path / "tilted_cylinders.urdf").read_text())
    assert_allclose(ends(factory.urdf(DESIGN)), before * (1, 1, 0.8), atol=1e-12)
    radii = re.findall(r'cylinder radius="([\d.]+)"', factory.urdf(DESIGN))
    assert set(radii) == set(
        re.findall(r'cylinder radius="([\d.]+)"', (tmp_path / "tilted_cylinders.urdf").read_text())
    )


def test_the_structure_of_a_foot_stretches_and_its_ball_does_not(load):
    root = etree.fromstring(load("heavy_foot_link").urdf(DESIGN).encode())
    assert_allclose(vector(root, "link[@name='FL_foot']/inertial/origin"), (0, 0, 0.12 * 1.3), atol=1e-15)
    assert_allclose(vector(root, "link[@name='FL_foot']/inertial/mass", "value"), 0.24 * 1.3, rtol=1e-12)
    assert_allclose(vector(root, "link[@name='FL_foot']/collision/geometry/sphere", "radius"), defects.FOOT_RADIUS)


@pytest.mark.parametrize(("name", "end"), [("rotors", "shank_rotor"), ("knee_drive", "KFE_drive")])
def test_rotors_and_drives_move_and_keep_their_shape(load, tmp_path, name, end):
    scaled = etree.fromstring(load(name).urdf(DESIGN).encode())
    original = etree.parse(tmp_path / f"{name}.urdf").getroot()
    for leg in defects.SIDES:
        path = f"link[@name='{leg}_{end}']/inertial"
        assert etree.tostring(scaled.find(path)) == etree.tostring(original.find(path))
    models = [compile_urdf(etree.tostring(root, encoding="unicode")) for root in (original, scaled)]
    places = []
    for model in models:
        data = pose(model, np.array([0, 0, 0, 1, 0, 0, 0]), (), np.array([]))
        places.append(data.body(f"FL_{end}").xpos - data.body("FL_thigh").xpos)
    assert_allclose(places[1], places[0] * (1, 1, 0.7), atol=1e-12)


@pytest.mark.parametrize("name", ["mirrored_meshes", "rounded_angles", "several_materials"])
def test_pictures_stretch_with_the_leg(load, tmp_path, name):
    def thigh(path) -> np.ndarray:
        robot = yourdfpy.URDF.load(str(path), load_meshes=True, filename_handler=lambda fname: found(fname, tmp_path))
        scene = robot.scene
        frame = scene.graph.get("FR_thigh")[0]
        corners = []
        for node in scene.graph.nodes_geometry:
            if scene.graph.transforms.parents[node] == "FR_thigh":
                matrix, geometry = scene.graph.get(node)
                inside = np.linalg.inv(frame) @ matrix
                corners.append(scene.geometry[geometry].vertices @ inside[:3, :3].T + inside[:3, 3])
        points = np.vstack(corners)
        return points[np.lexsort(np.round(points, 6).T)]

    factory = load(name)
    (tmp_path / "scaled.urdf").write_text(factory.urdf(DESIGN), encoding="utf-8")
    before = thigh(tmp_path / f"{name}.urdf")
    assert len(before) >= 5
    after = before * (1, 1, 0.7)
    assert_allclose(thigh(tmp_path / "scaled.urdf"), after[np.lexsort(np.round(after, 6).T)], atol=2e-5)


def found(name: str, folder):
    return str(folder / "meshes" / name.rsplit("/", 1)[1])


def test_an_asymmetry_is_kept(load):
    skeletons = [load(name).skeleton([DESIGN]) for name in ("clean", "asymmetric")]
    moved = skeletons[1].link_com[0, :, 0] - skeletons[0].link_com[0, :, 0]
    assert_allclose(moved, [(0, 0, 0), (0.005, 0, 0)] * 2, atol=1e-15)


@pytest.mark.parametrize("name", defects.REPAIRABLE)
def test_impossible_inertia_is_refused_or_repaired(load, tmp_path, name):
    culprit = {"invalid_sensor": "camera", "indefinite_thigh": "FL_thigh"}.get(name, "FL_shank")
    with pytest.raises(MorphologyError, match=rf"{name}\.urdf: link '{culprit}'.*--repair"):
        load(name)
    factory = load(name, repair=True)
    assert any(f"link '{culprit}'" in note for note in factory.notes)
    assert_same_body(factory, DESIGN)
    plain = compile_urdf(factory.urdf(DESIGN))
    assert plain.body_mass.sum() == pytest.approx(expected_mass(name, DESIGN), rel=1e-12)
    assert bool(factory.feasible([[1, 1, 1, 1]])[0])


@pytest.mark.parametrize("name", LOCKS)
def test_surplus_joints_can_be_locked(load, name):
    factory = load(name, lock=LOCKS[name])
    model = factory.spec(DESIGN).compile()
    assert (model.nv, model.nu) == (18, 12)
    assert model.body_mass.sum() == pytest.approx(expected_mass(name, DESIGN), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "element", "remedy"),
    [
        ("no_inertial", "link 'RR_shank'", "<inertial>"),
        ("negative_mass", "link 'FL_hip'.*-0.5 kg is negative", "<inertial>"),
        ("nan_mass", "link 'FL_hip' mass: value='nan'", "finite number"),
        ("five_legs", "arm0_joint - arm1_joint - arm2_joint", "--lock"),
        ("two_joint_legs", "FL_thigh_joint - FL_shank_joint", "fewer joints are not supported"),
        ("wheels", "FL_hip_joint - FL_thigh_joint - FL_shank_joint - FL_foot_joint", "lock wheels"),
        ("xacro", "line 1 has xacro macros", r"xacro robot\.urdf\.xacro > robot\.urdf"),
        ("entity_bomb", "DOCTYPE", "remove it"),
        ("absolute_mesh", "link 'FL_thigh' collision.*/home/author", "--mesh-path"),
        ("escaping_mesh", "link 'FL_thigh' collision", "--mesh-path"),
        ("missing_mesh", "link 'FL_thigh' collision.*none.stl' not found", "--mesh-path"),
        ("broken_mesh", "link 'FL_thigh' collision.*broken.stl has no triangles", "export it again"),
        ("missing_link", "joint 'RL_shank_joint'", "child link 'RL_shank' does not exist"),
        ("prismatic_knee", "joint 'FL_shank_joint'.*prismatic", "lock it"),
    ],
)
def test_what_cannot_be_scaled_is_refused_by_name(load, name, element, remedy):
    assert name in defects.REFUSED
    with pytest.raises(MorphologyError) as caught:
        load(name, repair=True)
    message = str(caught.value)
    assert f"{name}.urdf: " in message
    assert re.search(element, message), message
    assert re.search(remedy, message), message
    assert len(message) < 1000


def test_every_refusal_is_tested():
    marks = next(m for m in test_what_cannot_be_scaled_is_refused_by_name.pytestmark if m.name == "parametrize")
    assert [row[0] for row in marks.args[1]] == list(defects.REFUSED)
