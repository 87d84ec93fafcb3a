"""Load a bundle: manifest against the schema, every file against its hash, then typed dataclasses."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import jsonschema
import numpy as np
from numpy.typing import NDArray

from deploy.errors import BundleError

MANIFEST = "manifest.json"

Source = Literal[
    "base_angular_velocity",
    "projected_gravity",
    "command",
    "joint_position_error",
    "joint_velocity",
    "last_action",
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
class PolicyGraph:
    """The exported network: its files, the shapes of what goes in and out, its recurrent states."""

    file: str
    torchscript: str | None
    inputs: Mapping[str, tuple[int, ...]]
    outputs: Mapping[str, tuple[int, ...]]
    state: tuple[RecurrentState, ...]


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
    policy: PolicyGraph
    golden: Golden

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

    def per_joint(
        self, field: Literal["stance", "target_offset", "kp", "kd", "torque_limit", "lower", "upper"]
    ) -> NDArray[np.float64]:
        """One number per joint, in policy order, shape (12,)."""
        return np.array([getattr(joint, field) for joint in self.joints], dtype=np.float64)

    def path(self, name: str) -> Path:
        """Full path of a file of the bundle."""
        return self.root / name


@cache
def schema() -> dict[str, Any]:
    """The JSON Schema (2020-12) of manifest.json."""
    return json.loads(files("deploy").joinpath("bundle.schema.json").read_text(encoding="utf-8"))


def load_bundle(folder: str | Path) -> Bundle:
    """Read and verify a bundle.

    Args:
        folder: Folder that holds manifest.json.

    Returns:
        The bundle, its joints in policy order.

    Raises:
        BundleError: The folder or a file is missing, added or changed, the manifest breaks the schema, or
            its parts contradict each other.
    """
    root = Path(folder)
    path = root / MANIFEST
    if not path.is_file():
        raise BundleError(f"{root}: no {MANIFEST} there; give the folder that the export wrote")
    raw = path.read_bytes()
    manifest = _parse(path, raw)
    _verify_files(root, manifest["files"])
    bundle = _build(root, hashlib.sha256(raw).hexdigest(), manifest)
    _check_consistency(path, bundle, manifest)
    return bundle


def _parse(path: Path, raw: bytes) -> dict[str, Any]:
    def refuse(token: str) -> float:
        raise BundleError(f"{path}: {token} is not a number of JSON; export the bundle again")

    try:
        manifest = json.loads(raw.decode("utf-8"), parse_constant=refuse)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise BundleError(f"{path}: not valid JSON ({error}); export the bundle again") from error
    version = manifest.get("schema_version") if isinstance(manifest, dict) else None
    supported = schema()["properties"]["schema_version"]["const"]
    if version is not None and version != supported:
        raise BundleError(
            f"{path}: schema_version is {version!r}, this deploy reads {supported}; "
            "install a matching legged-deploy or export the bundle again"
        )
    problem = jsonschema.exceptions.best_match(
        jsonschema.Draft202012Validator(schema()).iter_errors(manifest)
    )
    if problem is not None:
        raise BundleError(
            f"{path}: {problem.json_path}: {problem.message}; "
            "export the bundle again or correct this element (see bundle.schema.json)"
        )
    return manifest


def _verify_files(root: Path, hashes: Mapping[str, str]) -> None:
    present = {entry.name for entry in root.iterdir()} - {MANIFEST}
    if missing := sorted(set(hashes) - present):
        raise BundleError(
            f"{root / missing[0]}: file is missing from the bundle; copy the whole folder again"
        )
    if extra := sorted(present - set(hashes)):
        raise BundleError(f"{root / extra[0]}: file is not listed in {MANIFEST}; remove it")
    for name, expected in hashes.items():
        path = root / name
        if path.is_symlink() or not path.is_file():
            raise BundleError(f"{path}: not a plain file; put the file itself into the bundle")
        if hashlib.sha256(path.read_bytes()).hexdigest() != expected:
            raise BundleError(
                f"{path}: content has changed since the export (SHA-256 differs from {MANIFEST}); "
                "copy the bundle again or export it again"
            )


def _build(root: Path, sha256: str, m: Mapping[str, Any]) -> Bundle:
    robot = dict(m["robot"])
    design = robot.pop("design")
    policy = m["policy"]
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
        policy=PolicyGraph(
            file=policy["file"],
            torchscript=policy.get("torchscript"),
            inputs={name: tuple(shape) for name, shape in policy["inputs"].items()},
            outputs={name: tuple(shape) for name, shape in policy["outputs"].items()},
            state=tuple(RecurrentState(s["input"], s["output"], tuple(s["shape"])) for s in policy["state"]),
        ),
        golden=Golden(**m["golden"]),
    )


def _term(term: Mapping[str, Any]) -> ObservationTerm:
    scale = term["scale"]
    factors = tuple(scale) if isinstance(scale, list) else (scale,) * term["size"]
    return ObservationTerm(**{**term, "scale": factors})


def _check_consistency(path: Path, bundle: Bundle, m: Mapping[str, Any]) -> None:
    """What the schema cannot say: parts of the manifest that must agree with each other."""
    count = len(bundle.joints)
    sizes = {
        "base_angular_velocity": 3,
        "projected_gravity": 3,
        "command": 3,
        "joint_position_error": count,
        "joint_velocity": count,
        "last_action": count,
    }
    listed = [
        *(bundle.robot.urdf, bundle.robot.mjcf, bundle.robot.scene, bundle.policy.file, bundle.golden.file),
        *([bundle.policy.torchscript] if bundle.policy.torchscript else []),
    ]
    problems = [
        f"file {name} is used but not listed under files" for name in listed if name not in m["files"]
    ]
    for what, names in {
        "joint": bundle.joint_names,
        "actuator": tuple(joint.actuator for joint in bundle.joints),
        "observation term": tuple(term.name for term in bundle.terms),
        "state input": tuple(state.input for state in bundle.policy.state),
        "state output": tuple(state.output for state in bundle.policy.state),
    }.items():
        problems += [f"{what} {name} is listed twice" for name in set(names) if names.count(name) > 1]
    for joint in bundle.joints:
        if not joint.lower <= joint.stance <= joint.upper:
            problems.append(
                f"joint {joint.name}: stance {joint.stance} outside [{joint.lower}, {joint.upper}]"
            )
    for term in bundle.terms:
        if term.size != sizes[term.source]:
            problems.append(f"term {term.name}: size {term.size}, but {term.source} has {sizes[term.source]}")
        if len(term.scale) != term.size:
            problems.append(f"term {term.name}: {len(term.scale)} scale factors for size {term.size}")
    if bundle.policy.inputs["obs"] != (1, bundle.observation_size):
        problems.append(
            f"policy input obs is {list(bundle.policy.inputs['obs'])}, the terms make [1, {bundle.observation_size}]"
        )
    if bundle.policy.outputs["action"] != (1, count):
        problems.append(f"policy output action is {list(bundle.policy.outputs['action'])}, not [1, {count}]")
    if len(m["robot"]["design"]["names"]) != len(m["robot"]["design"]["values"]):
        problems.append("robot.design: names and values differ in length")
    if any(low > high for low, high in zip(bundle.command.low, bundle.command.high, strict=True)):
        problems.append("command: low above high")
    substeps = 1 / (bundle.policy_hz * bundle.physics_dt)
    if not math.isclose(substeps, round(substeps), abs_tol=1e-6):
        problems.append(f"rates: physics_dt {bundle.physics_dt} s does not divide 1/{bundle.policy_hz} s")
    if not math.isclose(np.linalg.norm(bundle.start_quat_wxyz), 1.0, abs_tol=1e-6):
        problems.append("start.quat_wxyz: not a unit quaternion")
    if problems:
        raise BundleError(f"{path}: {problems[0]}; correct the export and write the bundle again")
