"""Finding legs, and what happens to files that are not a quadruped with box legs."""

import numpy as np
import pytest
from lxml import etree
from morphgen import BodyFactory, Drive, MorphologyError
from morphgen.urdf.legs import find_legs
from morphgen.urdf.tree import read_tree
from morphgen.urdf.xml import parse_urdf


def test_legs_are_found_by_topology_whatever_their_names_and_order(go2_tree, as_text):
    text = as_text(go2_tree)
    for leg, alias in {"FL": "a", "FR": "b", "RL": "c", "RR": "d"}.items():
        text = text.replace(f'"{leg}_', f'"{alias}_')
    root = etree.fromstring(text)
    root[:] = sorted(root, key=lambda element: element.get("name"), reverse=True)
    tree = read_tree(as_text(root))
    found = find_legs(tree)
    assert [tree.joints[leg.joints[1]].name for leg in found.legs] == [f"{alias}_thigh_joint" for alias in "abcd"]
    assert [tree.links[leg.foot].name for leg in found.legs] == [f"{alias}_foot" for alias in "abcd"]
    assert [(leg.front, leg.left) for leg in found.legs] == [(1, 1), (1, 0), (0, 1), (0, 0)]


def set_attribute(path, **attributes):
    def edit(root):
        for key, value in attributes.items():
            root.find(path).set(key, value)

    return edit


def remove(path):
    def edit(root):
        element = root.find(path)
        element.getparent().remove(element)

    return edit


def fifth_leg(root):
    for element in list(root):
        if element.get("name").startswith("FL_"):
            text = etree.tostring(element, encoding="unicode").replace("FL_", "XX_")
            root.append(etree.fromstring(text))
    root.find("joint[@name='XX_hip_joint']/origin").set("xyz", "0.5 0.2 0")


def wheel(root):
    root.find("joint[@name='RR_foot_joint']").set("type", "continuous")


def bare_leg(root):
    for link in ("RL_calf", "RL_foot"):
        remove(f"link[@name='{link}']/collision")(root)


def second_root(root):
    etree.SubElement(root, "link", name="lonely")


FAULTS = {
    "five legs": (fifth_leg, "expected 4 legs.*found 5"),
    "wheel for a foot": (wheel, "3 actuated joints in a row.*RR_hip_joint"),
    "two-joint leg": (set_attribute("joint[@name='FR_calf_joint']", type="fixed"), "3 actuated.*FR_hip_joint"),
    "same quarter": (set_attribute("joint[@name='FR_hip_joint']/origin", xyz="0.2 0.3 0"), "four quarters"),
    "two roots": (second_root, "one root link, found base, lonely"),
    "missing link": (remove("link[@name='RL_thigh']"), "RL_.*_joint.*'RL_thigh' does not exist"),
    "slider": (
        set_attribute("joint[@name='RL_calf_joint']", type="prismatic"),
        "'RL_calf_joint': a prismatic joint has no place",
    ),
    "nothing to stand on": (bare_leg, "'RL_calf': neither it nor its foot has a collision"),
    "no inertial": (remove("link[@name='RL_calf']/inertial"), "'RL_calf': has no mass"),
    "zero mass": (set_attribute("link[@name='base']/inertial/mass", value="0"), "'base'.*mass"),
    "impossible inertia": (
        set_attribute("link[@name='FL_hip']/inertial/inertia", izz="0.1"),
        "'FL_hip'.*break A . B > C.*--repair",
    ),
    "no box": (remove("link[@name='FR_thigh']/collision"), "'FR_thigh'.*exactly one collision, a box"),
    "flat box": (set_attribute("link[@name='FR_thigh']/collision/geometry/box", size="1 2 3"), "square section"),
    "not numbers": (set_attribute("link[@name='FR_thigh']/inertial/mass", value="heavy"), "'heavy' is not"),
    "nan": (set_attribute("link[@name='FR_thigh']/inertial/mass", value="nan"), "finite numbers"),
    "knee aside": (set_attribute("joint[@name='FR_calf_joint']/origin", xyz="0.1 0 -.2"), "straight below"),
    "no axis": (set_attribute("joint[@name='FR_calf_joint']/axis", xyz="0 0 0"), "axis is zero"),
}


@pytest.mark.parametrize(("edit", "message"), FAULTS.values(), ids=FAULTS.keys())
def test_an_unsuitable_robot_is_refused_by_file_and_element(go2_tree, as_text, edit, message):
    edit(go2_tree)
    with pytest.raises(MorphologyError, match=rf"(?s)^mine\.urdf: .*{message}"):
        BodyFactory("mine", as_text(go2_tree), source="mine.urdf")


def test_a_joint_without_a_torque_limit_needs_one_to_be_simulated(go2_tree, as_text):
    remove("joint[@name='RL_calf_joint']/limit")(go2_tree)
    with pytest.raises(MorphologyError, match=r"'RL_calf_joint'.*no torque limit.*--torque-limit"):
        BodyFactory("mine", as_text(go2_tree)).batch(np.ones(4))
    batch = BodyFactory("mine", as_text(go2_tree), drive=Drive(torque_limit=45.43)).batch(np.ones(4))
    assert batch.torque_limit[0, 8] == 45.43
    assert (batch.joint_lower[0, 8], batch.joint_upper[0, 8]) == (-2 * np.pi, 2 * np.pi)
    assert not batch.model.joint("RL_calf_joint").limited


def test_an_arm_is_locked_by_name(go2_tree, as_text):
    fifth_leg(go2_tree)
    arm = [f"XX_{joint}_joint" for joint in ("hip", "thigh", "calf")]
    locked = BodyFactory("mine", as_text(go2_tree), lock=arm)
    assert locked.batch(np.ones(4)).total_mass[0] == pytest.approx(15.019 + 0.678 + 1.152 + 0.154 + 0.04)
    assert "XX_calf_joint" in locked.urdf(np.ones(4))
    with pytest.raises(MorphologyError, match="no joint 'elbow'"):
        BodyFactory("mine", as_text(go2_tree), lock=["elbow"])


def test_hips_can_be_named(go2_tree, as_text):
    hips = {"FL": "RR_hip_joint", "FR": "RL_hip_joint", "RL": "FR_hip_joint", "RR": "FL_hip_joint"}
    turned = find_legs(read_tree(as_text(go2_tree)), hips)
    assert [leg.joints[0] for leg in turned.legs] == [
        leg.joints[0] for leg in find_legs(read_tree(as_text(go2_tree))).legs
    ][::-1]


def arm_with_fingers(root):
    """A revolute shoulder on the back and two fingers on the arm."""
    for parent, name, kind, axis in (
        ("base", "shoulder", "revolute", "0 0 1"),
        ("shoulder_link", "left_finger", "prismatic", "0 1 0"),
        ("shoulder_link", "right_finger", "prismatic", "0 1 0"),
    ):
        inertial = '<mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
        root.append(etree.fromstring(f'<link name="{name}_link"><inertial>{inertial}</inertial></link>'))
        ends = f'<parent link="{parent}"/><child link="{name}_link"/>'
        limit = f'<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="9" velocity="9"/>'
        root.append(etree.fromstring(f'<joint name="{name}" type="{kind}">{ends}{limit}</joint>'))


def arm_of_three(root):
    """As many joints as a leg, but the first turns about the vertical."""
    fifth_leg(root)
    root.find("joint[@name='XX_hip_joint']/axis").set("xyz", "0 0 1")


HIPS = {leg: f"{leg}_hip_joint" for leg in ("FL", "FR", "RL", "RR")}
NO_HIPS = {
    "no joint": (None, {"FL": "nose"}, "'nose', named for FL .*there is no such joint"),
    "a knee": (None, {"RL": "RL_calf_joint"}, "'RL_calf_joint', named for RL .*not on the trunk"),
    "a fixed joint": (None, {"RR": "RR_foot_joint"}, "'RR_foot_joint', named for RR .*it is fixed"),
    "a gripper's arm": (arm_with_fingers, {"FR": "shoulder"}, "'shoulder', named for FR .*forks .*left_finger.*--lock"),
    "an arm like a leg": (arm_of_three, {"FL": "XX_hip_joint"}, r"'XX_hip_joint', named for FL .*about \[0.* x .forw"),
    "a leg on wheels": (wheel, {}, "'RR_hip_joint', named for RR .*3 actuated joints in a row.*RR_foot_joint"),
    "a slider": (
        set_attribute("joint[@name='RL_calf_joint']", type="prismatic"),
        {},
        "'RL_hip_joint', named for RL .*'RL_calf_joint': a prismatic joint",
    ),
    "one leg twice": (None, {"RR": "FR_hip_joint"}, "'FR_hip_joint' is named for FR and for RR"),
}


@pytest.mark.parametrize(("edit", "named", "message"), NO_HIPS.values(), ids=NO_HIPS.keys())
def test_a_joint_that_is_no_hip_is_refused_with_those_that_can_be(go2_tree, as_text, edit, named, message):
    """Hips that fit are named beside it, and those alone."""
    if edit is not None:
        edit(go2_tree)
    with pytest.raises(MorphologyError, match=rf"^mine\.urdf: .*{message}") as refusal:
        BodyFactory("mine", as_text(go2_tree), source="mine.urdf", hips=HIPS | named)
    broken = {wheel: {"RR_hip_joint"}, NO_HIPS["a slider"][0]: {"RL_hip_joint"}}.get(edit, set())
    offered = str(refusal.value).split("hip joints can be ")[1]
    assert offered == ", ".join(f"'{hip}'" for hip in HIPS.values() if hip not in broken)


def test_an_arm_beside_legs_that_are_named_is_not_forgotten(go2_tree, as_text):
    """Its mass would be missing from the body."""
    fifth_leg(go2_tree)
    with pytest.raises(MorphologyError, match=r"XX_hip_joint - XX_thigh_joint - XX_calf_joint belong to none.*--lock"):
        BodyFactory("mine", as_text(go2_tree), hips=HIPS)
    arm = [f"XX_{joint}_joint" for joint in ("hip", "thigh", "calf")]
    found = BodyFactory("mine", as_text(go2_tree), hips=HIPS, lock=arm)
    assert found.layout.joints[::3] == tuple(HIPS.values())
    arm_with_fingers(go2_tree)
    with pytest.raises(MorphologyError, match=r"forks into the joints 'left_finger', 'right_finger'.*--lock"):
        BodyFactory("mine", as_text(go2_tree), hips=HIPS, lock=arm)


def test_legs_that_are_not_found_in_four_quarters_are_named(go2_tree, as_text):
    """Go2 with a front right hip so far to the left that two legs are front left."""
    set_attribute("joint[@name='FR_hip_joint']/origin", xyz="0.2 0.3 0")(go2_tree)
    tree = read_tree(as_text(go2_tree))
    with pytest.raises(MorphologyError, match=r"--hips FL FR RL RR, hips=\{'FL': \.\.\., \.\.\.\}"):
        find_legs(tree)
    assert [tree.joints[leg.joints[0]].name for leg in find_legs(tree, HIPS).legs] == list(HIPS.values())


def test_a_foot_is_made_from_the_end_of_the_shank(go2_tree, as_text):
    for leg in ("FL", "FR", "RL", "RR"):
        for path in (f"link[@name='{leg}_foot']", f"joint[@name='{leg}_foot_joint']"):
            remove(path)(go2_tree)
    factory = BodyFactory("mine", as_text(go2_tree))
    assert len(factory.notes) == 4
    assert "'FL_calf_foot': a ball of 12 mm radius is its foot" in factory.notes[0]
    # the shank's box is 24 mm wide and ends 213 mm below the knee
    assert factory.skeleton(np.ones(4)).joint_origin[0, 0, 3].tolist() == pytest.approx([0, 0, -0.213 + 0.012])


def test_thighs_about_a_wrong_axis_have_no_stance(go2_tree, as_text):
    set_attribute("joint[@name='FL_thigh_joint']/axis", xyz="1 0 0")(go2_tree)
    with pytest.raises(MorphologyError, match="thigh and knee joints about y"):
        BodyFactory("mine", as_text(go2_tree)).batch(np.ones((1, 4)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not well-formed"),
        ("", "not well-formed"),
        ("<mujoco/>", "expected <robot>"),
        ('<!DOCTYPE robot SYSTEM "http://127.0.0.1/x.dtd"><robot/>', "DOCTYPE"),
        ('<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>', "DOCTYPE"),
        ("<robot><link/></robot>", "a <link> has no name"),
        ('<robot><link name="a"/><link name="a"/></robot>', "'a' appears twice"),
    ],
)
def test_xml_that_is_not_a_plain_robot_is_refused(text, message):
    with pytest.raises(MorphologyError, match=message):
        read_tree(text, "bad.urdf")


def test_an_external_file_is_not_read(tmp_path):
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    text = f'<!DOCTYPE r [<!ENTITY s SYSTEM "{secret.as_uri()}">]><robot name="x">&s;</robot>'
    with pytest.raises(MorphologyError) as error:
        parse_urdf(text)
    assert "secret" not in str(error.value)
