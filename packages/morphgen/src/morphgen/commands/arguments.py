"""Arguments that every command about a robot shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from numpy.typing import ArrayLike

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.robots import from_urdf, load_robot
from morphgen.scaling.bodies import Rule
from morphgen.scaling.design import BOUNDS, PARAMETERS, SCALE_NAMES, DesignSpace
from morphgen.skeleton import Array
from morphgen.stance.gains import GainRule
from morphgen.urdf.legs import QUARTERS

Scales = tuple[float, float, float, float]
Space = Literal["paper", "per-leg", "wide"]


@dataclass(frozen=True, kw_only=True)
class RobotArguments:
    """Which robot, and how it scales."""

    robot: str = "go2"
    """Built-in robot: go2 or lite3."""
    urdf: Path | None = None
    """Your own URDF, in place of a built-in robot."""
    rule: Rule | None = None
    """How thigh and shank scale: paper (Table II boxes; default of built-in robots), stretch (default of your own
    files), lumped (the motor mass stays at the joint)."""
    gains: Literal["none", "mass", "stance", "inertia"] = "none"
    """How the PD gains follow the body."""
    mesh_path: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder in which meshes and packages are looked for; may be given several times."""
    repair: bool = False
    """Repair impossible inertias instead of refusing them."""
    lock: tuple[str, ...] = ()
    """Joints that are fixed at zero, such as those of an arm."""
    hips: tuple[str, str, str, str] | None = None
    """Hip joints of the front left, front right, rear left and rear right leg, if they are not found by place."""
    kp: float | None = None
    """Stiffness of the servos [N m/rad]; by default 40 for built-in robots, and by weight and height for your own."""
    kd: float | None = None
    """Damping of the servos [N m s/rad]."""
    torque_limit: float | None = None
    """Torque limit of joints whose URDF gives none [N m]."""

    def factory(self, space: DesignSpace | None = None) -> BodyFactory:
        """The robot's factory.

        Raises:
            MorphologyError: the robot cannot be scaled; names file, element and remedy.
        """
        gains = GainRule(self.gains)
        if self.urdf is None:
            factory = load_robot(self.robot, rule=self.rule or "paper", space=space, gains=gains)
        else:
            factory = from_urdf(
                self.urdf,
                rule=self.rule or "stretch",
                space=space,
                gains=gains,
                mesh_paths=self.mesh_path,
                repair=self.repair,
                lock=self.lock,
                hips=None if self.hips is None else dict(zip(QUARTERS, self.hips, strict=True)),
            )
        given = {"kp": self.kp, "kd": self.kd, "torque_limit": self.torque_limit}
        factory.drive = replace(factory.drive, **{name: value for name, value in given.items() if value is not None})
        return factory


@dataclass(frozen=True, kw_only=True)
class BodyArguments(RobotArguments):
    """A robot and one of its bodies."""

    scales: Scales = (1.0, 1.0, 1.0, 1.0)
    """Front thigh, front shank, hind thigh, hind shank."""
    set: tuple[str, ...] = ()
    """Further design parameters as name=value, such as hip_offset=1.2 trunk_length=1.1 fl_thigh=0.9."""

    def body(self) -> tuple[BodyFactory, Array]:
        """The factory, whose space has the four scales and the parameters set, and the design (d,)."""
        values = dict(zip(SCALE_NAMES, self.scales, strict=True)) | parse_parameters(self.set)
        space = space_around(tuple(values), np.array(list(values.values())))
        return self.factory(space), np.array(list(values.values()))


def parse_parameters(assignments: Sequence[str]) -> dict[str, float]:
    """Values of `name=value` pairs.

    Raises:
        MorphologyError: not such a pair, or an unknown name.
    """
    values: dict[str, float] = {}
    for assignment in assignments:
        name, _, number = assignment.partition("=")
        if name not in PARAMETERS:
            raise MorphologyError(f"unknown design parameter '{name}'; known: {', '.join(PARAMETERS)}")
        try:
            values[name] = float(number)
        except ValueError as error:
            raise MorphologyError(f"'{assignment}': expected {name}=number") from error
    return values


def space_around(names: tuple[str, ...], designs: ArrayLike) -> DesignSpace:
    """The parameters' usual bounds, widened to include designs (d,) or (n, d) that are given by hand.

    Raises:
        MorphologyError: a value that is not finite, or a scale that is not positive.
    """
    values = np.atleast_2d(np.asarray(designs, dtype=np.float64))
    if not np.all(np.isfinite(values)):
        raise MorphologyError(f"design parameters must be finite numbers, got {values}")
    return DesignSpace.of(
        **{
            name: (min(BOUNDS[name][0], float(column.min())), max(BOUNDS[name][1], float(column.max())))
            for name, column in zip(names, values.T, strict=True)
        }
    )


def named_space(name: Space, vary: tuple[str, ...] = ()) -> DesignSpace:
    """A design space by its name, or of the parameters `vary` with their usual bounds.

    Raises:
        MorphologyError: an unknown parameter.
    """
    if vary:
        return DesignSpace.of(
            **{parameter: BOUNDS[parameter] for parameter in parse_parameters([f"{v}=1" for v in vary])}
        )
    if name == "wide":
        return DesignSpace.wide()
    return DesignSpace.per_leg() if name == "per-leg" else DesignSpace.leg_scales()
