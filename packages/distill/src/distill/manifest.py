"""The manifest of a bundle: what it holds, and the schema that it keeps."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from jsonschema import Draft202012Validator

from distill.errors import BundleError
from distill.interfaces import ACTIONS, VELOCITY
from distill.spec import BundleSpec

Manifest = Mapping[str, object]

SCHEMA_VERSION = 1
OPSET = 18
ATOL = 1e-5
"""Largest difference allowed between runtimes, and to the golden trace."""

MANIFEST = "manifest.json"
CHECKSUM = "manifest.sha256"
"""Hash of the manifest, as `sha256sum -c` reads it."""
ONNX, TORCHSCRIPT, GOLDEN = "policy.onnx", "policy.ts.pt", "golden.npz"
DEPTH_ONNX, DEPTH_TORCHSCRIPT = "depth_encoder.onnx", "depth_encoder.ts.pt"
TIMING = (
    "tick t counts policy steps since the start; where t is a multiple of period_ticks, image and obs of tick t enter "
    "the network; its outputs enter the policy from tick t + latency_ticks on, until the next ones do; zeros before"
)
IMAGE_RULE = "(clip(depth, near, far) - near) / (far - near) - 0.5"
URDF, ROBOT, SCENE = "robot.urdf", "robot.xml", "scene.xml"


@dataclass(frozen=True)
class SeeingPart:
    """What a manifest says of a seeing policy beside its camera.

    Attributes:
        shape: rows and columns of an image.
        terrain: S, width of the terrain latent.
        headings: K, number of headings.
        memory: M, width of the depth encoder's state.
        period_ticks: control steps between two images.
        latency_ticks: control steps from an image to its use.
        heading_limit: largest heading that is predicted, rad.
    """

    shape: tuple[int, int]
    terrain: int
    headings: int
    memory: int
    period_ticks: int
    latency_ticks: int
    heading_limit: float

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> SeeingPart:
        """That of a manifest that keeps the schema and has a section "depth"."""
        depth = manifest["depth"]
        _, rows, columns = depth["inputs"]["depth"]
        return cls(
            (rows, columns),
            depth["outputs"]["terrain"][-1],
            depth["outputs"]["heading"][-1],
            depth["state"][0]["shape"][-1],
            depth["period_ticks"],
            depth["latency_ticks"],
            depth["heading"]["limit"],
        )


def build_manifest(
    spec: BundleSpec, history: int, ticks: int, folder: Path, seeing: SeeingPart | None = None
) -> dict[str, object]:
    """Describe the files already written to `folder`.

    Args:
        spec: robot and interface.
        history: H of the network.
        ticks: length of the golden trace.
        folder: the bundle, complete but for its manifest.
        seeing: the depth encoder; None for a blind policy.
    """
    manifest = _blind_manifest(spec, history, ticks, folder)
    if seeing is None:
        return manifest
    terrain, heading = [1, seeing.terrain], [1, seeing.headings]
    manifest["rates"]["depth_hz"] = spec.policy_hz / seeing.period_ticks
    manifest["policy"]["inputs"] |= {"terrain": terrain, "heading": heading}
    return {**manifest, "depth": _depth_section(spec, seeing)}


def _depth_section(spec: BundleSpec, seeing: SeeingPart) -> dict[str, object]:
    assert spec.camera is not None
    camera = asdict(spec.camera)
    return {
        "file": DEPTH_ONNX,
        "torchscript": DEPTH_TORCHSCRIPT,
        "inputs": {"depth": [1, *seeing.shape], "obs": [1, spec.proprio]},
        "outputs": {"terrain": [1, seeing.terrain], "heading": [1, seeing.headings]},
        "state": [
            {
                "input": "memory_in",
                "output": "memory_out",
                "shape": [1, seeing.memory],
                "init": "zeros",
                "reset": "start",
            }
        ],
        "period_ticks": seeing.period_ticks,
        "latency_ticks": seeing.latency_ticks,
        "timing": TIMING,
        "image": {"rows": seeing.shape[0], "columns": seeing.shape[1], "rule": IMAGE_RULE, "invalid": "far"},
        "camera": {name: list(value) if isinstance(value, tuple) else value for name, value in camera.items()},
        "heading": {"limit": seeing.heading_limit, "unit": "rad", "frame": "base, about the vertical"},
    }


def _blind_manifest(spec: BundleSpec, history: int, ticks: int, folder: Path) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "name": spec.name,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "generator": {
            "package": "legged-distill",
            "version": version("legged-distill"),
            "commit": spec.commit,
            "torch": str(torch.__version__),
            "opset": OPSET,
        },
        "files": {path.name: sha256(path) for path in sorted(folder.iterdir())},
        "robot": {
            "name": spec.robot,
            "urdf": URDF,
            "mjcf": ROBOT,
            "scene": SCENE,
            "base": spec.base,
            "feet": list(spec.feet),
            "design": {"names": list(spec.design), "values": list(spec.design.values())},
            "total_mass": spec.total_mass,
        },
        "joints": [asdict(joint) for joint in spec.joints],
        "action": {
            "scale": spec.action_scale,
            "clip": spec.action_clip,
            "rule": "target = target_offset + scale * clip(action)",
        },
        "rates": {"policy_hz": spec.policy_hz, "depth_hz": None, "physics_dt": spec.physics_dt},
        "start": {"height": spec.start_height, "quat_wxyz": list(spec.start_quat_wxyz)},
        "command": {
            "names": ["vx", "vy", "yaw_rate"],
            "low": list(spec.command_low),
            "high": list(spec.command_high),
        },
        "observation": {"terms": [{**asdict(term), "size": term.size} for term in spec.observation]},
        "policy": {
            "file": ONNX,
            "torchscript": TORCHSCRIPT,
            "inputs": {"obs": [1, spec.proprio]},
            "outputs": {"action": [1, ACTIONS], "velocity": [1, VELOCITY]},
            "state": [
                {
                    "input": "history_in",
                    "output": "history_out",
                    "shape": [1, history, spec.proprio],
                    "init": "zeros",
                    "reset": "start",
                }
            ],
        },
        "golden": {"file": GOLDEN, "ticks": ticks, "atol": ATOL},
        "training": dict(spec.training),
    }


def write_manifest(manifest: Manifest, path: Path) -> None:
    """Check a manifest and write it, with its checksum beside it.

    Raises:
        BundleError: it does not keep the schema, or holds something that JSON cannot.
    """
    try:
        text = json.dumps(manifest, indent=2, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BundleError(f"the manifest cannot be written as JSON: {error}") from error
    check_schema(json.loads(text), str(path))
    path.write_text(text + "\n", encoding="utf-8")
    path.with_name(CHECKSUM).write_text(checksum_line(path), encoding="utf-8")


def checksum_line(path: Path) -> str:
    """What `CHECKSUM` holds for a manifest."""
    return f"{sha256(path)}  {path.name}\n"


def read_manifest(path: Path) -> dict[str, Any]:
    """Read and check a manifest.

    Raises:
        BundleError: it is missing, is not JSON, or does not keep the schema.
    """
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BundleError(f"{path}: missing; a bundle is a folder with a {MANIFEST}") from None
    except (OSError, ValueError) as error:
        raise BundleError(f"{path}: not readable as JSON: {error}") from error
    if isinstance(manifest, dict) and manifest.get("schema_version") != SCHEMA_VERSION:
        found = manifest.get("schema_version")
        raise BundleError(f"{path}: schema version {found}; this version of distill reads {SCHEMA_VERSION}")
    check_schema(manifest, str(path))
    return manifest


def check_schema(manifest: object, where: str) -> None:
    """Validate against the bundle schema.

    Raises:
        BundleError: names `where` and every element that is wrong.
    """
    errors = sorted(_validator().iter_errors(manifest), key=lambda error: error.json_path)  # pyright: ignore
    if errors:
        faults = "; ".join(f"{error.json_path}: {error.message}" for error in errors)
        raise BundleError(f"{where}: does not keep the bundle schema: {faults}")


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def _validator() -> Draft202012Validator:
    text = resources.files("distill").joinpath("bundle.schema.json").read_text(encoding="utf-8")
    return Draft202012Validator(json.loads(text))
