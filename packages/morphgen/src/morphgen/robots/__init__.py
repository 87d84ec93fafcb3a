"""Robots that ship with the package, as parametric descriptions of our own."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.robots.description import QuadrupedDescription, build_urdf
from morphgen.robots.go2 import GO2
from morphgen.robots.lite3 import LITE3
from morphgen.scaling.bodies import Rule
from morphgen.scaling.design import DesignSpace
from morphgen.simulation.drive import Drive
from morphgen.stance.gains import GainRule

__all__ = ["GO2", "LITE3", "ROBOTS", "build_urdf", "from_urdf", "go2", "lite3", "load_robot"]


def go2() -> BodyFactory:
    """Unitree Go2 with box legs: nominal thighs have 2.5 times the vendor's inertia about their joint."""
    return _factory(GO2)


def lite3() -> BodyFactory:
    """DeepRobotics Lite3 with box legs: nominal thighs have 2.1 times the vendor's inertia about their joint."""
    return _factory(LITE3)


ROBOTS: Mapping[str, QuadrupedDescription] = MappingProxyType({robot.name: robot for robot in (GO2, LITE3)})
"""The built-in robots by name."""


def load_robot(
    name: str, *, rule: Rule = "paper", space: DesignSpace | None = None, gains: GainRule | None = None
) -> BodyFactory:
    """The factory of a built-in robot.

    Args:
        name: of the robot.
        rule: `paper` gives it box legs, the others start from the vendor's inertias.
        space: None for the four leg scales.
        gains: None for constant gains.

    Raises:
        MorphologyError: unknown name; lists the known ones.
    """
    if name not in ROBOTS:
        raise MorphologyError(f"unknown robot '{name}'; known: {', '.join(ROBOTS)}")
    return _factory(ROBOTS[name], rule, space, gains)


def from_urdf(
    path: Path,
    *,
    rule: Rule = "stretch",
    space: DesignSpace | None = None,
    gains: GainRule | None = None,
    drive: Drive | None = None,
    mesh_paths: Sequence[Path] = (),
    repair: bool = False,
    lock: Collection[str] = (),
    hips: Mapping[str, str] | None = None,
) -> BodyFactory:
    """The factory of a robot of your own; arguments as for `BodyFactory`.

    Raises:
        MorphologyError: the file is not a quadruped that can be scaled; names file, element and remedy.
        OSError: it cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise MorphologyError(f"{path}: is not UTF-8 text ({error}); save it as UTF-8") from error
    return BodyFactory(
        path.stem,
        text,
        space=space,
        rule=rule,
        gains=gains,
        drive=drive,
        source=path,
        mesh_paths=mesh_paths,
        repair=repair,
        lock=lock,
        hips=hips,
    )


def _factory(
    robot: QuadrupedDescription,
    rule: Rule = "paper",
    space: DesignSpace | None = None,
    gains: GainRule | None = None,
) -> BodyFactory:
    drive = Drive(armature=robot.armature, damping=robot.damping, friction=robot.friction)
    text = build_urdf(robot, "box" if rule == "paper" else "vendor")
    return BodyFactory(robot.name, text, space=space, rule=rule, gains=gains, drive=drive)
