"""Table II against values worked out by hand, and against another URDF reader."""

import io

import numpy as np
import pytest
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree
from morphgen import MorphologyError, go2, scale_urdf
from morphgen.robots import GO2
from morphgen.robots.description import build_urdf
from numpy.testing import assert_allclose

FACTORY = go2()
SCALES = st.tuples(*[st.floats(0.6, 1.4)] * 4)
LEGS = ("FL", "FR", "RL", "RR")

# by hand: m xi, -L xi / 2, L xi, m xi (b^2 + (L xi)^2) / 12, m xi b^2 / 6
GOLDEN = {
    ("thigh", 0.6): (0.6912, -0.0639, 0.1278, 9.89213184e-4, 9.688320e-5),
    ("thigh", 1.0): (1.152, -0.1065, 0.213, 4.43616e-3, 1.61472e-4),
    ("thigh", 1.4): (1.6128, -0.1491, 0.2982, 1.2064313856e-2, 2.260608e-4),
    ("calf", 0.6): (0.0924, -0.0639, 0.1278, 1.30198068e-4, 8.8704e-6),
    ("calf", 1.0): (0.154, -0.1065, 0.213, 5.896275e-4, 1.4784e-5),
    ("calf", 1.4): (0.2156, -0.1491, 0.2982, 1.608003012e-3, 2.06976e-5),
}
WIDTH = {"thigh": 0.029, "calf": 0.024}


def vector(element, attribute):
    return np.array([float(v) for v in element.get(attribute).split()])


@pytest.mark.parametrize(("segment", "scale"), GOLDEN)
def test_every_entry_of_table_2(go2_tree, as_text, segment, scale):
    mass, com, length, ixx, izz = GOLDEN[segment, scale]
    for link in go2_tree.findall("link"):  # a real robot's inertia has off-diagonals, which must go
        if link.get("name").endswith(segment):
            inertia = link.find("inertial/inertia")
            inertia.set("ixy", "1e-6"), inertia.set("ixz", "-2e-6"), inertia.set("iyz", "1e-6")
            link.find("inertial/origin").set("xyz", "-0.003 -0.02 -0.03")
    root = etree.fromstring(scale_urdf(as_text(go2_tree), [scale] * 4, rule="paper").encode())
    child_joint = {"thigh": "calf", "calf": "foot"}[segment]
    for leg in LEGS:
        link = root.find(f"link[@name='{leg}_{segment}']")
        assert_allclose(vector(link.find("inertial/origin"), "xyz"), (0, 0, com), rtol=1e-12)
        assert_allclose(vector(link.find("inertial/mass"), "value"), mass, rtol=1e-12)
        inertia = {key: float(value) for key, value in link.find("inertial/inertia").attrib.items()}
        assert inertia == pytest.approx(
            {"ixx": ixx, "iyy": ixx, "izz": izz, "ixy": 0, "ixz": 0, "iyz": 0}, rel=1e-9, abs=0
        )
        for tag in ("visual", "collision"):
            assert_allclose(vector(link.find(f"{tag}/origin"), "xyz"), (0, 0, com), rtol=1e-12)
            box = vector(link.find(f"{tag}/geometry/box"), "size")
            assert_allclose(box, (WIDTH[segment], WIDTH[segment], length), rtol=1e-12)
        joint = root.find(f"joint[@name='{leg}_{child_joint}_joint']")
        assert_allclose(vector(joint.find("origin"), "xyz"), (0, 0, -length), rtol=1e-12)


def test_scales_reach_the_right_segments_and_nothing_else():
    scales = (0.7, 0.9, 1.1, 1.3)
    before = etree.fromstring(build_urdf(GO2).encode())
    after = etree.fromstring(FACTORY.urdf(scales).encode())
    expected = {"F_thigh": 0.7, "F_calf": 0.9, "R_thigh": 1.1, "R_calf": 1.3}
    for old, new in zip(before.findall("link"), after.findall("link"), strict=True):
        name = old.get("name")
        scale = expected.get(f"{name[0]}_{name.split('_')[-1]}")
        if scale is None:
            assert etree.tostring(old) == etree.tostring(new)
        else:
            ratio = float(new.find("inertial/mass").get("value")) / float(old.find("inertial/mass").get("value"))
            assert ratio == pytest.approx(scale)
    for old, new in zip(before.findall("joint"), after.findall("joint"), strict=True):
        if not old.get("name").endswith(("calf_joint", "foot_joint")):
            assert etree.tostring(old) == etree.tostring(new)


def test_scale_one_keeps_every_number():
    before, after = (etree.fromstring(text.encode()) for text in (build_urdf(GO2), FACTORY.urdf(np.ones(4))))
    for old, new in zip(before.iter(), after.iter(), strict=True):
        assert old.attrib == new.attrib


def test_comments_and_unknown_tags_survive(go2_tree, as_text):
    go2_tree.append(etree.Comment("made by hand"))
    gazebo = etree.SubElement(go2_tree, "gazebo", reference="base")
    etree.SubElement(gazebo, "mu1").text = "0.9"
    out = scale_urdf(as_text(go2_tree), [1.1, 1.2, 1.3, 1.4])
    assert "<!--made by hand-->" in out
    assert '<gazebo reference="base"><mu1>0.9</mu1></gazebo>' in out


@settings(max_examples=25, deadline=None)
@given(SCALES)
def test_another_reader_finds_the_scaled_distances_and_the_mass_balance(scales):
    robot = yourdfpy.URDF.load(io.BytesIO(FACTORY.urdf(scales).encode()), load_meshes=False)
    per_leg = {"F": scales[:2], "R": scales[2:]}
    mass = 15.019  # of Go2 with its head and without rotors
    for leg in LEGS:
        thigh, shank = per_leg[leg[0]]
        knee = robot.get_transform(f"{leg}_calf", f"{leg}_thigh")[:3, 3]
        foot = robot.get_transform(f"{leg}_foot", f"{leg}_calf")[:3, 3]
        assert_allclose(knee, (0, 0, -0.213 * thigh), atol=1e-15)
        assert_allclose(foot, (0, 0, -0.213 * shank), atol=1e-15)
        mass += (thigh - 1) * 1.152 + (shank - 1) * 0.154
    assert sum(link.inertial.mass for link in robot.link_map.values()) == pytest.approx(mass, rel=1e-12)


@settings(max_examples=25, deadline=None)
@given(SCALES)
def test_every_link_is_a_possible_rigid_body_and_left_mirrors_right(scales):
    robot = yourdfpy.URDF.load(io.BytesIO(FACTORY.urdf(scales).encode()), load_meshes=False)
    mirror = np.diag([1.0, -1.0, 1.0])
    for name, link in robot.link_map.items():
        small, middle, large = np.linalg.eigvalsh(link.inertial.inertia)
        assert small > 0
        assert small + middle >= large
        if name[1:2] == "L":
            right = robot.link_map[name[0] + "R" + name[2:]].inertial
            assert right.mass == link.inertial.mass
            assert_allclose(mirror @ link.inertial.origin[:3, 3], right.origin[:3, 3])
            assert_allclose(mirror @ link.inertial.inertia @ mirror, right.inertia)


@pytest.mark.parametrize("bad", [(0, 1, 1, 1), (-1, 1, 1, 1), (np.nan, 1, 1, 1), (np.inf, 1, 1, 1), (1, 1, 1)])
def test_impossible_scales_are_refused(bad):
    with pytest.raises(MorphologyError, match="leg scales must be 4 positive"):
        scale_urdf(build_urdf(GO2), bad)


def test_vendor_numbers_of_go2():
    """Independent copies of the vendor's figures: hip joints, totals and limits."""
    robot = yourdfpy.URDF.load(io.BytesIO(build_urdf(GO2).encode()), load_meshes=False)
    assert robot.num_actuated_joints == 12
    assert_allclose(robot.get_transform("RR_hip", "base")[:3, 3], (-0.1934, -0.0465, 0))
    assert_allclose(robot.get_transform("FR_thigh", "FR_hip")[:3, 3], (0, -0.0955, 0))
    knee, thigh = robot.joint_map["RL_calf_joint"].limit, robot.joint_map["RL_thigh_joint"].limit
    assert (knee.lower, knee.upper, knee.effort, knee.velocity) == (-2.7227, -0.83776, 45.43, 15.7)
    assert (thigh.lower, thigh.upper, thigh.effort, thigh.velocity) == (-0.5236, 4.5379, 23.7, 30.1)
    rear_right_hip = robot.link_map["RR_hip"].inertial
    assert_allclose(rear_right_hip.origin[:3, 3], (0.0054, -0.00194, -0.000105))
    assert rear_right_hip.inertia[0, 1] == pytest.approx(-3.01e-6)
    assert rear_right_hip.inertia[0, 2] == pytest.approx(-1.11e-6)
    assert rear_right_hip.inertia[1, 2] == pytest.approx(1.42e-6)
