"""Everything that `morphgen inspect` says about a robot, as plain data."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class LinkFinding:
    """A link as it is in the file.

    Attributes:
        name: of the link.
        part: what it belongs to, such as `trunk` or `FL thigh`; empty where no legs were found.
        mass: [kg]; None without an <inertial>.
        com: centre of mass in the link frame [m].
        moments: principal moments of inertia, ascending [kg m^2].
        problem: why no rigid body has this inertia.
        collisions: number of collision shapes.
        visuals: number of visual shapes.
        stretched: whether it stretches when its part is scaled; False for what is only moved.
    """

    name: str
    part: str
    mass: float | None
    com: tuple[float, ...] | None
    moments: tuple[float, ...] | None
    problem: str | None
    collisions: int
    visuals: int
    stretched: bool


@dataclass(frozen=True)
class JointFinding:
    """A moving joint.

    Attributes:
        name: of the joint.
        kind: revolute, continuous, prismatic or floating.
        lower: limit [rad], None without one.
        upper: limit [rad], None without one.
        effort: torque limit [N m], None without one.
        velocity: velocity limit [rad/s], None without one.
        missing: which of `limits`, `effort`, `velocity` a simulator would have to be told.
    """

    name: str
    kind: str
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None
    missing: tuple[str, ...]


@dataclass(frozen=True)
class LegFinding:
    """A leg, found by topology.

    Attributes:
        name: FL, FR, RL or RR.
        joints: hip, thigh and knee joint.
        links: links of hip, thigh, shank (without the foot) and foot.
        hip_offset: distance from hip joint to thigh joint [m].
        thigh: length from thigh joint to knee, normal to the hinge [m].
        shank: length from knee to foot centre, normal to the hinge [m].
        reach: least and largest distance of the foot centre from the thigh joint's axis, within the knee's
            limits [m].
        foot_radius: of the ball [m].
    """

    name: str
    joints: tuple[str, ...]
    links: tuple[tuple[str, ...], ...]
    hip_offset: float
    thigh: float
    shank: float
    reach: tuple[float, float]
    foot_radius: float


@dataclass(frozen=True)
class MeshFinding:
    """A mesh file.

    Attributes:
        name: as written in the URDF.
        links: that use it.
        collision: whether it is a collision and not only a picture.
        path: of the file; None if it cannot be used.
        problem: why not.
    """

    name: str
    links: tuple[str, ...]
    collision: bool
    path: str | None
    problem: str | None


@dataclass(frozen=True)
class Asymmetry:
    """A right leg that is no mirror image of the left one, or a trunk that leans to one side.

    Attributes:
        part: such as `front hip`, `hind thigh` or `trunk`.
        quantity: what differs.
        difference: how much.
        unit: mm, or % of the left leg's value.
    """

    part: str
    quantity: str
    difference: float
    unit: str


@dataclass(frozen=True)
class Inspection:
    """What is in a URDF. Lists are empty where the file could not be read that far.

    Attributes:
        file: its path.
        robot: name in the file.
        total_mass: sum over all links [kg].
        hip_height: of the thigh joints above the floor in the nominal stance [m]; None without a sound one.
        links: every link.
        joints: every moving joint.
        legs: the four legs.
        meshes: every mesh file named.
        asymmetries: left against right.
        missing_inertials: links with a shape and without an <inertial>.
        collision_only: those of them that have a collision; simulators that invent mass do so here.
        carried: links with mass that are moved and not stretched: rotors, drives, sensors.
        repaired: what had to be repaired or replaced, a sentence each.
        refused: why the robot cannot be scaled, a sentence each, with the remedy.
    """

    file: str
    robot: str = ""
    total_mass: float = 0.0
    hip_height: float | None = None
    links: tuple[LinkFinding, ...] = ()
    joints: tuple[JointFinding, ...] = ()
    legs: tuple[LegFinding, ...] = ()
    meshes: tuple[MeshFinding, ...] = ()
    asymmetries: tuple[Asymmetry, ...] = ()
    missing_inertials: tuple[str, ...] = ()
    collision_only: tuple[str, ...] = ()
    carried: tuple[str, ...] = ()
    repaired: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()

    @property
    def scalable(self) -> bool:
        """Whether nothing was refused."""
        return not self.refused

    def to_json(self) -> dict[str, Any]:
        """The fields and `scalable`, ready for `json.dumps`; infinite numbers become None."""
        return {"scalable": self.scalable, **_finite(asdict(self))}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
