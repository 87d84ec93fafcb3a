"""The built-in robots against their vendors' numbers, written down here by hand."""

import io

import mujoco
import numpy as np
import pytest
import yourdfpy
from morphgen import MorphologyError, load_robot
from morphgen.robots import GO2, LITE3, ROBOTS, build_urdf

ROBOT = pytest.mark.parametrize("robot", [GO2, LITE3], ids=lambda robot: robot.name)
LEGS = pytest.mark.parametrize("legs", ["box", "vendor"])

MASS = {
    "go2": {"trunk": 6.921 + 2 * 0.001, "hip": 0.678, "thigh": 1.152, "shank": 0.154, "foot": 0.04},
    "lite3": {"trunk": 5.6056, "hip": 0.55, "thigh": 0.86, "shank": 0.153, "foot": 0.02},
}
TOTAL = {"go2": 15.019, "lite3": 11.9376}
# stands of the vendors' software: hip, thigh, knee, height of the hip plus radius of the foot
STANDS = {
    "go2": [(0, 0.8, -1.5, 0.333), (0, 1.0, -1.5, 0.324), (0, 0.9, -1.8, 0.287), (0, 0.67, -1.3, 0.361)],
    "lite3": [
        (0, -0.65, 1.3, 0.348),
        (0, -1.0, 1.8, 0.276),
        (0, np.deg2rad(-42), np.deg2rad(78), 0.341),
    ],
}


def compile_urdf(text):
    """The robot with a free base, with the masses of its file."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    return spec.compile()


def read(robot, legs="vendor"):
    """The robot as an independent reader sees it."""
    return yourdfpy.URDF.load(io.BytesIO(build_urdf(robot, legs).encode()), load_meshes=False)


def names(robot, leg):
    return [robot.legs[leg] + part for part in robot.links]


def feet_at(model, robot, angles):
    """Positions of the four feet relative to their thigh joints, with the same angles (3,) on every leg."""
    data = mujoco.MjData(model)
    data.qpos[7:] = np.tile(angles, 4)
    mujoco.mj_kinematics(model, data)
    return np.array([data.body(names(robot, leg)[3]).xpos - data.body(names(robot, leg)[1]).xpos for leg in range(4)])


@ROBOT
@LEGS
def test_every_link_has_the_vendors_mass(robot, legs):
    model = compile_urdf(build_urdf(robot, legs))
    expected = MASS[robot.name]
    assert model.body(robot.base).mass == pytest.approx(expected["trunk"], rel=1e-12)
    for leg in range(4):
        found = [model.body(name).mass[0] for name in names(robot, leg)]
        np.testing.assert_allclose(found, [expected[part] for part in ("hip", "thigh", "shank", "foot")], rtol=1e-12)
    assert mujoco.mj_getTotalmass(model) == pytest.approx(TOTAL[robot.name], abs=1e-9)
    assert (model.nv, model.nbody) == (18, 18)


@ROBOT
@LEGS
def test_joints_sit_where_the_vendor_has_them(robot, legs):
    model = compile_urdf(build_urdf(robot, legs))
    x, y, offset, thigh, shank = {
        "go2": (0.1934, 0.0465, 0.0955, 0.213, 0.213),
        "lite3": (0.1745, 0.062, 0.09735, 0.20, 0.21012),
    }[robot.name]
    for leg, (fore, left) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        expected = [(fore * x, left * y, 0), (0, left * offset, 0), (0, 0, -thigh), (0, 0, -shank)]
        np.testing.assert_array_equal([model.body(name).pos for name in names(robot, leg)], expected)


def test_vendor_names_axes_and_limits():
    half_turn = (-1.5708, 3.4907, 23.7, 30.1)
    go2, lite3 = read(GO2).joint_map, read(LITE3).joint_map
    expected = {
        (GO2, "FL_hip_joint"): ((1, 0, 0), (-1.0472, 1.0472, 23.7, 30.1)),
        (GO2, "FR_thigh_joint"): ((0, 1, 0), half_turn),
        (GO2, "RL_thigh_joint"): ((0, 1, 0), (-0.5236, 4.5379, 23.7, 30.1)),
        (GO2, "RR_calf_joint"): ((0, 1, 0), (-2.7227, -0.83776, 45.43, 15.70)),
        (LITE3, "FL_HipX"): ((-1, 0, 0), (-0.523, 0.523, 24, 26.2)),
        (LITE3, "HR_HipY"): ((0, -1, 0), (-2.67, 0.314, 24, 26.2)),
        (LITE3, "HL_Knee"): ((0, -1, 0), (0.524, 2.792, 36, 17.3)),
    }
    for (robot, name), (axis, limit) in expected.items():
        joint = (go2 if robot is GO2 else lite3)[name]
        np.testing.assert_array_equal(joint.axis, axis)
        assert (joint.limit.lower, joint.limit.upper, joint.limit.effort, joint.limit.velocity) == limit
    assert (go2["RL_foot_joint"].child, lite3["HL_Ankle"].child) == ("RL_foot", "HL_FOOT")


def test_vendor_joint_order():
    in_file = [joint.name for joint in read(GO2).robot.joints if joint.type == "revolute"]
    sdk_to_file = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
    assert GO2.vendor_joints == tuple(in_file[i] for i in sdk_to_file)
    assert LITE3.vendor_joints[:4] == ("FL_HipX", "FL_HipY", "FL_Knee", "FR_HipX")
    assert LITE3.vendor_joints == tuple(joint.name for joint in read(LITE3).robot.joints if joint.type == "revolute")


@ROBOT
def test_reach_of_a_leg(robot):
    model = compile_urdf(build_urdf(robot))
    shortest, longest = {"go2": (0.0886, 0.3892), "lite3": (0.072, 0.396)}[robot.name]
    ends = model.joint(robot.legs[0] + robot.joints[2]).range
    reaches = sorted(np.linalg.norm(feet_at(model, robot, (0, 0, angle))[0]) for angle in ends)
    np.testing.assert_allclose(reaches, (shortest, longest), atol=6e-4)


@ROBOT
def test_the_vendors_stands_are_within_limits_and_as_high_as_known(robot):
    model = compile_urdf(build_urdf(robot))
    for *angles, height in STANDS[robot.name]:
        joint_range = model.jnt_range[1:].reshape(4, 3, 2)
        assert np.all(joint_range[..., 0] <= angles)
        assert np.all(angles <= joint_range[..., 1])
        np.testing.assert_allclose(-feet_at(model, robot, angles)[:, 2] + 0.022, height, atol=6e-4)
    assert any(np.allclose(robot.control.stand, stand[:3]) for stand in STANDS[robot.name])


@ROBOT
def test_feet_are_balls_of_22_mm(robot):
    model = compile_urdf(build_urdf(robot))
    # a solid ball's 2/5 m r^2 for Lite3; the vendor's number for Go2
    inertia = {"go2": 9.6e-6, "lite3": 3.872e-6}[robot.name]
    for leg in range(4):
        foot = model.body(names(robot, leg)[3])
        np.testing.assert_allclose(foot.inertia, [inertia] * 3, rtol=1e-12)
        assert model.geom_size[foot.geomadr[0], 0] == 0.022


def test_vendor_inertials_of_the_left_legs():
    go2, lite3 = read(GO2).link_map, read(LITE3).link_map
    expected = [
        (go2["FL_thigh"], (-0.00374, -0.0223, -0.0327), (0.00584, 8.72e-5, -2.89e-4, 0.0058, 8.08e-4, 0.00103)),
        (go2["RL_calf"], (0.00548, -0.000975, -0.115), (0.00108, 3.4e-7, 1.72e-5, 0.0011, 8.28e-6, 3.29e-5)),
        (go2["RR_hip"], (0.0054, -0.00194, -0.000105), (4.8e-4, -3.01e-6, -1.11e-6, 8.84e-4, 1.42e-6, 5.96e-4)),
        (lite3["HL_THIGH"], (-0.0039245, -0.014632, -0.025146), (0.005736, 0, 0, 0.00496, 0, 0.001436)),
        (lite3["FL_SHANK"], (0.0064794, 0, -0.12157), (8.9039e-4, 0, 0, 9.0672e-4, 0, 3.1266e-5)),
        (lite3["HR_HIP"], (0.010354, 0.011423, 0.00049498), (4.472e-4, 0, 0, 4.028e-4, 0, 3.949e-4)),
    ]
    for link, com, inertia in expected:
        np.testing.assert_array_equal(link.inertial.origin[:3, 3], com)
        np.testing.assert_array_equal(link.inertial.inertia[np.triu_indices(3)], inertia)


@ROBOT
@LEGS
def test_right_legs_mirror_the_left_ones_where_the_vendors_do(robot, legs):
    links = read(robot, legs).link_map
    flip = np.diag([1, -1, 1])
    for left, right in ((0, 1), (2, 3)):
        for part, (mine, other) in enumerate(zip(names(robot, left), names(robot, right), strict=True)):
            one, two = links[mine].inertial, links[other].inertial
            if (robot, part) == (LITE3, 0):
                apart = np.abs(flip @ one.origin[:3, 3] - two.origin[:3, 3]).max()
                assert apart == pytest.approx({0: 4.7e-3, 2: 1.2e-3}[left], abs=1e-4)
                np.testing.assert_array_equal(np.diag(one.inertia), np.diag(two.inertia)[::-1])
                continue
            np.testing.assert_array_equal(flip @ one.origin[:3, 3], two.origin[:3, 3])
            np.testing.assert_array_equal(flip @ one.inertia @ flip, two.inertia)


def swing(link):
    """Inertia about a joint along y at the origin of the link."""
    x, _, z = link.inertial.origin[:3, 3]
    return link.inertial.inertia[1, 1] + link.inertial.mass * (x**2 + z**2)


@ROBOT
def test_box_legs_swing_another_inertia_than_the_vendors(robot):
    box, vendor = read(robot, "box").link_map, read(robot, "vendor").link_map
    expected = {"go2": (2.48, 0.744), "lite3": (2.084, 0.711)}[robot.name]
    for leg in range(4):
        for name, ratio in zip(names(robot, leg)[1:3], expected, strict=True):
            assert swing(box[name]) / swing(vendor[name]) == pytest.approx(ratio, abs=4e-3)


# worked by hand from the vendor's second moments about the thigh joint: paper m xi ((L xi)^2/3 + b^2/12);
# stretch xi (J_x + xi^2 J_z); lumped J - (1 - xi^3) m_r L^2/3 with a rod m_r = m c_z / (L/2)
@ROBOT
@pytest.mark.parametrize("rule", ["paper", "stretch", "lumped"])
def test_thighs_under_the_rules(robot, rule):
    expected = {
        ("go2", "paper"): (0.541, 2.483, 6.799),
        ("go2", "stretch"): (0.2438, 1.0, 2.6465),
        ("go2", "lumped"): (0.4050, 1.0, 2.3236),
        ("lite3", "paper"): (0.452, 2.084, 5.710),
        ("lite3", "stretch"): (0.2399, 1.0, 2.6604),
        ("lite3", "lumped"): (0.5903, 1.0, 1.9115),
    }[robot.name, rule]
    factory = load_robot(robot.name, rule=rule)
    thigh = names(robot, 3)[1]
    vendor = swing(read(robot, "vendor").link_map[thigh])
    for scale, ratio in zip((0.6, 1.0, 1.4), expected, strict=True):
        text = factory.urdf((1.0, 1.0, scale, 1.0))
        scaled = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False).link_map[thigh]
        assert swing(scaled) / vendor == pytest.approx(ratio, abs=6e-4)


def test_box_legs_follow_table_2():
    go2, lite3 = read(GO2, "box").link_map, read(LITE3, "box").link_map
    # m/12 (b^2 + L^2), m b^2/6
    expected = [
        (go2["RR_thigh"], 1.152, 0.029, 0.213),
        (go2["FL_calf"], 0.154, 0.024, 0.213),
        (lite3["FR_THIGH"], 0.86, 0.02, 0.20),
        (lite3["HL_SHANK"], 0.153, 0.02, 0.21012),
    ]
    for link, mass, b, length in expected:
        swing = mass / 12 * (b * b + length * length)
        np.testing.assert_allclose(link.inertial.inertia, np.diag([swing, swing, mass * b * b / 6]), rtol=1e-12)
        np.testing.assert_array_equal(link.inertial.origin[:3, 3], (0, 0, -length / 2))
        np.testing.assert_array_equal(link.collisions[0].geometry.box.size, (b, b, length))


@ROBOT
def test_only_the_mass_distribution_of_thighs_and_shanks_differs(robot):
    box, vendor = (build_urdf(robot, legs).splitlines() for legs in ("box", "vendor"))
    differing = [one.split("=")[0].strip() for one, two in zip(box, vendor, strict=True) if one != two]
    assert differing == ["<origin xyz", "<inertia ixx"] * 8


@ROBOT
@LEGS
def test_every_inertia_is_that_of_a_rigid_body(robot, legs):
    for link in read(robot, legs).robot.links:
        a, b, c = np.linalg.eigvalsh(link.inertial.inertia)
        assert a > 0, link.name
        assert a + b >= c, link.name


@ROBOT
def test_the_trunk_boxes(robot):
    model = compile_urdf(build_urdf(robot))
    boxes = {
        "go2": [((0.3762, 0.0935, 0.114), (0, 0, 0))],
        "lite3": [((0.5, 0.1, 0.12), (0, 0, 0.01)), ((0.25, 0.2, 0.12), (0, 0, 0.01))],
    }[robot.name]
    mine = np.flatnonzero(model.geom_bodyid == model.body(robot.base).id)
    np.testing.assert_allclose(2 * model.geom_size[mine], [size for size, _ in boxes], rtol=1e-12)
    np.testing.assert_array_equal(model.geom_pos[mine], [centre for _, centre in boxes])


@pytest.mark.parametrize("name", ROBOTS)
def test_factories_stand_on_box_legs(name):
    robot = {"go2": GO2, "lite3": LITE3}[name]
    factory = load_robot(name)
    assert factory.layout.joints == tuple(leg + joint for leg in robot.legs for joint in robot.joints[:3])
    nominal = factory.space.nominal
    body = factory.batch(nominal)
    assert body.feasible.all()
    assert body.total_mass[0] == pytest.approx(TOTAL[name], abs=1e-9)
    joints = [body.model.joint(joint) for joint in factory.layout.joints]
    assert {float(joint.armature[0]) for joint in joints} == {robot.armature}
    assert {float(joint.frictionloss[0]) for joint in joints} == {robot.friction}
    knees = body.torque_limit.reshape(4, 3)[:, 2]
    np.testing.assert_array_equal(knees, {"go2": 45.43, "lite3": 36}[name])


def test_an_unknown_robot_names_the_known_ones():
    with pytest.raises(MorphologyError, match="'spot'; known: go2, lite3"):
        load_robot("spot")
