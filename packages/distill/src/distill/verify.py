"""Check a bundle as its receiver would: schema, hashes, and both networks against the golden trace."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from distill.errors import BundleError
from distill.manifest import CHECKSUM, MANIFEST, checksum_line, read_manifest, sha256
from distill.runtimes import OnnxRuntime, PolicyRuntime, TorchRuntime, load_torchscript, replay
from distill.vision.runtime import due_ticks, replay_seeing, seeing_runtimes

Floats = NDArray[np.float32]
Trace = dict[str, NDArray[Any]]


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
    golden = manifest["golden"]
    seeing = "depth" in manifest
    names = ("obs", "reset", "action", *(("depth", "depth_due") if seeing else ()))
    trace = _read_golden(folder / golden["file"], golden["ticks"], names)
    errors = {}
    for name, actions in (_seen if seeing else _blind)(folder, manifest, trace):
        errors[name] = float(np.abs(actions - trace["action"]).max())
        if not errors[name] <= golden["atol"]:
            raise BundleError(
                f"{folder / name}: differs from the golden trace by {errors[name]:.2e} (allowed {golden['atol']:.0e})"
            )
    return Verification(len(manifest["files"]), golden["ticks"], errors)


def _blind(folder: Path, manifest: dict[str, Any], trace: Trace) -> Iterator[tuple[str, Floats]]:
    """Each network's actions on the golden trace."""
    policy = manifest["policy"]
    shapes = [state["shape"] for state in policy["state"]]
    runtimes: dict[str, PolicyRuntime] = {policy["file"]: OnnxRuntime(folder / policy["file"], shapes)}
    if "torchscript" in policy:
        module = load_torchscript(folder / policy["torchscript"])
        runtimes[policy["torchscript"]] = TorchRuntime(module, shapes)
    obs, reset = trace["obs"].astype(np.float32), trace["reset"].astype(np.bool_)
    for name, runtime in runtimes.items():
        yield name, replay(runtime, obs, reset).action


def _seen(folder: Path, manifest: dict[str, Any], trace: Trace) -> Iterator[tuple[str, Floats]]:
    """The same for a policy that sees."""
    obs, images = trace["obs"].astype(np.float32), trace["depth"].astype(np.float32)
    reset, due = trace["reset"].astype(np.bool_), trace["depth_due"].astype(np.bool_)
    if not np.array_equal(due, due_ticks(reset, period := manifest["depth"]["period_ticks"])):
        raise BundleError(f"{folder / manifest['golden']['file']}: its images are not those of every {period}th tick")
    for name, runtime in seeing_runtimes(folder, manifest).items():
        yield name, replay_seeing(runtime, obs, images, reset, due).action


def _check_files(folder: Path, manifest: Mapping[str, Any]) -> None:
    checksum = folder / CHECKSUM
    if not checksum.is_file():
        raise BundleError(f"{checksum}: missing; copy the whole folder or export it again")
    if checksum.read_bytes() != checksum_line(folder / MANIFEST).encode():
        raise BundleError(f"{folder / MANIFEST}: altered since the bundle was written ({CHECKSUM} has another hash)")
    robot = manifest["robot"]
    named = {robot["urdf"], robot["mjcf"], robot["scene"], manifest["golden"]["file"]}
    for network in (manifest["policy"], manifest.get("depth", {})):
        named |= {network[key] for key in ("file", "torchscript") if key in network}
    if unlisted := named - set(manifest["files"]):
        raise BundleError(f"{folder / MANIFEST}: gives no hash for {', '.join(sorted(unlisted))}")
    if added := {path.name for path in folder.iterdir()} - set(manifest["files"]) - {MANIFEST, CHECKSUM}:
        raise BundleError(f"{folder}: holds {', '.join(sorted(added))}, which {MANIFEST} does not list")
    for name, expected in manifest["files"].items():
        path = folder / name
        if not path.is_file():
            raise BundleError(f"{path}: missing, though listed in {MANIFEST}")
        if sha256(path) != expected:
            raise BundleError(f"{path}: altered since the bundle was written (its SHA-256 differs)")


def _read_golden(path: Path, ticks: int, names: Sequence[str]) -> Trace:
    try:
        with np.load(path, allow_pickle=False) as file:
            trace = {name: file[name] for name in names}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BundleError(f"{path}: not a golden trace: {error}") from error
    if any(len(array) != ticks for name, array in trace.items() if name != "depth"):
        raise BundleError(f"{path}: has not the {ticks} ticks that {MANIFEST} names")
    if "depth" in trace and len(trace["depth"]) != trace["depth_due"].sum():
        raise BundleError(f"{path}: has {len(trace['depth'])} images for {trace['depth_due'].sum()} ticks with one")
    return trace
