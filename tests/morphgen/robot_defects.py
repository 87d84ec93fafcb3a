"""A clean quadruped of own numbers, and what vendors' files do differently as changes to it.

`write("rotors", folder)` writes the changed robot into a folder and gives its path. The changes in `SAME` describe the
clean robot itself in other words; those in `OTHER` make another sound robot; `REPAIRABLE` ones need repair first;
`REFUSED` ones cannot be scaled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import trimesh
from lxml import etree
from trimesh.transformations import euler_from_matrix, euler_matrix

SIDES = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}
THIGH, SHANK, FOOT_RADIUS = 0.22, 0.225, 0.024

Robot = etree._Element
Change = Callable[[Robot, Path], str | None]
"""Edits a robot in place; a change below the level of XML gives the text instead."""


def inertial(mass: float, com: tuple, moments: tuple, products: tuple = (0, 0, 0)) -> str:
    """<inertial> from mass, centre of mass, (ixx, iyy, izz) and (ixy, ixz, iyz)."""
    xyz = " ".join(map(str, com))
    values = dict(zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (*moments, *products), strict=True))
    numbers = " ".join(f'{key}="{value}"' for key, value in values.items())
    return f'<inertial><origin xyz="{xyz}" rpy="0 0 0"/><mass value="{mass}"/><inertia {numbers}/></inertial>'


def shape(tag: str, geometry: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    """<visual> or <collision>."""
    return f'<{tag}><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{geometry}</geometry></{tag}>'


def link(name: str, *content: str) -> str:
    """<link>."""
    return f'<link name="{name}">{"".join(content)}</link>'


def joint(name: str, kind: str, parent: str, child: str, xyz: str = "0 0 0", extra: str = "") -> str:
    """<joint>."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="0 0 0"/>{ends}{extra}</joint>'


def hinge(axis: str, lower: float, upper: float) -> str:
    """Content of an actuated joint."""
    return f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="60" velocity="20"/>'


def clean() -> Robot:
    """Twelve hinges, one inertial and one collision for each link, left and right mirrored."""
    parts = [
        link(
            "trunk",
            inertial(7.5, (0.012, 0, -0.004), (0.03, 0.12, 0.13), (0, 0.001, 0)),
            shape("collision", '<box size="0.42 0.17 0.11"/>'),
        )
    ]
    for leg, (x, y) in SIDES.items():
        hip, thigh, shank, foot = (f"{leg}_{part}" for part in ("hip", "thigh", "shank", "foot"))
        parts += [
            joint(f"{hip}_joint", "revolute", "trunk", hip, f"{0.205 * x} {0.068 * y} 0", hinge("1 0 0", -0.8, 0.8)),
            link(
                hip,
                inertial(0.74, (-0.006 * x, 0.004 * y, 0), (5.2e-4, 8.8e-4, 6.1e-4), (-4e-6 * x * y, 0, 0)),
                shape("collision", '<cylinder radius="0.045" length="0.04"/>', f"0 {0.06 * y} 0", f"{np.pi / 2} 0 0"),
            ),
            joint(f"{thigh}_joint", "revolute", hip, thigh, f"0 {0.094 * y} 0", hinge("0 1 0", -1.2, 3.0)),
            link(
                thigh,
                inertial(
                    1.18,
                    (-0.005, -0.021 * y, -0.038),
                    (0.0062, 0.0061, 0.0011),
                    (7e-5 * y, -2.6e-4, 7e-4 * y),
                ),
                shape("collision", '<box size="0.034 0.025 0.18"/>', "0 0 -0.1"),
            ),
            joint(f"{shank}_joint", "revolute", thigh, shank, f"0 0 {-THIGH}", hinge("0 1 0", -2.7, -0.4)),
            link(
                shank,
                inertial(0.19, (0.006, -0.001 * y, -0.118), (1.25e-3, 1.27e-3, 3.6e-5), (0, 1.6e-5, 0)),
                shape("collision", '<cylinder radius="0.012" length="0.14"/>', "0 0 -0.11"),
            ),
            joint(f"{foot}_joint", "fixed", shank, foot, f"0 0 {-SHANK}"),
            link(
                foot,
                inertial(0.05, (0, 0, 0), (1.152e-5,) * 3),
                shape("collision", f'<sphere radius="{FOOT_RADIUS}"/>'),
            ),
        ]
    return etree.fromstring(f'<robot name="defects">{"".join(parts)}</robot>')


def write(name: str, folder: Path) -> Path:
    """Write the robot with a change (or the clean one) into a folder."""
    robot = clean()
    change = ALL.get(name)
    text = None if name == "clean" else change(robot, folder)
    path = folder / f"{name}.urdf"
    # bytes, as text mode would change the line ends
    path.write_bytes((etree.tostring(robot, encoding="unicode") if text is None else text).encode())
    return path


def find(robot: Robot, tag: str, name: str) -> Robot:
    """A link or joint by name."""
    return robot.find(f"{tag}[@name='{name}']")


def each(robot: Robot, tag: str, end: str) -> Iterator[tuple[Robot, int, int]]:
    """The four links or joints whose name ends so, with the signs of x and y of their leg."""
    for leg, (x, y) in SIDES.items():
        yield find(robot, tag, f"{leg}_{end}"), x, y


def add(parent: Robot, *texts: str) -> None:
    """Append XML."""
    for text in texts:
        parent.append(etree.fromstring(text))


def placement(element: Robot) -> np.ndarray:
    """(4, 4) of an element's <origin>."""
    origin = element.find("origin")
    matrix = euler_matrix(*map(float, origin.get("rpy").split()), axes="sxyz")
    matrix[:3, 3] = [float(x) for x in origin.get("xyz").split()]
    return matrix


def place(element: Robot, matrix: np.ndarray) -> None:
    """Set an element's <origin>."""
    origin = element.find("origin")
    origin.set("xyz", " ".join(map(repr, map(float, matrix[:3, 3]))))
    origin.set("rpy", " ".join(map(repr, map(float, euler_from_matrix(matrix, axes="sxyz")))))


def reframe(robot: Robot, name: str, rotation: tuple[float, float, float]) -> None:
    """Turn a link's frame by roll, pitch and yaw and write everything about it anew; the robot stays the same."""
    matrix = euler_matrix(*rotation, axes="sxyz")
    above = robot.find(f"joint/child[@link='{name}']").getparent()
    place(above, placement(above) @ matrix)
    axis = above.find("axis")
    if axis is not None:
        turned = matrix[:3, :3].T @ np.array([float(x) for x in axis.get("xyz").split()])
        axis.set("xyz", " ".join(map(repr, map(float, turned))))
    owner = find(robot, "link", name)
    below = [end.getparent() for end in robot.findall(f"joint/parent[@link='{name}']")]
    for element in [*owner.findall("inertial"), *owner.findall("visual"), *owner.findall("collision"), *below]:
        place(element, np.linalg.inv(matrix) @ placement(element))


# the same robot in other words


def rotated_frames(robot: Robot, folder: Path) -> None:
    """HyQ: segments along x, hinges about z."""
    for end in ("thigh", "shank"):
        for element, _, _ in each(robot, "link", end):
            reframe(robot, element.get("name"), (np.pi / 2, 0, 0))
    for element, _, _ in each(robot, "link", "thigh"):
        reframe(robot, element.get("name"), (0, 0, -np.pi / 2))


def oblique_frames(robot: Robot, folder: Path) -> None:
    """No axis of any link's frame lies along the leg."""
    for end, angles in {"hip": (0.3, -0.2, 0.5), "thigh": (-0.4, 0.9, 0.1), "shank": (1.1, 0.2, -0.7)}.items():
        for element, _, _ in each(robot, "link", end):
            reframe(robot, element.get("name"), angles)


def fixed_offsets(robot: Robot, folder: Path) -> None:
    """ANYmal C: the distance to the knee lies in a fixed joint; the hinge itself has no offset."""
    for knee, _, _ in each(robot, "joint", "shank_joint"):
        thigh = knee.find("parent").get("link")
        place(knee, np.eye(4))
        knee.find("parent").set("link", f"{thigh}_fixed")
        add(
            robot, link(f"{thigh}_fixed"), joint(f"{thigh}_to_fixed", "fixed", thigh, f"{thigh}_fixed", f"0 0 {-THIGH}")
        )


def fixed_thigh(robot: Robot, folder: Path) -> None:
    """ANYmal C: the hinge moves a link without mass; the thigh is fixed to it, turned by a right angle."""
    for knee, _, _ in each(robot, "joint", "shank_joint"):
        name = knee.find("parent").get("link")
        find(robot, "link", name).set("name", f"{name}_fixed")
        knee.find("parent").set("link", f"{name}_fixed")
        add(robot, link(name), joint(f"{name}_to_fixed", "fixed", name, f"{name}_fixed"))
        reframe(robot, f"{name}_fixed", (0, 0, -np.pi / 2))


def negative_axes(robot: Robot, folder: Path) -> None:
    """Lite3: hinges turn about -x, -y and -y."""
    for hinge_ in robot.findall("joint[@type='revolute']"):
        axis, limit = hinge_.find("axis"), hinge_.find("limit")
        axis.set("xyz", " ".join(str(-float(x)) for x in axis.get("xyz").split()))
        lower, upper = (float(limit.get(key)) for key in ("lower", "upper"))
        limit.set("lower", str(-upper))
        limit.set("upper", str(-lower))


def continuous_joints(robot: Robot, folder: Path) -> None:
    """mini-cheetah: hinges without limits."""
    for hinge_ in robot.findall("joint[@type='revolute']"):
        hinge_.set("type", "continuous")
        hinge_.remove(hinge_.find("limit"))


def floating_root(robot: Robot, folder: Path) -> None:
    """HyQReal 2: an empty link and a floating joint above the trunk."""
    add(robot, link("root"), joint("floating_base", "floating", "root", "trunk"))


def dummy_root(robot: Robot, folder: Path) -> None:
    """Unitree: a root link without mass, fixed to the trunk."""
    add(robot, link("base"), joint("floating_base", "fixed", "base", "trunk"))


def strange_names(robot: Robot, folder: Path) -> None:
    """Names say nothing about the legs, and the legs come in another order."""
    for number, old in enumerate([element.get("name") for element in robot if element.tag == "link"]):
        for element in robot.iter():
            for key, value in element.attrib.items():
                if value == old and key in ("name", "link"):
                    element.set(key, f"body{number}")
    links = robot.findall("link")
    for element in links[5:9]:
        robot.insert(0, element)


def several_materials(robot: Robot, folder: Path) -> None:
    """Go2: several <material> in one <visual>, on which MuJoCo stops; a visual mesh by package://."""
    _save_mesh(folder / "meshes" / "thigh.obj")
    for thigh, _, _ in each(robot, "link", "thigh"):
        add(thigh, shape("visual", '<mesh filename="package://defects_description/meshes/thigh.obj"/>'))
        materials = [f'<material name="m{i}"><color rgba="{i} 0 0 1"/></material>' for i in range(2)]
        add(thigh.find("visual"), *materials)


def extra_tags(robot: Robot, folder: Path) -> None:
    """gazebo, transmission, mujoco, comments and unknown attributes."""
    add(
        robot,
        '<mujoco><compiler meshdir="../meshes/" discardvisual="false"/></mujoco>',
        '<gazebo reference="FL_foot"><mu1>0.6</mu1><kp>1e6</kp></gazebo>',
        '<transmission name="t"><type>transmission_interface/SimpleTransmission</type>'
        '<joint name="FL_hip_joint"><hardwareInterface>EffortJointInterface</hardwareInterface></joint></transmission>',
    )
    find(robot, "link", "FL_foot").append(etree.Comment(" soft sole "))
    find(robot, "joint", "FL_foot_joint").set("dont_collapse", "true")
    add(find(robot, "link", "FL_shank"), "<contact><lateral_friction value='1'/></contact>")


def windows_file(robot: Robot, folder: Path) -> str:
    """A byte order mark, CRLF, names beyond ASCII."""
    add(robot, '<material name="不锈钢"><color rgba="0.7 0.7 0.7 1"/></material>')
    return '\ufeff<?xml version="1.0" encoding="utf-8"?>\r\n' + etree.tostring(
        robot, encoding="unicode", pretty_print=True
    ).replace("><", ">\r\n<")


def massless_links(robot: Robot, folder: Path) -> None:
    """Go2: links with a collision only (MuJoCo would invent their mass), sensors without anything."""
    for shank, _, _ in each(robot, "link", "shank"):
        name = shank.get("name")
        add(
            robot,
            link(f"{name}_lower", shape("collision", '<cylinder radius="0.011" length="0.06"/>', "0.01 0 -0.03")),
            joint(f"{name}_to_lower", "fixed", name, f"{name}_lower", "0 0 -0.12"),
        )
    nothing = inertial(0, (0, 0, 0), (0, 0, 0))
    for name, content in (("imu", ()), ("radar", (nothing,))):
        add(robot, link(name, *content), joint(f"{name}_joint", "fixed", "trunk", name, "-0.02 0 0.03"))


# another, sound robot


def lateral_knee(robot: Robot, folder: Path) -> None:
    """ANYmal B: the knee and the foot lie beside the thigh."""
    for knee, _, y in each(robot, "joint", "shank_joint"):
        knee.find("origin").set("xyz", f"0.01 {0.08 * y} {-THIGH}")


def oblique_foot(robot: Robot, folder: Path) -> None:
    """ANYmal: the foot lies ahead of the shank and inwards of it."""
    for ankle, _, y in each(robot, "joint", "foot_joint"):
        ankle.find("origin").set("xyz", f"0.07 {-0.02 * y} -0.22")
    for shank, _, y in each(robot, "link", "shank"):
        shank.find("collision/origin").set("xyz", f"0.03 {-0.009 * y} -0.1")
        shank.find("collision/origin").set("rpy", f"{-0.09 * y} -0.308 0")


def heavy_foot_link(robot: Robot, folder: Path) -> None:
    """ANYmal C: the foot link's frame is at the ground, its structure reaches up the shank."""
    for foot, _, _ in each(robot, "link", "foot"):
        ball = foot.find("collision")
        foot.remove(foot.find("inertial"))
        foot.remove(ball)
        add(foot, inertial(0.24, (0, 0, 0.12), (9e-4, 9e-4, 2e-5)))
        add(foot, shape("collision", '<cylinder radius="0.012" length="0.16"/>', "0 0 0.1"))
        foot.append(ball)


def rotated_boxes(robot: Robot, folder: Path) -> None:
    """Unitree: the long side of the thigh's box is x, turned down by rpy 0 pi/2 0."""
    for thigh, _, _ in each(robot, "link", "thigh"):
        thigh.find("collision/geometry/box").set("size", "0.18 0.025 0.034")
        thigh.find("collision/origin").set("rpy", "0 1.57079632679 0")


def tilted_cylinders(robot: Robot, folder: Path) -> None:
    """Go2, Lite3: two cylinders for each shank, both leaning."""
    for shank, _, _ in each(robot, "link", "shank"):
        shank.remove(shank.find("collision"))
        add(
            shank,
            shape("collision", '<cylinder radius="0.013" length="0.11"/>', "0.009 0 -0.06", "0 -0.21 0"),
            shape("collision", '<cylinder radius="0.011" length="0.08"/>', "0.012 0 -0.15", "0 0.12 0"),
        )


def rotors(robot: Robot, folder: Path) -> None:
    """Unitree: a motor's rotor as a link fixed to the one that carries it."""
    for end, parent, mass in (("hip", "trunk", 0.08), ("thigh", None, 0.08), ("shank", None, 0.08)):
        for carried, x, y in each(robot, "joint", f"{end}_joint"):
            name = carried.get("name").removesuffix("_joint") + "_rotor"
            on = parent or carried.find("parent").get("link")
            add(
                robot,
                link(name, inertial(mass, (0, 0, 0), (6e-5, 1.1e-4, 6e-5))),
                joint(f"{name}_joint", "fixed", on, name, f"{0.1 * x if on == 'trunk' else 0} {0.02 * y} 0"),
            )


def knee_drive(robot: Robot, folder: Path) -> None:
    """ANYmal C: a heavy drive sits at the knee's end of the thigh, as a link of its own."""
    fixed_offsets(robot, folder)
    for thigh, _, y in each(robot, "link", "thigh_fixed"):
        name = thigh.get("name").replace("thigh_fixed", "KFE_drive")
        add(
            robot,
            link(name, inertial(1.1, (0, 0.03 * y, 0), (1.4e-3, 1.1e-3, 1.4e-3))),
            joint(f"{name}_joint", "fixed", thigh.get("name"), name, f"0 {0.01 * y} 0"),
        )


def point_feet(robot: Robot, folder: Path) -> None:
    """Lite3: the foot has mass and no inertia at all."""
    for foot, _, _ in each(robot, "link", "foot"):
        inertia = foot.find("inertial/inertia")
        for key in inertia.attrib:
            inertia.set(key, "0")


def asymmetric(robot: Robot, folder: Path) -> None:
    """Lite3: the right hips are no mirror image of the left ones (centre of mass 5 mm, inertia 10 % off)."""
    for leg in ("FR", "RR"):
        hip = find(robot, "link", f"{leg}_hip").find("inertial")
        place(hip, placement(hip) + np.diag([0.005], k=3)[:4, :4])
        hip.find("inertia").set("iyy", str(8.8e-4 * 0.9))


def rounded_angles(robot: Robot, folder: Path) -> None:
    """Unitree, HyQ: right angles written as 3.1415 and 1.571."""
    _save_mesh(folder / "meshes" / "thigh.obj")
    for hip, _, y in each(robot, "link", "hip"):
        hip.find("collision/origin").set("rpy", "1.571 0 0" if y > 0 else "-1.571 0 3.1415")
    for thigh, _, y in each(robot, "link", "thigh"):
        thigh.find("collision/geometry/box").set("size", "0.18 0.025 0.034")
        thigh.find("collision/origin").set("rpy", "0 1.571 0")
        rpy = "0 0 0" if y > 0 else "3.1415 0 0"
        add(thigh, shape("visual", '<mesh filename="meshes/thigh.obj"/>', "0 0 0", rpy))


def mirrored_meshes(robot: Robot, folder: Path) -> None:
    """Lite3: the right thigh's meshes are the left one's at scale 1 -1 1; collisions are meshes."""
    _save_mesh(folder / "meshes" / "thigh.obj")
    for thigh, _, y in each(robot, "link", "thigh"):
        thigh.remove(thigh.find("collision"))
        mesh = f'<mesh filename="meshes/thigh.obj" scale="1 {y} 1"/>'
        add(thigh, shape("visual", mesh), shape("collision", mesh))


def no_foot_link(robot: Robot, folder: Path) -> None:
    """The paper's Lite3: the leg ends with the shank, whose ball is a second collision."""
    for shank, _, _ in each(robot, "link", "shank"):
        leg = shank.get("name").removesuffix("_shank")
        for tag, name in (("link", f"{leg}_foot"), ("joint", f"{leg}_foot_joint")):
            robot.remove(find(robot, tag, name))
        add(shank, shape("collision", f'<sphere radius="{FOOT_RADIUS}"/>', f"0 0 {-SHANK}"))


def no_ball(robot: Robot, folder: Path) -> None:
    """The paper's Lite3, older still: the leg ends with a box, and nothing round touches the ground."""
    no_foot_link(robot, folder)
    for shank, _, _ in each(robot, "link", "shank"):
        for collision in shank.findall("collision"):
            shank.remove(collision)
        add(shank, shape("collision", f'<box size="0.04 0.04 {SHANK}"/>', f"0 0 {-SHANK / 2}"))


def mesh_shanks(robot: Robot, folder: Path) -> None:
    """Solo, mini-cheetah: the mesh of the shank encloses the foot."""
    mesh = trimesh.creation.box((0.04, 0.024, SHANK + FOOT_RADIUS))
    mesh.apply_translation((0, 0, -(SHANK + FOOT_RADIUS) / 2))
    mesh.export(folder / "shank.stl")
    for shank, _, _ in each(robot, "link", "shank"):
        shank.remove(shank.find("collision"))
        add(shank, shape("collision", '<mesh filename="shank.stl"/>'))


# needs repair


def invalid_sensor(robot: Robot, folder: Path) -> None:
    """ANYmal C: a camera's moments break the triangle inequality."""
    camera = inertial(0.06, (0, 0, 0), (2e-5, 3e-5, 9e-5))
    add(robot, link("camera", camera), joint("camera_joint", "fixed", "trunk", "camera", "0.2 0 0.05"))


def invalid_shank(robot: Robot, folder: Path) -> None:
    """mini-cheetah: A + B < C on a moving link."""
    for shank, _, _ in each(robot, "link", "shank"):
        shank.find("inertial/inertia").set("iyy", "4e-3")


def indefinite_thigh(robot: Robot, folder: Path) -> None:
    """The released code of the paper: products of inertia that outlive a smaller link."""
    find(robot, "link", "FL_thigh").find("inertial/inertia").set("iyz", "0.004")


def zero_shank(robot: Robot, folder: Path) -> None:
    """A moving link with mass and no inertia."""
    for shank, _, _ in each(robot, "link", "shank"):
        foot = find(robot, "link", f"{shank.get('name')[:2]}_foot")
        foot.remove(foot.find("inertial"))
        inertia = shank.find("inertial/inertia")
        for key in inertia.attrib:
            inertia.set(key, "0")


# cannot be scaled


def no_inertial(robot: Robot, folder: Path) -> None:
    """A moving part without any mass."""
    for name in ("RR_shank", "RR_foot"):
        element = find(robot, "link", name)
        element.remove(element.find("inertial"))


def negative_mass(robot: Robot, folder: Path) -> None:
    """No body has it."""
    find(robot, "link", "FL_hip").find("inertial/mass").set("value", "-0.5")


def nan_mass(robot: Robot, folder: Path) -> None:
    """From a broken export."""
    find(robot, "link", "FL_hip").find("inertial/mass").set("value", "nan")


def five_legs(robot: Robot, folder: Path) -> None:
    """B1 with Z1: an arm on the back."""
    arm = (inertial(0.5, (0, 0, 0.1), (1e-3, 1e-3, 2e-4)), shape("collision", '<box size="0.05 0.05 0.2"/>'))
    parent = "trunk"
    for i in range(3):
        add(robot, link(f"arm{i}", *arm), joint(f"arm{i}_joint", "revolute", parent, f"arm{i}", "0 0 0.1"))
        add(find(robot, "joint", f"arm{i}_joint"), '<axis xyz="0 1 0"/>', '<limit lower="-1" upper="1" effort="9"/>')
        parent = f"arm{i}"


def two_joint_legs(robot: Robot, folder: Path) -> None:
    """Solo 8: no hip joint."""
    for hip, _, _ in each(robot, "joint", "hip_joint"):
        hip.set("type", "fixed")


def wheels(robot: Robot, folder: Path) -> None:
    """Go2-W: the feet turn."""
    for ankle, _, _ in each(robot, "joint", "foot_joint"):
        ankle.set("type", "continuous")
        add(ankle, '<axis xyz="0 1 0"/>')


def xacro(robot: Robot, folder: Path) -> str:
    """unitree_ros: macros that are still to be expanded."""
    text = etree.tostring(robot, encoding="unicode")
    head = '<robot name="defects" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    macro = '<xacro:property name="length" value="0.22"/>'
    return text.replace('<robot name="defects">', head + macro).replace("0 0 -0.22", "0 0 ${-length}")


def entity_bomb(robot: Robot, folder: Path) -> str:
    """A document that grows without bound."""
    entities = "".join(f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(9))
    return f'<!DOCTYPE robot [<!ENTITY a0 "ha">{entities}]>' + etree.tostring(robot, encoding="unicode").replace(
        'name="defects"', 'name="&a9;"'
    )


def absolute_mesh(robot: Robot, folder: Path) -> None:
    """HyQReal: a path on the author's machine."""
    _collision_mesh(robot, "/home/author/meshes/thigh.obj")


def escaping_mesh(robot: Robot, folder: Path) -> None:
    """A path that leaves every folder it may be looked for in."""
    _collision_mesh(robot, "package://defects_description/../../../../../../etc/passwd")


def missing_mesh(robot: Robot, folder: Path) -> None:
    """HyQReal: the named file is not shipped."""
    _collision_mesh(robot, "package://defects_description/meshes/none.stl")


def broken_mesh(robot: Robot, folder: Path) -> None:
    """A file that is no mesh."""
    (folder / "broken.stl").write_text("version https://git-lfs.github.com/spec/v1")
    _collision_mesh(robot, "broken.stl")


def missing_link(robot: Robot, folder: Path) -> None:
    """A joint whose child is gone."""
    robot.remove(find(robot, "link", "RL_shank"))


def prismatic_knee(robot: Robot, folder: Path) -> None:
    """A leg that slides."""
    find(robot, "joint", "FL_shank_joint").set("type", "prismatic")


def _collision_mesh(robot: Robot, file: str) -> None:
    thigh = find(robot, "link", "FL_thigh")
    thigh.remove(thigh.find("collision"))
    add(thigh, shape("collision", f'<mesh filename="{file}"/>'))


def _save_mesh(path: Path) -> None:
    """A thigh without any symmetry, 3 cm to the outside."""
    corners = [(-0.02, 0.0, 0.01), (0.02, 0.0, 0.0), (0.01, 0.03, 0.0), (0.0, 0.01, -0.2), (0.015, 0.02, -0.19)]
    path.parent.mkdir(exist_ok=True)
    trimesh.PointCloud(np.array(corners)).convex_hull.export(path)


def _by_name(*changes: Change) -> dict[str, Change]:
    return {change.__name__: change for change in changes}


SAME = _by_name(
    rotated_frames,
    oblique_frames,
    fixed_offsets,
    fixed_thigh,
    continuous_joints,
    floating_root,
    dummy_root,
    strange_names,
    several_materials,
    extra_tags,
    windows_file,
    massless_links,
)
OTHER = _by_name(
    negative_axes,
    lateral_knee,
    oblique_foot,
    heavy_foot_link,
    rotated_boxes,
    tilted_cylinders,
    rotors,
    knee_drive,
    point_feet,
    asymmetric,
    rounded_angles,
    mirrored_meshes,
    no_foot_link,
    no_ball,
    mesh_shanks,
)
REPAIRABLE = _by_name(invalid_sensor, invalid_shank, indefinite_thigh, zero_shank)
REFUSED = _by_name(
    no_inertial,
    negative_mass,
    nan_mass,
    five_legs,
    two_joint_legs,
    wheels,
    xacro,
    entity_bomb,
    absolute_mesh,
    escaping_mesh,
    missing_mesh,
    broken_mesh,
    missing_link,
    prismatic_knee,
)
ALL = SAME | OTHER | REPAIRABLE | REFUSED
