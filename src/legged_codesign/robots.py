"""The robots that a run can start from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from locorl.providers import find_factory, is_file
from morphgen import BodyFactory, DesignSpace, GainRule, Rule, from_urdf, load_robot
from morphgen.robots import ROBOTS
from morphgen.stance.gains import GainKind

SpaceName = Literal["legs", "per-leg", "wide"]


@dataclass(frozen=True)
class BodyConfig:
    """How bodies follow from designs; None keeps what the robot's package has chosen."""

    rule: Rule | None = None
    """Scaling of thigh and shank: paper (Table II, box legs), stretch or lumped."""
    space: SpaceName = "legs"
    """legs: the paper's four scales. per-leg: eight, each leg by itself. wide: also hip offset, trunk, masses, feet."""
    gains: GainKind = "none"
    """How PD gains follow the body (eta_j of section IV-A2); none: they do not."""
    coefficients: tuple[float, ...] = ()
    """Of the gain rule `polynomial`."""

    @property
    def untouched(self) -> bool:
        """Whether nothing is chosen here."""
        return self == BodyConfig()


def body_factory(robot: str, bodies: BodyConfig | None = None) -> BodyFactory:
    """The factory of an installed robot (entry point group `legged.bodies`), or of the URDF at a path.

    Raises:
        LookupError: no installed package knows the robot, its factory cannot write URDFs, or it does not take what
            `bodies` asks for.
        FileNotFoundError: there is no such file.
    """
    bodies = bodies or BodyConfig()
    if not bodies.untouched:
        return _chosen(robot, bodies)
    factory = find_factory(robot)
    if not isinstance(factory, BodyFactory):
        raise LookupError(
            f"robot '{robot}' comes from {type(factory).__module__}, which is no morphgen.BodyFactory: "
            "a run needs one to write URDFs, drawings and bundles"
        )
    return factory


def _chosen(robot: str, bodies: BodyConfig) -> BodyFactory:
    """A robot whose rule, design space or gains are chosen here."""
    space = _SPACES[bodies.space]
    gains = GainRule(bodies.gains, bodies.coefficients)
    if is_file(robot):
        find_factory(robot)  # says what is missing
        return from_urdf(Path(robot), rule=bodies.rule or "stretch", space=space, gains=gains)
    if robot not in ROBOTS:
        find_factory(robot)
        raise LookupError(
            f"robot '{robot}' comes with its own rule, design space and gains; they can be chosen for a .urdf and for "
            f"{', '.join(ROBOTS)}"
        )
    return load_robot(robot, rule=bodies.rule or "paper", space=space, gains=gains)


_SPACES: Mapping[SpaceName, DesignSpace] = {
    "legs": DesignSpace.leg_scales(),
    "per-leg": DesignSpace.per_leg(),
    "wide": DesignSpace.wide(),
}


def absolute(robot: str) -> str:
    """The robot as a run keeps it: a name as it is, a path so that it means the same file from everywhere."""
    return str(Path(robot).resolve()) if is_file(robot) else robot


def short_name(robot: str) -> str:
    """The robot in the name of a run folder: a path's last part, without `.urdf`."""
    return Path(robot).stem if is_file(robot) else robot


def file_hash(robot: str) -> str | None:
    """SHA-256 of the robot's file; None for an installed robot.

    Raises:
        FileNotFoundError: there is no such file.
    """
    return hashlib.sha256(Path(robot).read_bytes()).hexdigest() if is_file(robot) else None
