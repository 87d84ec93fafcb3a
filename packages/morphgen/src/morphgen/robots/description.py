"""Parametric description of a quadruped with box legs, and its URDF."""

from __future__ import annotations

from dataclasses import dataclass

from morphgen.scaling.table2 import box_inertia
from morphgen.urdf.xml import format_vector

LEGS = ("FL", "FR", "RL", "RR")


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], centre of mass [m], inertia about it (ixx, ixy, ixz, iyy, iyz, izz) [kg m^2]; link axes."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]

    def mirrored(self, x: float, y: float) -> Inertial:
        """The mirror image; x or y is -1 to flip that axis, 1 to keep it."""
        ixx, ixy, ixz, iyy, iyz, izz = self.inertia
        com = (self.com[0] * x, self.com[1] * y, self.com[2])
        return Inertial(self.mass, com, (ixx, ixy * x * y, ixz * x, iyy, iyz * y, izz))


@dataclass(frozen=True)
class Segment:
    """A uniform box hanging from its joint (Table II): length L [m], side b of its section [m], mass [kg]."""

    length: float
    width: float
    mass: float


@dataclass(frozen=True)
class JointLimit:
    """Position [rad], torque [N m] and velocity [rad/s] limits of a joint."""

    lower: float
    upper: float
    effort: float
    velocity: float


@dataclass(frozen=True)
class Cylinder:
    """Radius and length [m] of a cylinder, and how far its centre lies outward of the link frame."""

    radius: float
    length: float
    outward: float


@dataclass(frozen=True)
class QuadrupedDescription:
    """A quadruped in FLU axes (x forward, y left, z up), mirror-symmetric left to right.

    Each leg is hip (about +x), thigh (about +y), calf (about +y) and a fixed ball foot.

    Attributes:
        name: the robot.
        base: inertial of the trunk.
        trunk_size: collision box of the trunk [m].
        hip_position: (x, y) of the front-left hip joint in the base frame [m].
        hip_offset: lateral distance from hip joint to thigh joint [m].
        hip: inertial of the front-left hip link; the others are mirror images.
        hip_cylinder: collision cylinder of the hip, its axis along y.
        thigh: upper leg segment.
        shank: lower leg segment.
        foot_mass: mass of the ball foot [kg].
        foot_inertia: moment of inertia of the foot about any axis [kg m^2].
        foot_radius: radius of the foot [m].
        hip_limit: limits of the hip joints.
        front_thigh_limit: limits of the front thigh joints.
        hind_thigh_limit: limits of the hind thigh joints.
        calf_limit: limits of the knees.
        damping: viscous joint friction [N m s/rad].
        friction: dry joint friction [N m].
    """

    name: str
    base: Inertial
    trunk_size: tuple[float, float, float]
    hip_position: tuple[float, float]
    hip_offset: float
    hip: Inertial
    hip_cylinder: Cylinder
    thigh: Segment
    shank: Segment
    foot_mass: float
    foot_inertia: float
    foot_radius: float
    hip_limit: JointLimit
    front_thigh_limit: JointLimit
    hind_thigh_limit: JointLimit
    calf_limit: JointLimit
    damping: float
    friction: float


def build_urdf(robot: QuadrupedDescription) -> str:
    """The URDF of a description; legs in the order FL, FR, RL, RR."""
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f'<robot name="{robot.name}">',
        _link("base", robot.base, f'<box size="{format_vector(robot.trunk_size)}"/>'),
    ]
    for leg in LEGS:
        front = leg[0] == "F"
        x, y = (1.0 if front else -1.0), (1.0 if leg[1] == "L" else -1.0)
        cylinder = robot.hip_cylinder
        hip_joint = (robot.hip_position[0] * x, robot.hip_position[1] * y, 0.0)
        thigh_limit = robot.front_thigh_limit if front else robot.hind_thigh_limit
        parts += [
            _joint(robot, f"{leg}_hip", "base", hip_joint, (1, 0, 0), robot.hip_limit),
            _link(
                f"{leg}_hip",
                robot.hip.mirrored(x, y),
                f'<cylinder radius="{cylinder.radius!r}" length="{cylinder.length!r}"/>',
                f'xyz="{format_vector((0, cylinder.outward * y, 0))}" rpy="{_QUARTER_TURN} 0 0"',
            ),
            _joint(robot, f"{leg}_thigh", f"{leg}_hip", (0, robot.hip_offset * y, 0), (0, 1, 0), thigh_limit),
            _segment(f"{leg}_thigh", robot.thigh),
            _joint(robot, f"{leg}_calf", f"{leg}_thigh", (0, 0, -robot.thigh.length), (0, 1, 0), robot.calf_limit),
            _segment(f"{leg}_calf", robot.shank),
            f'  <joint name="{leg}_foot_joint" type="fixed">\n'
            f'    <origin xyz="{format_vector((0, 0, -robot.shank.length))}"/>\n'
            f'    <parent link="{leg}_calf"/>\n    <child link="{leg}_foot"/>\n  </joint>',
            _link(
                f"{leg}_foot",
                Inertial(robot.foot_mass, (0, 0, 0), _diagonal(robot.foot_inertia, robot.foot_inertia)),
                f'<sphere radius="{robot.foot_radius!r}"/>',
            ),
        ]
    return "\n".join([*parts, "</robot>", ""])


_QUARTER_TURN = repr(1.5707963267948966)


def _diagonal(ixx: float, izz: float) -> tuple[float, float, float, float, float, float]:
    return (ixx, 0.0, 0.0, ixx, 0.0, izz)


def _segment(name: str, segment: Segment) -> str:
    ixx, _, izz = box_inertia(segment.mass, segment.length, segment.width)
    centre = (0.0, 0.0, -segment.length / 2)
    size = format_vector((segment.width, segment.width, segment.length))
    inertial = Inertial(segment.mass, centre, _diagonal(float(ixx), float(izz)))
    return _link(name, inertial, f'<box size="{size}"/>', f'xyz="{format_vector(centre)}"')


def _link(name: str, inertial: Inertial, shape: str, origin: str = 'xyz="0 0 0"') -> str:
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = " ".join(f'{key}="{float(value)!r}"' for key, value in zip(names, inertial.inertia, strict=True))
    lines = [
        f'  <link name="{name}">',
        "    <inertial>",
        f'      <origin xyz="{format_vector(inertial.com)}"/>',
        f'      <mass value="{inertial.mass!r}"/>',
        f"      <inertia {inertia}/>",
        "    </inertial>",
    ]
    for kind in ("visual", "collision"):
        lines += [
            f"    <{kind}>",
            f"      <origin {origin}/>",
            f"      <geometry>{shape}</geometry>",
            f"    </{kind}>",
        ]
    return "\n".join([*lines, "  </link>"])


def _joint(
    robot: QuadrupedDescription,
    child: str,
    parent: str,
    position: tuple[float, float, float],
    axis: tuple[int, int, int],
    limit: JointLimit,
) -> str:
    return "\n".join(
        [
            f'  <joint name="{child}_joint" type="revolute">',
            f'    <origin xyz="{format_vector(position)}"/>',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>',
            f'    <limit lower="{limit.lower!r}" upper="{limit.upper!r}" '
            f'effort="{limit.effort!r}" velocity="{limit.velocity!r}"/>',
            f'    <dynamics damping="{robot.damping!r}" friction="{robot.friction!r}"/>',
            "  </joint>",
        ]
    )
