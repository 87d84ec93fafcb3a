"""Replay the recorded trace of a bundle before anything moves."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.errors import BundleError
from deploy.interfaces import DepthFrame, PolicyRuntime, RobotState
from deploy.policy.tick import Policy

Trace: TypeAlias = dict[str, NDArray[Any]]
"""The arrays of golden.npz."""


@dataclass(frozen=True)
class GoldenResult:
    """Ticks replayed and the largest absolute difference of each quantity; what is seen only where the policy sees."""

    ticks: int
    obs: float
    action: float
    target: float
    terrain: float = 0.0
    heading: float = 0.0


def check_golden(bundle: Bundle, runtime: PolicyRuntime) -> GoldenResult:
    """Feed the recorded robot states through observation and network and compare with the recording.

    Args:
        bundle: A verified bundle.
        runtime: The network; it is reset before and after.

    Returns:
        The largest differences, all within ``bundle.golden.atol``.

    Raises:
        BundleError: The trace cannot be read, has wrong shapes, or is not reproduced.
    """
    trace = _load(bundle)
    policy = Policy(bundle, runtime)
    compared = ["obs", "action", "target", *(["terrain", "heading"] if bundle.depth is not None else [])]
    worst = dict.fromkeys(compared, 0.0)
    try:
        for tick, state in enumerate(golden_states(trace)):
            if trace["reset"][tick]:
                policy.reset()
            camera = partial(_frame, trace, tick)
            step = policy.step(state, trace["command"][tick].astype(np.float64), camera)
            for name in compared:
                found = getattr(step.seen if name in ("terrain", "heading") else step, name)
                difference = float(np.max(np.abs(found - trace[name][tick])))
                if not difference <= bundle.golden.atol:
                    raise BundleError(
                        f"{bundle.path(bundle.golden.file)}: tick {tick}: {name} differs by {difference:.3g}, "
                        f"more than {bundle.golden.atol:g}; the network or the observation is not the one that "
                        "was exported: export the bundle again with matching versions"
                    )
                worst[name] = max(worst[name], difference)
        policy.reset()
    finally:
        policy.close()
    return GoldenResult(ticks=bundle.golden.ticks, **worst)


def golden_states(trace: Trace) -> Iterator[RobotState]:
    """The raw states of a golden trace, tick by tick."""
    none = np.zeros(0)
    for tick in range(len(trace["reset"])):
        row = {key: trace[key][tick].astype(np.float64) for key in ("q", "dq", "quat_wxyz", "gyro")}
        contact = trace["contact"][tick].astype(np.bool_) if "contact" in trace else None
        yield RobotState(stamp_ns=0, seq=tick, tau=none, acc=none, contact=contact, **row)


def _frame(trace: Trace, tick: int) -> DepthFrame | None:
    """The image that the golden trace recorded at a tick."""
    if not trace["depth_due"][tick]:
        return None
    image = trace["depth"][int(trace["depth_due"][:tick].sum())]
    return DepthFrame(stamp_ns=0, seq=tick, image_m=image.astype(np.float32), prepared=True)


def _load(bundle: Bundle) -> Trace:
    path = bundle.path(bundle.golden.file)
    joints, ticks = len(bundle.joints), bundle.golden.ticks
    shapes = {
        "quat_wxyz": (ticks, 4),
        "gyro": (ticks, 3),
        "q": (ticks, joints),
        "dq": (ticks, joints),
        "command": (ticks, 3),
        "reset": (ticks,),
        "obs": (ticks, bundle.observation_size),
        "action": (ticks, joints),
        "target": (ticks, joints),
    }
    optional = {"contact": (ticks, len(bundle.robot.feet))}
    if depth := bundle.depth:
        shapes["depth_due"] = (ticks,)
        shapes |= {name: (ticks, *depth.graph.outputs[name][1:]) for name in ("terrain", "heading")}
    try:
        with np.load(path, allow_pickle=False) as archive:
            shapes |= {name: shape for name, shape in optional.items() if bundle.feels_feet or name in archive}
            if depth:
                count = int(archive["depth_due"].sum())
                shapes["depth"] = (count, depth.optics.rows, depth.optics.columns)
            trace = {name: archive[name] for name in shapes}
    except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise BundleError(f"{path}: not a golden trace ({error}); export the bundle again") from error
    for name, shape in shapes.items():
        if trace[name].shape != shape:
            raise BundleError(
                f"{path}: {name} has shape {trace[name].shape}, expected {shape}; export the bundle again"
            )
    return trace
