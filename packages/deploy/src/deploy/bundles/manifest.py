"""The typed content of a bundle: what manifest.json says, as frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from deploy.depth.optics import DepthOptics

Source = Literal[
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


@dataclass(frozen=True)
class Joint:
    """One actuated joint; angles in rad, gains in N m/rad and N m s/rad, torque in N m, speed in rad/s."""

    name: str
    actuator: str
    stance: float
    target_offset: float
    kp: float
    kd: float
    torque_limit: float
    velocity_limit: float | None
    lower: float
    upper: float


@dataclass(frozen=True)
class Robot:
    """The body that the policy was trained for; file names are relative to the bundle; mass in kg."""

    name: str
    urdf: str
    mjcf: str
    scene: str
    base: str
    feet: tuple[str, ...]
    design: Mapping[str, float]
    total_mass: float


@dataclass(frozen=True)
class Action:
    """``target = target_offset + scale * clip(action)``; `scale` in rad, `clip` None: not limited."""

    scale: float
    clip: float | None


@dataclass(frozen=True)
class CommandRange:
    """Trained range of (vx, vy, yaw_rate), base frame, m/s and rad/s."""

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class ObservationTerm:
    """A named slice of the observation: ``scale * source``, with one factor per element."""

    name: str
    source: Source
    frame: str
    unit: str
    size: int
    scale: tuple[float, ...]


@dataclass(frozen=True)
class RecurrentState:
    """A tensor fed from `output` back to `input` at the next tick; zeros at the start."""

    input: str
    output: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Graph:
    """An exported network: its files, the shapes of what goes in and out, its recurrent states."""

    file: str
    torchscript: str | None
    inputs: Mapping[str, tuple[int, ...]]
    outputs: Mapping[str, tuple[int, ...]]
    state: tuple[RecurrentState, ...]


@dataclass(frozen=True)
class Depth:
    """The seeing part of a policy: its network, when that is fed and used, and its camera.

    Attributes:
        graph: The depth encoder.
        period_ticks: Policy ticks between two images.
        latency_ticks: Policy ticks from an image to the first tick that uses it.
        optics: Geometry and scale of the image that the network reads.
        camera_position: Of the camera in the base frame, m.
        camera_pitch: Trained range of the mount's pitch, rad; positive looks down.
        heading_limit: Largest heading that the network predicts, rad.
    """

    graph: Graph
    period_ticks: int
    latency_ticks: int
    optics: DepthOptics
    camera_position: tuple[float, float, float]
    camera_pitch: tuple[float, float]
    heading_limit: float


@dataclass(frozen=True)
class Golden:
    """The recorded trace: number of ticks and the absolute tolerance of its comparison."""

    file: str
    ticks: int
    atol: float


@dataclass(frozen=True)
class Bundle:
    """A verified bundle.

    Attributes:
        root: Folder of the bundle.
        sha256: Hash of manifest.json, and through its file table of the whole bundle.
        joints: In policy order.
        policy_hz: Rate of the policy, Hz.
        physics_dt: Physics step of training, s.
        start_height: World z of the base at the stance, m.
        start_quat_wxyz: Orientation of the base at the stance.
        depth: Camera and depth encoder of a policy that sees; None: it is blind.
    """

    root: Path
    sha256: str
    name: str
    robot: Robot
    joints: tuple[Joint, ...]
    action: Action
    policy_hz: float
    depth_hz: float | None
    physics_dt: float
    start_height: float
    start_quat_wxyz: tuple[float, ...]
    command: CommandRange
    terms: tuple[ObservationTerm, ...]
    policy: Graph
    golden: Golden
    depth: Depth | None = None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints in policy order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def period_ns(self) -> int:
        """Policy period in ns."""
        return round(1e9 / self.policy_hz)

    @property
    def observation_size(self) -> int:
        """Length P of the observation."""
        return sum(term.size for term in self.terms)

    @property
    def feels_feet(self) -> bool:
        """Whether the policy reads which feet touch the ground."""
        return any(term.source == "foot_contact" for term in self.terms)

    def per_joint(
        self, field: Literal["stance", "target_offset", "kp", "kd", "torque_limit", "lower", "upper"]
    ) -> NDArray[np.float64]:
        """One number per joint, in policy order, shape (12,)."""
        return np.array([getattr(joint, field) for joint in self.joints], dtype=np.float64)

    def path(self, name: str) -> Path:
        """Full path of a file of the bundle."""
        return self.root / name


def build_bundle(root: Path, sha256: str, m: Mapping[str, Any]) -> Bundle:
    """Typed view of a manifest that has passed the schema."""
    robot = dict(m["robot"])
    design = robot.pop("design")
    return Bundle(
        root=root,
        sha256=sha256,
        name=m["name"],
        robot=Robot(
            **{**robot, "feet": tuple(robot["feet"])},
            design=dict(zip(design["names"], design["values"], strict=False)),
        ),
        joints=tuple(Joint(**joint) for joint in m["joints"]),
        action=Action(scale=m["action"]["scale"], clip=m["action"]["clip"]),
        policy_hz=m["rates"]["policy_hz"],
        depth_hz=m["rates"]["depth_hz"],
        physics_dt=m["rates"]["physics_dt"],
        start_height=m["start"]["height"],
        start_quat_wxyz=tuple(m["start"]["quat_wxyz"]),
        command=CommandRange(**{key: tuple(value) for key, value in m["command"].items()}),
        terms=tuple(_term(term) for term in m["observation"]["terms"]),
        policy=_graph(m["policy"]),
        golden=Golden(**m["golden"]),
        depth=_depth(m["depth"]) if "depth" in m else None,
    )


def _graph(section: Mapping[str, Any]) -> Graph:
    return Graph(
        file=section["file"],
        torchscript=section.get("torchscript"),
        inputs={name: tuple(shape) for name, shape in section["inputs"].items()},
        outputs={name: tuple(shape) for name, shape in section["outputs"].items()},
        state=tuple(RecurrentState(s["input"], s["output"], tuple(s["shape"])) for s in section["state"]),
    )


def _depth(section: Mapping[str, Any]) -> Depth:
    return Depth(
        graph=_graph(section),
        period_ticks=section["period_ticks"],
        latency_ticks=section["latency_ticks"],
        optics=DepthOptics.from_manifest(section),
        camera_position=tuple(section["camera"]["position"]),
        camera_pitch=tuple(section["camera"]["pitch"]),
        heading_limit=section["heading"]["limit"],
    )


def _term(term: Mapping[str, Any]) -> ObservationTerm:
    scale = term["scale"]
    factors = tuple(scale) if isinstance(scale, list) else (scale,) * term["size"]
    return ObservationTerm(**{**term, "scale": factors})
