"""Write a seeing student as a bundle: two networks, body, camera, manifest and golden trace in one folder."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from distill.errors import BundleError
from distill.export import PARITY_TICKS, save_network, write_body, write_bundle
from distill.golden import RawStates, clip, observe, plausible_states, recorded
from distill.interfaces import ACTIONS
from distill.manifest import (
    ATOL,
    DEPTH_ONNX,
    DEPTH_TORCHSCRIPT,
    GOLDEN,
    MANIFEST,
    ONNX,
    TORCHSCRIPT,
    build_manifest,
    write_manifest,
)
from distill.runtimes import Array, load_torchscript, onnx_network, save_torchscript, torch_network
from distill.spec import HEADINGS, BundleSpec
from distill.vision.runtime import (
    DepthNetwork,
    SeeingRuntime,
    due_ticks,
    eager_runtime,
    examples,
    replay_seeing,
    seeing_part,
)
from distill.vision.student import VisionStudent


def export_vision_bundle(
    out_dir: Path,
    student: VisionStudent,
    spec: BundleSpec,
    states: RawStates | None = None,
    images: Array | None = None,
) -> Path:
    """Write a bundle, check it, and only then put it in place.

    Args:
        out_dir: folder of the bundle; one that is there stays until the new one is complete.
        student: the networks.
        spec: robot, interface and camera.
        states: raw states of the golden trace; None draws plausible ones about the stance.
        images: those of its ticks at which an image is due, (C, rows, columns) from -0.5 to 0.5; None draws some.

    Returns:
        `out_dir`.

    Raises:
        BundleError: specification and networks disagree, the exported networks differ from the eager ones, or
            `out_dir` holds something that is not a bundle.
    """
    _check(student, spec)
    states = states or plausible_states(spec)
    count = int(due_ticks(states.reset, student.depth_period).sum())
    if images is None:
        images = plausible_images(count, student.depth_shape, seed=0)
    if images.shape != (count, *student.depth_shape):
        raise BundleError(f"images have shape {images.shape}, expected {(count, *student.depth_shape)}")
    golden = images.astype(np.float32)
    copied = copy.deepcopy(student).cpu().eval()
    return write_bundle(out_dir, lambda folder: _fill(folder, copied, spec, states, golden))


def plausible_images(count: int, shape: tuple[int, int], seed: int) -> Array:
    """Images of boxes at random depths, (count, rows, columns) from -0.5 to 0.5."""
    rng = np.random.default_rng((seed, 2))
    images = np.full((count, *shape), 0.5, dtype=np.float32)
    for image in images:
        for depth in np.sort(rng.uniform(-0.5, 0.5, 3))[::-1]:  # the nearest one hides the others
            (top, bottom), (left, right) = (np.sort(rng.integers(0, size + 1, 2)) for size in shape)
            image[top:bottom, left:right] = depth
    return images


def _check(student: VisionStudent, spec: BundleSpec) -> None:
    if spec.camera is None:
        raise BundleError(f"bundle '{spec.name}': a seeing student needs BundleSpec.camera")
    if spec.proprio != student.proprio:
        raise BundleError(
            f"the observation terms add up to {spec.proprio} elements, the student reads {student.proprio}"
        )
    columns, start = [], 0
    for term in spec.observation:
        if term.source in HEADINGS:
            columns += range(start, start + term.size)
        start += term.size
    if columns != list(range(student.heading.start, student.heading.stop)):
        raise BundleError(
            f"the observation terms hold headings in columns {columns}, the student predicts those of "
            f"{student.heading.start} to {student.heading.stop - 1}"
        )


def _fill(folder: Path, student: VisionStudent, spec: BundleSpec, states: RawStates, images: Array) -> None:
    """Write every file; the manifest comes last."""
    write_body(folder, spec)
    depth = DepthNetwork(student)
    policy_example, depth_example = examples(student)
    names = ["obs", "terrain", "heading", "history_in"]
    save_network(student, policy_example, folder / ONNX, names, ["action", "velocity", "history_out"])
    names = ["depth", "obs", "memory_in"]
    save_network(depth, depth_example, folder / DEPTH_ONNX, names, ["terrain", "heading", "memory_out"])
    save_torchscript(student, policy_example, folder / TORCHSCRIPT)
    save_torchscript(depth, depth_example, folder / DEPTH_TORCHSCRIPT)
    check_parity(folder, student, spec)
    trace = record_seeing(spec, states, images, eager_runtime(student), student.depth_period)
    np.savez_compressed(folder / GOLDEN, allow_pickle=False, **trace)
    manifest = build_manifest(spec, student.history, len(states.reset), folder, seeing_part(student))
    write_manifest(manifest, folder / MANIFEST)


def check_parity(folder: Path, student: VisionStudent, spec: BundleSpec, ticks: int = PARITY_TICKS) -> None:
    """Compare the exported networks with the eager ones over recurrent steps with a reset among them.

    Raises:
        BundleError: a runtime differs by more than 1e-5.
    """
    states = plausible_states(spec, ticks, seed=1)
    due = due_ticks(states.reset, student.depth_period)
    images = plausible_images(int(due.sum()), student.depth_shape, seed=1)
    eager = eager_runtime(student)
    obs = record_seeing(spec, states, images, eager, student.depth_period)["obs"]
    expected = replay_seeing(eager, obs, images, states.reset, due)
    for name, runtime in _exported(folder, student).items():
        found = replay_seeing(runtime, obs, images, states.reset, due)
        for what, mine, wanted in zip(expected._fields, found, expected, strict=True):
            error = np.abs(mine - wanted).max()
            if not error <= ATOL:
                raise BundleError(
                    f"{name}: {what} differs from the eager networks by {error:.2e} within {ticks} recurrent steps "
                    f"(allowed {ATOL:.0e})"
                )


def _exported(folder: Path, student: VisionStudent) -> dict[str, SeeingRuntime]:
    shapes = seeing_part(student), (1, student.history, student.proprio)
    policy, depth = (torch_network(load_torchscript(folder / name)) for name in (TORCHSCRIPT, DEPTH_TORCHSCRIPT))
    return {
        ONNX: SeeingRuntime(onnx_network(folder / ONNX), onnx_network(folder / DEPTH_ONNX), *shapes),
        TORCHSCRIPT: SeeingRuntime(policy, depth, *shapes),
    }


def record_seeing(
    spec: BundleSpec, states: RawStates, images: Array, runtime: SeeingRuntime, period: int
) -> dict[str, NDArray[Any]]:
    """Run the policy over raw states and images.

    Returns:
        The arrays of `golden.npz`: the raw states, depth (C, rows, columns) as fed to the network, depth_due (T,)
        bool, and obs (T, P), terrain (T, S), heading (T, K), action (T, 12), target (T, 12) in rad.
    """
    offset = np.array([joint.target_offset for joint in spec.joints])
    due, last_action = due_ticks(states.reset, period), np.zeros(ACTIONS)
    order = np.cumsum(due) - 1
    rows: dict[str, list[NDArray[Any]]] = {name: [] for name in ("obs", "terrain", "heading", "action", "target")}
    for tick, reset in enumerate(states.reset):
        if reset:
            runtime.reset()
            last_action = np.zeros(ACTIONS)
        obs = observe(spec, states, tick, last_action)
        output = runtime.step(obs, images[order[tick]] if due[tick] else None)
        last_action = clip(spec, output.action)
        target = offset + spec.action_scale * last_action
        row = (obs, output.terrain, output.heading, output.action, target)
        for name, value in zip(rows, row, strict=True):
            rows[name].append(value)
    stacked = {name: np.stack(values) for name, values in rows.items()}
    return {**recorded(states), "depth": images, "depth_due": due, **stacked}
