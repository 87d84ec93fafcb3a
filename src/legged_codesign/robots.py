"""The robots that a run can start from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from locorl.providers import find_factory, is_file
from morphgen import BodyFactory, DesignSpace, GainRule, Rule, from_urdf, load_robot
from morphgen.robots import ROBOTS
from morphgen.stance.gains import GainKind
from morphgen.urdf.legs import QUARTERS

SpaceName = Literal["legs", "per-leg", "wide"]


@dataclass(frozen=True)
class FileConfig:
    """How the URDF at a path is opened, where the file alone does not say enough."""

    mesh_paths: tuple[str, ...] = ()
    """Folders in which its meshes and packages are looked for."""
    repair: bool = False
    """Repair impossible inertias instead of refusing them."""
    lock: tuple[str, ...] = ()
    """Joints that are fixed at zero, such as those of an arm."""
    hips: tuple[str, ...] = ()
    """Hip joints of the front left, front right, rear left and rear right leg; empty: found by place."""
    torque_limit: float | None = None
    """Of joints for which the file gives none, N m."""
    kp: float | None = None
    """Stiffness of the servos, N m/rad; None: by weight and height."""
    kd: float | None = None
    """Damping of the servos, N m s/rad; None: by weight and height."""

    def __post_init__(self) -> None:
        """Refuse hips that are not four."""
        if len(self.hips) not in (0, len(QUARTERS)):
            raise ValueError(
                f"FileConfig.hips names {len(self.hips)} joints; name one for each of {', '.join(QUARTERS)}"
            )


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
    file: FileConfig = field(default_factory=FileConfig)
    """Of a robot that is given by the path of a URDF."""

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
    if is_file(robot) and Path(robot).is_file():
        return _from_file(Path(robot), bodies, space, gains)
    if bodies.file != FileConfig():
        find_factory(robot)  # says whether it is there at all
        raise LookupError(
            f"robot '{robot}' is no file: where meshes lie, repairs, locked joints, hips, torque limit and servo gains "
            "can be chosen for the path of a .urdf"
        )
    if robot not in ROBOTS:
        find_factory(robot)
        raise LookupError(
            f"robot '{robot}' comes with its own rule, design space and gains; they can be chosen for a .urdf and for "
            f"{', '.join(ROBOTS)}"
        )
    return load_robot(robot, rule=bodies.rule or "paper", space=space, gains=gains)


def _from_file(path: Path, bodies: BodyConfig, space: DesignSpace, gains: GainRule) -> BodyFactory:
    file = bodies.file
    factory = from_urdf(
        path,
        rule=bodies.rule or "stretch",
        space=space,
        gains=gains,
        mesh_paths=[Path(folder) for folder in file.mesh_paths],
        repair=file.repair,
        lock=file.lock,
        hips=dict(zip(QUARTERS, file.hips, strict=True)) if file.hips else None,
    )
    drive = {"kp": file.kp, "kd": file.kd, "torque_limit": file.torque_limit}
    # the rest of it was sized to the robot
    factory.drive = replace(factory.drive, **{name: value for name, value in drive.items() if value is not None})
    return factory


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
