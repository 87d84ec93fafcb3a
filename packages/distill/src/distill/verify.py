"""Check a bundle as its receiver would: schema, hashes, and both networks against the golden trace."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from distill.errors import BundleError
from distill.manifest import MANIFEST, read_manifest, sha256
from distill.runtimes import OnnxRuntime, PolicyRuntime, TorchRuntime, load_torchscript, replay


@dataclass(frozen=True)
class Verification:
    """What `verify_bundle` found.

    Attributes:
        files: number of files whose hash is right.
        ticks: length of the golden trace.
        errors: largest difference of an action, per runtime.
    """

    files: int
    ticks: int
    errors: Mapping[str, float]


def verify_bundle(folder: Path) -> Verification:
    """Check schema, hashes and the golden trace.

    Args:
        folder: the bundle.

    Raises:
        BundleError: names the file and what is wrong with it.
    """
    manifest = read_manifest(folder / MANIFEST)
    _check_files(folder, manifest)
    trace = _read_golden(folder / manifest["golden"]["file"], manifest["golden"]["ticks"])
    obs, reset, action = trace["obs"], trace["reset"].astype(np.bool_), trace["action"]
    policy, tolerance = manifest["policy"], manifest["golden"]["atol"]
    shapes = [state["shape"] for state in policy["state"]]
    runtimes: dict[str, PolicyRuntime] = {policy["file"]: OnnxRuntime(folder / policy["file"], shapes)}
    if "torchscript" in policy:
        module = load_torchscript(folder / policy["torchscript"])
        runtimes[policy["torchscript"]] = TorchRuntime(module, shapes)
    errors = {}
    for name, runtime in runtimes.items():
        errors[name] = float(np.abs(replay(runtime, obs.astype(np.float32), reset).action - action).max())
        if not errors[name] <= tolerance:
            raise BundleError(
                f"{folder / name}: differs from the golden trace by {errors[name]:.2e} (allowed {tolerance:.0e})"
            )
    return Verification(len(manifest["files"]), len(obs), errors)


def _check_files(folder: Path, manifest: Mapping[str, Any]) -> None:
    robot, policy = manifest["robot"], manifest["policy"]
    named = [robot["urdf"], robot["mjcf"], robot["scene"], policy["file"], manifest["golden"]["file"]]
    if unlisted := {*named, policy.get("torchscript", policy["file"])} - set(manifest["files"]):
        raise BundleError(f"{folder / MANIFEST}: gives no hash for {', '.join(sorted(unlisted))}")
    if added := {path.name for path in folder.iterdir()} - set(manifest["files"]) - {MANIFEST}:
        raise BundleError(f"{folder}: holds {', '.join(sorted(added))}, which {MANIFEST} does not list")
    for name, expected in manifest["files"].items():
        path = folder / name
        if not path.is_file():
            raise BundleError(f"{path}: missing, though listed in {MANIFEST}")
        if sha256(path) != expected:
            raise BundleError(f"{path}: altered since the bundle was written (its SHA-256 differs)")


def _read_golden(path: Path, ticks: int) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            trace = {name: file[name] for name in ("obs", "reset", "action")}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BundleError(f"{path}: not a golden trace: {error}") from error
    if any(len(array) != ticks for array in trace.values()):
        raise BundleError(f"{path}: has not the {ticks} ticks that {MANIFEST} names")
    return trace
