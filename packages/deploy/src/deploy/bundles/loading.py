"""Load a bundle and trust nothing: schema, hash of every file, agreement of its parts."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
from jsonschema.exceptions import best_match

from deploy.bundles.manifest import Bundle, build_bundle
from deploy.errors import BundleError

MANIFEST = "manifest.json"
CHECKSUM = "manifest.sha256"
"""Hash of the manifest, as `sha256sum -c` reads it: all other files have theirs in the manifest."""


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
    sha256 = hashlib.sha256(raw).hexdigest()
    _verify_manifest(root, sha256)
    _verify_files(root, manifest["files"])
    bundle = build_bundle(root, sha256, manifest)
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
    problem = best_match(jsonschema.Draft202012Validator(schema()).iter_errors(manifest))
    if problem is not None:
        raise BundleError(
            f"{path}: {problem.json_path}: {problem.message}; "
            "export the bundle again or correct this element (see bundle.schema.json)"
        )
    return manifest


def checksum_line(sha256: str) -> str:
    """What `CHECKSUM` holds for a manifest of this hash."""
    return f"{sha256}  {MANIFEST}\n"


def _verify_manifest(root: Path, sha256: str) -> None:
    path = root / CHECKSUM
    if not path.is_file():
        raise BundleError(f"{path}: file is missing from the bundle; copy the whole folder or export it again")
    if path.read_bytes() != checksum_line(sha256).encode():
        raise BundleError(
            f"{root / MANIFEST}: content has changed since the export (SHA-256 differs from {CHECKSUM}); "
            "copy the bundle again or export it again"
        )


def _verify_files(root: Path, hashes: Mapping[str, str]) -> None:
    present = {entry.name for entry in root.iterdir()} - {MANIFEST, CHECKSUM}
    if missing := sorted(set(hashes) - present):
        raise BundleError(f"{root / missing[0]}: file is missing from the bundle; copy the whole folder again")
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
        "roll_pitch": 2,
        "heading_error": 1,
        "next_heading_error": 1,
        "commanded_speed": 1,
        "foot_contact": len(bundle.robot.feet),
    }
    graphs = [bundle.policy, *([] if bundle.depth is None else [bundle.depth.graph])]
    listed = [bundle.robot.urdf, bundle.robot.mjcf, bundle.robot.scene, bundle.golden.file]
    listed += [name for graph in graphs for name in (graph.file, graph.torchscript) if name is not None]
    problems = [f"file {name} is used but not listed under files" for name in listed if name not in m["files"]]
    problems += _seeing_problems(bundle)
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
            problems.append(f"joint {joint.name}: stance {joint.stance} outside [{joint.lower}, {joint.upper}]")
        if joint.kp == 0:
            problems.append(f"joint {joint.name}: kp is 0, a position target would do nothing")
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


def _seeing_problems(bundle: Bundle) -> list[str]:
    """Where the depth encoder does not fit the policy that uses it."""
    headings = [term.name for term in bundle.terms if term.source in ("heading_error", "next_heading_error")]
    fed = {name: shape for name, shape in bundle.policy.inputs.items() if name != "obs"}
    depth = bundle.depth
    if depth is None:
        blind = [f"term {name}: no sensor gives headings, and the policy is blind" for name in headings]
        return [*blind, *(f"policy input {name}: nothing gives it, there is no section depth" for name in fed)]
    problems = [
        f"policy input {name} is {list(shape)}, the depth encoder gives {list(depth.graph.outputs.get(name, ()))}"
        for name, shape in fed.items()
        if shape != depth.graph.outputs.get(name)
    ]
    image = (1, depth.optics.rows, depth.optics.columns)
    if depth.graph.inputs["depth"] != image:
        problems.append(f"depth input depth is {list(depth.graph.inputs['depth'])}, the image is {list(image)}")
    if depth.graph.inputs["obs"] != (1, bundle.observation_size):
        problems.append(
            f"depth input obs is {list(depth.graph.inputs['obs'])}, the terms make [1, {bundle.observation_size}]"
        )
    if not 0.0 <= depth.optics.near < depth.optics.far:
        problems.append(f"depth camera: near {depth.optics.near} m is not below far {depth.optics.far} m")
    names = [name for state in depth.graph.state for name in (state.input, state.output)]
    problems += [f"depth state {name} is listed twice" for name in set(names) if names.count(name) > 1]
    return problems
