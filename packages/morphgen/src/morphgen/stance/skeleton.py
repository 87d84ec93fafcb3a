"""The numbers of n quadrupeds with box legs as arrays, read from a URDF once."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from morphgen.errors import MorphologyError
from morphgen.urdf.legs import Leg, LegMap
from morphgen.urdf.xml import named, read_vector

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Skeleton:
    """Geometry, mass and limits of n bodies of one robot; legs in the order of `LegMap`.

    Fields that scaling changes lead with n; the others are shared by all bodies. Joint origins and centres
    of mass are in the frame of the parent link and of the link [m]; all link frames are parallel to the base
    frame at zero joint angles.

    Attributes:
        joint_origin: (n, 4, 4, 3) origins of hip, thigh, knee and ankle joint.
        link_mass: (n, 4, 4) masses of hip, thigh, shank and foot [kg].
        link_com: (n, 4, 4, 3) centres of mass of the same links.
        segment_inertia: (n, 4, 2, 3) principal inertia (ixx, iyy, izz) of thigh and shank [kg m^2].
        segment_box: (n, 4, 2, 3) full box sizes of thigh and shank [m].
        base_mass: mass of the base [kg].
        base_com: (3,) its centre of mass.
        axis: (4, 3, 3) unit axes of hip, thigh and knee.
        foot_radius: (4,) [m].
        lower: (4, 3) joint limits [rad].
        upper: (4, 3) joint limits [rad].
        effort: (4, 3) torque limits [N m].
        velocity: (4, 3) velocity limits [rad/s].
    """

    joint_origin: Array
    link_mass: Array
    link_com: Array
    segment_inertia: Array
    segment_box: Array
    base_mass: float
    base_com: Array
    axis: Array
    foot_radius: Array
    lower: Array
    upper: Array
    effort: Array
    velocity: Array

    @property
    def n(self) -> int:
        """Number of bodies."""
        return self.joint_origin.shape[0]

    @property
    def total_mass(self) -> Array:
        """(n,) [kg]."""
        return self.base_mass + self.link_mass.sum(axis=(1, 2))

    @property
    def segment_length(self) -> Array:
        """(n, 4, 2) joint-to-joint lengths of thigh and shank [m]."""
        return np.linalg.norm(self.joint_origin[:, :, 2:], axis=-1)


def read_skeleton(root: Element, leg_map: LegMap) -> Skeleton:
    """Read one body (n = 1) with box legs from its URDF.

    Raises:
        MorphologyError: an element that Table II cannot describe; names it.
    """
    links, joints = named(root, "link"), named(root, "joint")
    legs = [_read_leg(leg, links, joints) for leg in leg_map.legs]

    def stack(key: str) -> Array:
        return np.stack([leg[key] for leg in legs])

    base_mass, base_com, _ = _read_inertial(links[leg_map.base])
    return Skeleton(
        joint_origin=stack("joint_origin")[None],
        link_mass=stack("link_mass")[None],
        link_com=stack("link_com")[None],
        segment_inertia=stack("segment_inertia")[None],
        segment_box=stack("segment_box")[None],
        base_mass=base_mass,
        base_com=base_com,
        axis=stack("axis"),
        foot_radius=stack("foot_radius"),
        lower=stack("limit")[..., 0],
        upper=stack("limit")[..., 1],
        effort=stack("limit")[..., 2],
        velocity=stack("limit")[..., 3],
    )


def _read_leg(leg: Leg, links: dict[str, Element], joints: dict[str, Element]) -> dict[str, Array]:
    names = (*leg.joints, leg.ankle)
    expected_parents = (None, *leg.links[:3])
    for name, parent in zip(names, expected_parents, strict=True):
        _require_straight(joints[name].find("origin"), f"joint '{name}'")
        found = joints[name].find("parent")
        if parent is not None and (found is None or found.get("link") != parent):
            raise MorphologyError(f"joint '{name}': its parent should be link '{parent}'")
    for name in names[2:]:
        origin = read_vector(joints[name].find("origin"), "xyz", (0, 0, 0), f"joint '{name}'")
        if origin[:2].any() or origin[2] >= 0:
            raise MorphologyError(f"joint '{name}': Table II needs its origin straight below, at (0, 0, -length)")
    inertials = [_read_inertial(links[name]) for name in leg.links]
    return {
        "joint_origin": np.stack(
            [read_vector(joints[name].find("origin"), "xyz", (0, 0, 0), f"joint '{name}'") for name in names]
        ),
        "link_mass": np.array([mass for mass, _, _ in inertials]),
        "link_com": np.stack([com for _, com, _ in inertials]),
        "segment_inertia": np.stack([inertia[[0, 3, 5]] for _, _, inertia in inertials[1:3]]),
        "segment_box": np.stack([read_box(links[name]) for name in leg.links[1:3]]),
        "axis": np.stack([_read_axis(joints[name], name) for name in leg.joints]),
        "foot_radius": _read_foot_radius(links[leg.links[3]]),
        "limit": np.stack([_read_limit(joints[name], name) for name in leg.joints]),
    }


def read_box(link: Element) -> Array:
    """(3,) size of the one upright collision box of square section that Table II asks of thigh and shank."""
    name = link.get("name")
    collisions = link.findall("collision")
    box = collisions[0].find("geometry/box") if len(collisions) == 1 else None
    if box is None:
        raise MorphologyError(f"link '{name}': Table II scaling needs exactly one collision, a box along z")
    _require_straight(collisions[0].find("origin"), f"link '{name}' collision")
    size = read_vector(box, "size", (0, 0, 0), f"link '{name}' collision box")
    if not np.all(size > 0) or size[0] != size[1]:
        raise MorphologyError(f"link '{name}': its collision box needs a square section (b, b, L), got {size}")
    return size


def _read_inertial(link: Element) -> tuple[float, Array, Array]:
    where = f"link '{link.get('name')}'"
    inertial = link.find("inertial")
    if inertial is None:
        raise MorphologyError(f"{where}: has no <inertial>")
    _require_straight(inertial.find("origin"), f"{where} inertial")
    com = read_vector(inertial.find("origin"), "xyz", (0, 0, 0), f"{where} inertial")
    mass = float(read_vector(inertial.find("mass"), "value", (0,), f"{where} mass")[0])
    element = inertial.find("inertia")
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    inertia = np.concatenate([read_vector(element, key, (0,), f"{where} inertia") for key in names])
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    principal = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    if mass <= 0 or principal[0] <= 0 or principal[0] + principal[1] < principal[2] * (1 - 1e-6):
        raise MorphologyError(
            f"{where}: mass {mass:g} with principal inertia {principal} is not that of a rigid body; "
            "all must be positive and the two smaller moments must add up to the largest at least"
        )
    return mass, com, inertia


def _read_axis(joint: Element, name: str) -> Array:
    axis = read_vector(joint.find("axis"), "xyz", (1, 0, 0), f"joint '{name}' axis")
    length = float(np.linalg.norm(axis))
    if length == 0:
        raise MorphologyError(f"joint '{name}': its axis is zero")
    return axis / length


def _read_limit(joint: Element, name: str) -> Array:
    limit = joint.find("limit")
    keys = ("lower", "upper", "effort", "velocity")
    if limit is None or any(limit.get(key) is None for key in keys):
        raise MorphologyError(f"joint '{name}': needs a <limit> with {', '.join(keys)}")
    return np.concatenate([read_vector(limit, key, (0,), f"joint '{name}' limit") for key in keys])


def _read_foot_radius(link: Element) -> Array:
    where = f"link '{link.get('name')}'"
    collisions = link.findall("collision")
    offset = read_vector(collisions[0].find("origin"), "xyz", (0, 0, 0), where)
    if len(collisions) != 1 or offset.any():
        raise MorphologyError(f"{where}: the foot needs exactly one collision, a sphere at its origin")
    radius = read_vector(collisions[0].find("geometry/sphere"), "radius", (0,), where)[0]
    if radius <= 0:
        raise MorphologyError(f"{where}: the foot's radius must be positive")
    return np.array(radius)


def _require_straight(origin: Element | None, where: str) -> None:
    if read_vector(origin, "rpy", (0, 0, 0), where).any():
        raise MorphologyError(f"{where}: a rotated origin (rpy) is not supported by Table II scaling")
