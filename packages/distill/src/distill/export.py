"""Write a student as a bundle: networks, body, manifest and golden trace in one folder."""

from __future__ import annotations

import copy
import logging
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from distill.errors import BundleError
from distill.golden import RawStates, plausible_states, record
from distill.manifest import (
    ATOL,
    GOLDEN,
    MANIFEST,
    ONNX,
    OPSET,
    ROBOT,
    SCENE,
    TORCHSCRIPT,
    URDF,
    build_manifest,
    write_manifest,
)
from distill.runtimes import OnnxRuntime, TorchRuntime, load_torchscript, replay, save_torchscript
from distill.spec import BundleSpec
from distill.student import Student
from distill.verify import verify_bundle

PARITY_TICKS = 320


def export_bundle(out_dir: Path, student: Student, spec: BundleSpec, states: RawStates | None = None) -> Path:
    """Write a bundle, check it, and only then put it in place.

    An existing bundle at `out_dir` stays until the new one is complete.

    Args:
        out_dir: folder of the bundle.
        student: the network.
        spec: robot and interface.
        states: raw states of the golden trace, for example recorded in simulation; None draws
            plausible ones about the stance.

    Returns:
        `out_dir`.

    Raises:
        BundleError: specification and network disagree, the exported networks differ from the
            eager one, or `out_dir` holds something that is not a bundle.
    """
    if spec.proprio != student.proprio:
        raise BundleError(
            f"the observation terms add up to {spec.proprio} elements, the student reads {student.proprio}"
        )
    return write_bundle(out_dir, lambda folder: _fill(folder, copy.deepcopy(student).cpu().eval(), spec, states))


def write_bundle(out_dir: Path, fill: Callable[[Path], None]) -> Path:
    """Have `fill` write every file of a bundle into an empty folder, verify it, and put it in place of `out_dir`.

    Raises:
        BundleError: the bundle is not right, `out_dir` holds something else, or the disk is full; what was there
            stays.
    """
    _recover(out_dir)
    if out_dir.exists() and not (out_dir / MANIFEST).is_file() and any(out_dir.iterdir()):
        raise BundleError(f"{out_dir}: holds something other than a bundle; choose another folder")
    out_dir.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{out_dir.name}.", dir=out_dir.parent))
    try:
        staging.chmod(0o755)
        fill(staging)
        verify_bundle(staging)
        _replace(staging, out_dir)
    except OSError as error:
        raise BundleError(f"{out_dir}: cannot be written ({error}); free the disk and export again") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return out_dir


def _fill(folder: Path, student: Student, spec: BundleSpec, states: RawStates | None) -> None:
    """Write every file; the manifest comes last."""
    write_body(folder, spec)
    history = student.config.history
    example = (torch.zeros(1, student.proprio), torch.zeros(1, history, student.proprio))
    save_onnx(student, example, folder / ONNX)
    save_torchscript(student, example, folder / TORCHSCRIPT)
    check_parity(folder, student, spec)
    eager = TorchRuntime(student, [(1, history, student.proprio)])
    trace = record(spec, states or plausible_states(spec), eager)
    np.savez_compressed(folder / GOLDEN, allow_pickle=False, **trace)
    write_manifest(build_manifest(spec, history, len(trace["obs"]), folder), folder / MANIFEST)


def write_body(folder: Path, spec: BundleSpec) -> None:
    """Write URDF, MJCF and scene."""
    for name, text in ((URDF, spec.urdf), (ROBOT, spec.robot_xml), (SCENE, spec.scene_xml)):
        (folder / name).write_text(text, encoding="utf-8")


def save_onnx(student: Student, example: tuple[Tensor, ...], path: Path) -> None:
    """Write the student as one ONNX file, weights inside."""
    save_network(student, example, path, ["obs", "history_in"], ["action", "velocity", "history_out"])


def save_network(
    module: nn.Module, example: tuple[Tensor, ...], path: Path, inputs: list[str], outputs: list[str]
) -> None:
    """Write a network as one ONNX file, weights inside.

    Args:
        module: the network.
        example: its inputs, batch 1.
        path: the file.
        inputs: names of the inputs.
        outputs: names of the outputs.
    """
    # The exporter reports every optional package that it does without, and its own use of old names.
    log = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=FutureWarning)
            torch.onnx.export(
                module,
                example,
                path,
                dynamo=True,
                external_data=False,
                opset_version=OPSET,
                input_names=inputs,
                output_names=outputs,
                verbose=False,
            )
    finally:
        log.setLevel(level)


def check_parity(folder: Path, student: Student, spec: BundleSpec, ticks: int = PARITY_TICKS) -> None:
    """Compare the exported networks with the eager one over recurrent steps with a reset among them.

    Raises:
        BundleError: a runtime differs by more than 1e-5.
    """
    shapes = [(1, student.config.history, student.proprio)]
    eager = TorchRuntime(student, shapes)
    trace = record(spec, plausible_states(spec, ticks, seed=1), eager)
    obs, reset = trace["obs"].astype(np.float32), trace["reset"].astype(np.bool_)
    expected = replay(eager, obs, reset)
    runtimes = {
        ONNX: OnnxRuntime(folder / ONNX, shapes),
        TORCHSCRIPT: TorchRuntime(load_torchscript(folder / TORCHSCRIPT), shapes),
    }
    for name, runtime in runtimes.items():
        for what, found, wanted in zip(expected._fields, replay(runtime, obs, reset), expected, strict=True):
            error = np.abs(found - wanted).max()
            if not error <= ATOL:
                raise BundleError(
                    f"{name}: {what} differs from the eager network by {error:.2e} within {ticks} recurrent "
                    f"steps (allowed {ATOL:.0e})"
                )


def _previous(out_dir: Path) -> Path:
    return out_dir.with_name(f".{out_dir.name}.previous")


def _recover(out_dir: Path) -> None:
    """Put the former bundle back where a crash fell between the two renames of `_replace`."""
    if _previous(out_dir).exists():
        if out_dir.exists():
            shutil.rmtree(_previous(out_dir))
        else:
            os.rename(_previous(out_dir), out_dir)


def _replace(staging: Path, out_dir: Path) -> None:
    """Move the new bundle into place; a folder cannot be replaced in one step."""
    if out_dir.exists():
        os.rename(out_dir, _previous(out_dir))
    os.rename(staging, out_dir)
    shutil.rmtree(_previous(out_dir), ignore_errors=True)
