"""What a bundle says about the robot and the policy's interface, as plain data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Literal, TypeAlias

from distill.errors import BundleError
from distill.interfaces import ACTIONS

Source: TypeAlias = Literal[
    "base_angular_velocity",
    "projected_gravity",
    "command",
    "joint_position_error",
    "joint_velocity",
    "last_action",
    "roll_pitch",
    "heading_error",
    "next_heading_error",
    "commanded_speed",
    "foot_contact",
]

SOURCE_SIZES: Mapping[Source, int] = {
    "base_angular_velocity": 3,
    "projected_gravity": 3,
    "command": 3,
    "joint_position_error": ACTIONS,
    "joint_velocity": ACTIONS,
    "last_action": ACTIONS,
    "roll_pitch": 2,
    "heading_error": 1,
    "next_heading_error": 1,
    "commanded_speed": 1,
    "foot_contact": 4,
}
"""Elements of each observation source."""

HEADINGS: tuple[Source, ...] = ("heading_error", "next_heading_error")
"""Sources that no sensor gives: a seeing policy predicts them, and does not read them."""


@dataclass(frozen=True)
class CameraSpec:
    """The depth camera that a policy was trained with.

    An image is made of the sensor's by cropping and resizing, so the intrinsics are those of the image, px; pixel
    (row i, column j) looks through (j + 0.5, i + 0.5).
    """

    position: tuple[float, float, float]
    """In the base frame, m."""
    pitch: tuple[float, float]
    """Trained range of the mount's pitch, rad; positive looks down."""
    fx: float
    fy: float
    cx: float
    cy: float
    near: float
    """Depths below are clipped to this, m."""
    far: float
    """Depths above, and pixels without a measurement, read this, m."""
    raw_size: tuple[int, int]
    """Rows and columns of the sensor."""
    crop_bottom: int = 0
    """Rows of the sensor that the image leaves out below."""
    crop_sides: int = 0
    """Columns of the sensor that the image leaves out on the left, and as many on the right."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.near < self.far or min(self.fx, self.fy) <= 0.0:
            raise BundleError(f"camera: need 0 <= near < far and fx, fy > 0, got {self}")


@dataclass(frozen=True)
class JointSpec:
    """One actuated joint; angles in rad, torques in N m, rates in rad/s."""

    name: str
    actuator: str
    """Name of its actuator in the MJCF."""
    stance: float
    """Joint angle of the stance."""
    target_offset: float
    """Servo target that holds the stance against gravity."""
    kp: float
    """N m/rad."""
    kd: float
    """N m s/rad."""
    torque_limit: float
    lower: float
    upper: float
    velocity_limit: float | None = None


@dataclass(frozen=True)
class ObservationTerm:
    """A slice of the proprioception: `scale * source`; terms are concatenated in order."""

    name: str
    source: Source
    scale: float | tuple[float, ...] = 1.0
    """One factor, or one per element."""
    frame: str = ""
    unit: str = ""

    @property
    def size(self) -> int:
        """Elements of the term."""
        return SOURCE_SIZES[self.source]


@dataclass(frozen=True)
class BundleSpec:
    """Everything that a robot needs beside the network."""

    name: str
    """Name of the bundle."""
    robot: str
    """Name of the robot."""
    base: str
    """Body that carries the free joint."""
    feet: tuple[str, ...]
    """The four foot sites."""
    design: Mapping[str, float]
    """The chosen body: parameter -> value."""
    total_mass: float
    """kg"""
    joints: tuple[JointSpec, ...]
    """The 12 actuated joints in policy order."""
    observation: tuple[ObservationTerm, ...]
    """The terms of the group "proprio", in order."""
    urdf: str
    """URDF text of the chosen body."""
    robot_xml: str
    """MJCF text: free joint, 12 position servos, sensors; compiles alone."""
    scene_xml: str
    """MJCF text: the training terrain with the same robot and solver options."""
    start_height: float
    """World z of the base at the stance, m."""
    physics_dt: float
    """Physics step of the training simulation, s."""
    command_low: tuple[float, float, float]
    """Trained range of (vx, vy, yaw rate), base frame, m/s and rad/s."""
    command_high: tuple[float, float, float]
    """Upper end of that range."""
    action_scale: float = 0.25
    """rad per unit of action."""
    action_clip: float | None = None
    """Actions are limited to [-clip, clip]; None: not limited."""
    policy_hz: float = 50.0
    """Rate of the policy."""
    start_quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the base at the stance."""
    training: Mapping[str, object] = field(default_factory=dict)
    """Provenance: JSON of any shape."""
    camera: CameraSpec | None = None
    """Depth camera of a seeing policy; None for a blind one."""
    commit: str | None = None
    """Version-control commit of the code that trained the policy."""

    @property
    def proprio(self) -> int:
        """P, width of the observation."""
        return sum(term.size for term in self.observation)

    def __post_init__(self) -> None:
        for problem in (*self._joint_problems(), *self._term_problems(), *self._other_problems()):
            raise BundleError(f"bundle '{self.name}': {problem}")

    def _joint_problems(self) -> Iterator[str]:
        if len(self.joints) != ACTIONS:
            yield f"{len(self.joints)} joints are listed, expected {ACTIONS}"
        yield from _repeated("joint", [joint.name for joint in self.joints])
        yield from _repeated("actuator", [joint.actuator for joint in self.joints])
        for joint in self.joints:
            for item in fields(joint):
                value = getattr(joint, item.name)
                if isinstance(value, float) and not math.isfinite(value):
                    yield f"joint '{joint.name}': {item.name} is {value}"
            if not joint.lower <= joint.stance <= joint.upper:
                yield f"joint '{joint.name}': stance {joint.stance} is outside [{joint.lower}, {joint.upper}]"
            if joint.kp <= 0.0:
                yield f"joint '{joint.name}': kp is {joint.kp}, with which a position target does nothing"

    def _term_problems(self) -> Iterator[str]:
        yield from _repeated("observation term", [term.name for term in self.observation])
        for term in self.observation:
            if term.source not in SOURCE_SIZES:
                yield f"observation term '{term.name}': '{term.source}' is none of {', '.join(SOURCE_SIZES)}"
            elif isinstance(term.scale, Sequence) and len(term.scale) != term.size:
                yield f"observation term '{term.name}' has {len(term.scale)} scales for {term.size} elements"

    def _other_problems(self) -> Iterator[str]:
        if self.camera is None and any(term.source in HEADINGS for term in self.observation):
            yield (
                "the observation holds headings, which no sensor gives: a blind policy that reads them cannot leave "
                "the simulator; train a seeing student, and name its camera"
            )
        for name in ("urdf", "robot_xml", "scene_xml"):
            if not getattr(self, name).strip():
                yield f"{name} is empty; give the text of the file"
        if any(low > high for low, high in zip(self.command_low, self.command_high, strict=True)):
            yield f"command range is upside down: {self.command_low} to {self.command_high}"
        substeps = 1.0 / (self.policy_hz * self.physics_dt)
        if not math.isclose(substeps, round(substeps), abs_tol=1e-6):
            yield f"physics_dt {self.physics_dt} s does not divide the policy period 1/{self.policy_hz} s"
        if not math.isclose(math.hypot(*self.start_quat_wxyz), 1.0, abs_tol=1e-6):
            yield f"start_quat_wxyz {self.start_quat_wxyz} is not a unit quaternion"


def _repeated(what: str, names: list[str]) -> Iterator[str]:
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"{what} {name} is listed more than once"
