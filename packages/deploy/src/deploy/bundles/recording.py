"""Make the golden trace of a bundle anew, from what a robot measured: `deploy record-golden`."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.golden import check_golden, golden_states
from deploy.bundles.loading import CHECKSUM, MANIFEST, checksum_line, load_bundle
from deploy.bundles.manifest import Bundle
from deploy.control.binding import JointBinding
from deploy.errors import BundleError, LogError
from deploy.interfaces import DepthFrame
from deploy.policy.onnx_runtime import OnnxRuntime
from deploy.policy.tick import Policy
from deploy.robots.replay_robot import LoggedTick, ReplayRobot

TICKS = 256
"""Most ticks of a trace."""


def record_golden(log: str | Path, bundle: Bundle, out: str | Path, ticks: int = TICKS) -> Path:
    """Copy a bundle and give it a golden trace of real readings.

    The trace starts where the policy took over, and has a reset in its middle. Whoever runs the copy has to reproduce
    what the networks of `bundle` answer to those readings.

    Args:
        log: A complete .mcap file of this package in which the policy ran.
        bundle: A verified bundle for the same robot.
        out: Folder to create.
        ticks: Most ticks of the trace.

    Returns:
        `out`.

    Raises:
        LogError: The log is no log of this package, or holds too little of the policy.
        BundleError: `out` is there already.
        RobotError: The log is one of a robot with other joints.
    """
    target = Path(out)
    if target.exists():
        raise BundleError(f"{target}: exists already; choose another folder")
    raw = _raw(Path(log), bundle, ticks)
    trace = {**raw, **_answers(bundle, raw)}
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}.") as folder:
        copy = Path(folder) / "bundle"
        shutil.copytree(bundle.root, copy)
        np.savez_compressed(copy / bundle.golden.file, allow_pickle=False, **trace)
        manifest = json.loads((copy / MANIFEST).read_text(encoding="utf-8"))
        golden = (copy / bundle.golden.file).read_bytes()
        manifest["files"][bundle.golden.file] = hashlib.sha256(golden).hexdigest()
        manifest["golden"]["ticks"] = len(trace["reset"])
        text = json.dumps(manifest, indent=2) + "\n"
        (copy / MANIFEST).write_text(text, encoding="utf-8")
        (copy / CHECKSUM).write_text(checksum_line(hashlib.sha256(text.encode()).hexdigest()), encoding="utf-8")
        made = load_bundle(copy)
        check_golden(made, OnnxRuntime(made))
        copy.rename(target)
    return target


def _raw(log: Path, bundle: Bundle, ticks: int) -> dict[str, NDArray[Any]]:
    """The readings of the first time that the policy ran, as far as none is missing, with a reset in the middle."""
    robot = ReplayRobot(log, bundle)
    binding = JointBinding.of(bundle, robot.spec)
    ran = [tick.obs is not None for tick in robot.ticks]
    start = ran.index(True) if True in ran else len(ran)
    end = start + ran[start:].index(False) if False in ran[start:] else len(ran)
    end = next((index for index in range(start + 1, end) if robot.lost_before(index)), end)
    part = robot.ticks[start : min(end, start + ticks)]
    period = 1 if bundle.depth is None else bundle.depth.period_ticks
    pictures = {tick.picture_tick: tick.frame for tick in part if tick.frame is not None}
    if bundle.depth is not None:
        lost = next((due for due in range(0, len(part), period) if due not in pictures), len(part))
        part = part[:lost]
    half = len(part) // 2 // period * period
    if half == 0:
        raise LogError(f"{log}: the policy ran for {len(part)} ticks that can be used; log a longer run")
    return {**_columns(part, binding), **_reset(len(part), half), **_depth(pictures, len(part), period, bundle)}


def _columns(ticks: list[LoggedTick], binding: JointBinding) -> dict[str, NDArray[Any]]:
    states = [binding.state(tick.state) for tick in ticks]
    columns = {name: np.array([getattr(state, name) for state in states]) for name in ("quat_wxyz", "gyro", "q", "dq")}
    columns["command"] = np.array([tick.command for tick in ticks])
    if all(state.contact is not None for state in states):
        columns["contact"] = np.array([state.contact for state in states])
    return columns


def _reset(count: int, half: int) -> dict[str, NDArray[Any]]:
    return {"reset": np.isin(np.arange(count), [0, half])}


def _depth(pictures: dict[int, DepthFrame], count: int, period: int, bundle: Bundle) -> dict[str, NDArray[Any]]:
    if bundle.depth is None:
        return {}
    due = np.arange(count) % period == 0
    return {"depth_due": due, "depth": np.array([pictures[int(tick)].image_m for tick in np.flatnonzero(due)])}


def _answers(bundle: Bundle, raw: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """What the policy makes of the readings."""
    policy = Policy(bundle, OnnxRuntime(bundle))
    names = ["obs", "action", "target", *(["terrain", "heading"] if bundle.depth is not None else [])]
    rows: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    try:
        for tick, state in enumerate(golden_states(raw)):
            if raw["reset"][tick]:
                policy.reset()
            frame = None
            if bundle.depth is not None and raw["depth_due"][tick]:
                image = raw["depth"][int(raw["depth_due"][:tick].sum())]
                frame = DepthFrame(stamp_ns=0, seq=tick, image_m=image, prepared=True)
            step = policy.step(state, raw["command"][tick], lambda frame=frame: frame)
            for name in names:
                rows[name].append(getattr(step.seen if name in ("terrain", "heading") else step, name))
    finally:
        policy.close()
    return {name: np.stack(values) for name, values in rows.items()}
