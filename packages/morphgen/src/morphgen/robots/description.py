"""Parametric description of a quadruped, and its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from morphgen.urdf.xml import format_vector

Vector = tuple[float, float, float]
HIP, THIGH, SHANK, FOOT = range(4)


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], centre of mass [m], inertia about it (ixx, ixy, ixz, iyy, iyz, izz) [kg m^2]; link axes."""

    mass: float
    com: Vector
    inertia: tuple[float, float, float, float, float, float]

    def mirrored(self, x: float, y: float) -> Inertial:
        """The mirror image; x or y is -1 to flip that axis, 1 to keep it."""
        ixx, ixy, ixz, iyy, iyz, izz = self.inertia
        com = (self.com[0] * x, self.com[1] * y, self.com[2])
        return Inertial(self.mass, com, (ixx, ixy * x * y, ixz * x, iyy, iyz * y, izz))


@dataclass(frozen=True)
class Box:
    """A box parallel to the axes of its link: full sides and centre [m]."""

    size: Vector
    centre: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Cylinder:
    """Radius and length [m] of a cylinder along y, and how far its centre lies outward of the link frame."""

    radius: float
    length: float
    outward: float


@dataclass(frozen=True)
class Ball:
    """The foot: mass [kg], radius [m], moment of inertia about any axis [kg m^2]."""

    mass: float
    radius: float
    inertia: float


@dataclass(frozen=True)
class Segment:
    """Thigh or shank: the vendor's link, and the uniform box of Table II with the same mass.

    Attributes:
        length: distance from its joint straight down to the next, which is the box's length L too [m].
        width: side b of the box's square section [m].
        vendor: inertial of the vendor's left link.
    """

    length: float
    width: float
    vendor: Inertial

    @property
    def box(self) -> Box:
        """The box, hanging from the joint."""
        return Box((self.width, self.width, self.length), (0.0, 0.0, -self.length / 2))

    @property
    def box_inertial(self) -> Inertial:
        """Inertial of the uniform box (Table II at scale 1)."""
        mass = self.vendor.mass
        swing, twist = mass / 12 * (self.width**2 + self.length**2), mass * self.width**2 / 6
        return Inertial(mass, self.box.centre, (swing, 0.0, 0.0, swing, 0.0, twist))


@dataclass(frozen=True)
class Hinge:
    """A kind of joint, the same on all legs but for its range.

    Attributes:
        axis: of rotation, in base axes.
        front: lower and upper limit on the front legs [rad].
        hind: lower and upper limit on the hind legs [rad].
        effort: torque limit [N m].
        velocity: velocity limit [rad/s].
    """

    axis: tuple[int, int, int]
    front: tuple[float, float]
    hind: tuple[float, float]
    effort: float
    velocity: float


@dataclass(frozen=True)
class VendorControl:
    """How the vendor's own software addresses the joints and makes the robot stand.

    Attributes:
        legs: order of the legs in joint vectors; within a leg hip, thigh, knee.
        stand: angles of hip, thigh and knee [rad].
        kp: stiffness that holds it [N m/rad].
        kd: damping that holds it [N m s/rad].
    """

    legs: tuple[str, str, str, str]
    stand: Vector
    kp: float
    kd: float


@dataclass(frozen=True)
class QuadrupedDescription:
    """A quadruped in FLU axes (x forward, y left, z up), legs ordered front left, front right, rear left, rear right.

    Each leg is hip, thigh, shank and a fixed ball foot. Joints and collision shapes are mirror images, and so are
    thighs and shanks; the hips' inertials need not be.

    Attributes:
        name: the robot.
        base: name of the trunk link.
        legs: names of the legs.
        links: what follows a leg's name in those of hip, thigh, shank and foot link.
        joints: what follows a leg's name in those of hip, thigh, knee and (fixed) foot joint.
        trunk: inertial of the trunk.
        trunk_boxes: collision boxes of the trunk.
        hip_position: (x, y) of the front-left hip joint in the base frame [m].
        hip_offset: lateral distance from hip joint to thigh joint [m].
        hips: inertials of the four hip links.
        hip_cylinder: collision cylinder of the hip.
        thigh: upper leg segment.
        shank: lower leg segment.
        foot: the ball.
        hinges: hip, thigh and knee joint.
        armature: inertia of the rotor as the joint feels it [kg m^2].
        damping: viscous joint friction [N m s/rad].
        friction: dry joint friction [N m].
        control: the vendor's conventions.
    """

    name: str
    base: str
    legs: tuple[str, str, str, str]
    links: tuple[str, str, str, str]
    joints: tuple[str, str, str, str]
    trunk: Inertial
    trunk_boxes: tuple[Box, ...]
    hip_position: tuple[float, float]
    hip_offset: float
    hips: tuple[Inertial, Inertial, Inertial, Inertial]
    hip_cylinder: Cylinder
    thigh: Segment
    shank: Segment
    foot: Ball
    hinges: tuple[Hinge, Hinge, Hinge]
    armature: float
    damping: float
    friction: float
    control: VendorControl

    @property
    def vendor_joints(self) -> tuple[str, ...]:
        """The 12 actuated joints in the order of the vendor's software."""
        return tuple(leg + joint for leg in self.control.legs for joint in self.joints[:3])


def mirrored_hips(front_left: Inertial) -> tuple[Inertial, Inertial, Inertial, Inertial]:
    """Hips that are mirror images of the front left one."""
    return front_left, front_left.mirrored(1, -1), front_left.mirrored(-1, 1), front_left.mirrored(-1, -1)


def build_urdf(robot: QuadrupedDescription, legs: Literal["box", "vendor"] = "box") -> str:
    """The URDF of a description.

    Args:
        robot: the description.
        legs: whose mass distribution thighs and shanks have: the uniform boxes of Table II, or the vendor's links
            (the right ones mirrored). Masses, joints and collision boxes are the same.
    """
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f'<robot name="{robot.name}">',
        _link(robot.base, robot.trunk, [_box(box) for box in robot.trunk_boxes]),
        *(part for leg in range(4) for part in _leg(robot, leg, legs == "box")),
        "</robot>",
        "",
    ]
    return "\n".join(parts)


_QUARTER_TURN = repr(1.5707963267948966)


def _leg(robot: QuadrupedDescription, leg: int, boxes: bool) -> list[str]:
    x, y = (1.0, 1.0, -1.0, -1.0)[leg], (1.0, -1.0, 1.0, -1.0)[leg]
    links = [robot.legs[leg] + name for name in robot.links]
    parents = [robot.base, *links]
    cylinder, foot = robot.hip_cylinder, robot.foot
    positions = (
        (robot.hip_position[0] * x, robot.hip_position[1] * y, 0.0),
        (0.0, robot.hip_offset * y, 0.0),
        (0.0, 0.0, -robot.thigh.length),
        (0.0, 0.0, -robot.shank.length),
    )
    hip_shape = (
        f'xyz="{format_vector((0, cylinder.outward * y, 0))}" rpy="{_QUARTER_TURN} 0 0"',
        f'<cylinder radius="{cylinder.radius!r}" length="{cylinder.length!r}"/>',
    )
    segments = [
        _link(
            links[part],
            segment.box_inertial if boxes else segment.vendor.mirrored(1, y),
            [_box(segment.box)],
        )
        for part, segment in ((THIGH, robot.thigh), (SHANK, robot.shank))
    ]
    ball = Inertial(foot.mass, (0, 0, 0), (foot.inertia, 0, 0, foot.inertia, 0, foot.inertia))
    bodies = [
        _link(links[HIP], robot.hips[leg], [hip_shape]),
        *segments,
        _link(links[FOOT], ball, [('xyz="0 0 0"', f'<sphere radius="{foot.radius!r}"/>')]),
    ]
    joints = [
        _joint(robot, part, robot.legs[leg], parents[part], links[part], positions[part], front=x > 0)
        for part in range(4)
    ]
    return [text for pair in zip(joints, bodies, strict=True) for text in pair]


def _box(box: Box) -> tuple[str, str]:
    centre = format_vector(box.centre) if any(box.centre) else "0 0 0"
    return f'xyz="{centre}"', f'<box size="{format_vector(box.size)}"/>'


def _link(name: str, inertial: Inertial, shapes: list[tuple[str, str]]) -> str:
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{key}="{format_vector([value])}"' for key, value in zip(names, inertial.inertia, strict=True))
    lines = [
        f'  <link name="{name}">',
        "    <inertial>",
        f'      <origin xyz="{format_vector(inertial.com)}"/>',
        f'      <mass value="{inertial.mass!r}"/>',
        f"      <inertia {inertia}/>",
        "    </inertial>",
    ]
    for kind in ("visual", "collision"):
        for origin, shape in shapes:
            lines += [
                f"    <{kind}>",
                f"      <origin {origin}/>",
                f"      <geometry>{shape}</geometry>",
                f"    </{kind}>",
            ]
    return "\n".join([*lines, "  </link>"])


def _joint(
    robot: QuadrupedDescription, part: int, leg: str, parent: str, child: str, position: Vector, *, front: bool
) -> str:
    kind = "fixed" if part == FOOT else "revolute"
    lines = [
        f'  <joint name="{leg}{robot.joints[part]}" type="{kind}">',
        f'    <origin xyz="{format_vector(position)}"/>',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
    ]
    if part != FOOT:
        hinge = robot.hinges[part]
        lower, upper = hinge.front if front else hinge.hind
        lines += [
            f'    <axis xyz="{" ".join(map(str, hinge.axis))}"/>',
            f'    <limit lower="{lower!r}" upper="{upper!r}" effort="{hinge.effort!r}" velocity="{hinge.velocity!r}"/>',
            f'    <dynamics damping="{robot.damping!r}" friction="{robot.friction!r}"/>',
        ]
    return "\n".join([*lines, "  </joint>"])
