"""Robots that ship with the package, as parametric descriptions of our own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.robots.description import Cylinder, Inertial, JointLimit, QuadrupedDescription, Segment, build_urdf

_GO2_HIP_AND_THIGH = {"effort": 23.7, "velocity": 30.1}

GO2 = QuadrupedDescription(
    name="go2",
    # the trunk and its two head links of 1 g each
    base=Inertial(
        6.921 + 0.002, (0.021112, 0.0, -0.005366), (0.02448, 1.2166e-4, 1.4849e-3, 0.098077, -3.12e-5, 0.107)
    ),
    trunk_size=(0.3762, 0.0935, 0.114),
    hip_position=(0.1934, 0.0465),
    hip_offset=0.0955,
    hip=Inertial(0.678, (-0.0054, 0.00194, -0.000105), (4.8e-4, -3.01e-6, 1.11e-6, 8.84e-4, -1.42e-6, 5.96e-4)),
    hip_cylinder=Cylinder(radius=0.046, length=0.04, outward=0.08),
    # lengths are the distances between joints; the square sections are our choice
    thigh=Segment(length=0.213, width=0.029, mass=1.152),
    shank=Segment(length=0.213, width=0.024, mass=0.154),
    foot_mass=0.04,
    foot_inertia=9.6e-6,
    foot_radius=0.022,
    hip_limit=JointLimit(-1.0472, 1.0472, **_GO2_HIP_AND_THIGH),
    front_thigh_limit=JointLimit(-1.5708, 3.4907, **_GO2_HIP_AND_THIGH),
    hind_thigh_limit=JointLimit(-0.5236, 4.5379, **_GO2_HIP_AND_THIGH),
    calf_limit=JointLimit(-2.7227, -0.83776, effort=45.43, velocity=15.70),
    damping=0.1,
    friction=0.1,
)
"""Unitree Go2 with box legs: masses, limits and joint positions are the vendor's, the leg inertias are not.

A uniform box puts the thigh's mass at its middle, where the vendor's thigh is mostly motor near the hip, so
the nominal thigh has 2.5 times the vendor's inertia about its joint."""


def go2() -> BodyFactory:
    """Unitree Go2 with box legs."""
    return BodyFactory("go2", build_urdf(GO2))


ROBOTS: Mapping[str, Callable[[], BodyFactory]] = MappingProxyType({"go2": go2})
"""The built-in robots by name."""


def load_robot(name: str) -> BodyFactory:
    """The factory of a built-in robot.

    Raises:
        MorphologyError: unknown name; lists the known ones.
    """
    if name not in ROBOTS:
        raise MorphologyError(f"unknown robot '{name}'; known: {', '.join(ROBOTS)}")
    return ROBOTS[name]()
