"""Robots that ship with the package, as parametric descriptions of our own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.robots.description import QuadrupedDescription, build_urdf
from morphgen.robots.go2 import GO2
from morphgen.robots.lite3 import LITE3
from morphgen.simulation.model import Drive

__all__ = ["GO2", "LITE3", "ROBOTS", "build_urdf", "go2", "lite3", "load_robot"]


def go2() -> BodyFactory:
    """Unitree Go2 with box legs: nominal thighs have 2.5 times the vendor's inertia about their joint."""
    return _factory(GO2)


def lite3() -> BodyFactory:
    """DeepRobotics Lite3 with box legs: nominal thighs have 2.1 times the vendor's inertia about their joint."""
    return _factory(LITE3)


ROBOTS: Mapping[str, Callable[[], BodyFactory]] = MappingProxyType({"go2": go2, "lite3": lite3})
"""The built-in robots by name."""


def load_robot(name: str) -> BodyFactory:
    """The factory of a built-in robot.

    Raises:
        MorphologyError: unknown name; lists the known ones.
    """
    if name not in ROBOTS:
        raise MorphologyError(f"unknown robot '{name}'; known: {', '.join(ROBOTS)}")
    return ROBOTS[name]()


def _factory(robot: QuadrupedDescription) -> BodyFactory:
    drive = Drive(armature=robot.armature, damping=robot.damping, friction=robot.friction)
    return BodyFactory(robot.name, build_urdf(robot), drive=drive)
