"""Replay the recorded trace of a bundle before anything moves."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.errors import BundleError
from deploy.interfaces import PolicyRuntime, RobotState
from deploy.policy.tick import Policy

COMPARED = ("obs", "action", "target")


@dataclass(frozen=True)
class GoldenResult:
    """Ticks replayed and the largest absolute difference of each quantity."""

    ticks: int
    obs: float
    action: float
    target: float


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
    none = np.zeros(0)
    worst = dict.fromkeys(COMPARED, 0.0)
    for tick in range(bundle.golden.ticks):
        if trace["reset"][tick]:
            policy.reset()
        row = {key: trace[key][tick].astype(np.float64) for key in ("q", "dq", "quat_wxyz", "gyro")}
        state = RobotState(stamp_ns=0, seq=tick, tau=none, acc=none, **row)
        step = policy.step(state, trace["command"][tick].astype(np.float64))
        for name in COMPARED:
            difference = float(np.max(np.abs(getattr(step, name) - trace[name][tick])))
            if not difference <= bundle.golden.atol:
                raise BundleError(
                    f"{bundle.path(bundle.golden.file)}: tick {tick}: {name} differs by {difference:.3g}, "
                    f"more than {bundle.golden.atol:g}; the network or the observation is not the one that "
                    "was exported: export the bundle again with matching versions"
                )
            worst[name] = max(worst[name], difference)
    policy.reset()
    return GoldenResult(ticks=bundle.golden.ticks, **worst)


def _load(bundle: Bundle) -> dict[str, NDArray[np.generic]]:
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
    try:
        with np.load(path, allow_pickle=False) as archive:
            trace = {name: archive[name] for name in shapes}
    except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise BundleError(f"{path}: not a golden trace ({error}); export the bundle again") from error
    for name, shape in shapes.items():
        if trace[name].shape != shape:
            raise BundleError(
                f"{path}: {name} has shape {trace[name].shape}, expected {shape}; export the bundle again"
            )
    return trace
