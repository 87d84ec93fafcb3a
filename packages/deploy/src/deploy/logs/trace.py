"""A run as arrays, one row per tick: kept while running, or read back from a log."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from deploy.errors import LogError
from deploy.interfaces import Array
from deploy.logs.messages import Sample
from deploy.logs.writer import RunInfo
from deploy.policy.observation import rotate_inverse

READ_TOPICS = ("/joint_states", "/controller", "/timing", "/power", "/ground_truth")


@dataclass(frozen=True)
class Trace:
    """One row per tick; NaN where nothing measured it.

    Attributes:
        mode: Mode of the controller, shape (T,).
        reason: Why the run ended.
        time: On the robot's clock, shape (T,), s.
        dq: Shape (T, 12), rad/s.
        tau: Shape (T, 12), N m.
        late: Shape (T,).
        skipped: Shape (T,).
        clamped: Shape (T,).
        joint_energy_pos_j: Positive work of each joint since the start at the rate of the state, shape (T, 12), J.
        states: States summed into it, shape (T,); 0 where nothing measured it.
        peak_w: Peak positive power since the previous tick, shape (T,), W.
        position: Base in the world, shape (T, 3), m.
        quat_wxyz: True orientation of the base, shape (T, 4).
        velocity: Base frame, shape (T, 3), m/s.
        yaw_rate: Base frame, shape (T,), rad/s.
    """

    mode: NDArray[np.str_]
    reason: str
    time: Array
    dq: Array
    tau: Array
    late: NDArray[np.bool_]
    skipped: NDArray[np.int64]
    clamped: NDArray[np.int64]
    joint_energy_pos_j: Array
    states: NDArray[np.int64]
    peak_w: Array
    position: Array
    quat_wxyz: Array
    velocity: Array
    yaw_rate: Array


class TraceRecorder:
    """Collects the rows of a `Trace`."""

    def __init__(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self._reason = ""

    def add(self, sample: Sample) -> None:
        """Keep one tick."""
        tick, truth, energy = sample.tick, sample.truth, sample.energy
        self._reason = tick.reason
        self._rows.append(
            {
                "mode": tick.mode.value,
                "time": tick.slot.start_ns * 1e-9,
                "dq": tick.state.dq,
                "tau": tick.state.tau,
                "late": tick.slot.late,
                "skipped": tick.slot.skipped,
                "clamped": tick.clamped,
                "joint_energy_pos_j": np.full(12, np.nan) if energy is None else energy.joint_energy_pos_j,
                "states": 0 if energy is None else energy.states,
                "peak_w": np.nan if energy is None else energy.peak_pos_w,
                "position": np.full(3, np.nan) if truth is None else truth.position,
                "quat_wxyz": np.full(4, np.nan) if truth is None else truth.quat_wxyz,
                "velocity": np.full(3, np.nan) if truth is None else rotate_inverse(truth.quat_wxyz, truth.velocity),
                "yaw_rate": np.nan if truth is None else truth.angular_velocity[2],
            }
        )

    def trace(self) -> Trace:
        """The rows so far."""
        return _stack(self._rows, self._reason)


def _stack(rows: list[dict[str, Any]], reason: str) -> Trace:
    columns = {f.name: np.array([row[f.name] for row in rows]) for f in fields(Trace) if f.name != "reason"}
    return Trace(reason=reason, **columns)


def read_log(path: str | Path) -> tuple[RunInfo, Trace]:
    """Read a log back: metadata with mcap, messages with rosbags from the schemas that the log carries.

    Args:
        path: A complete .mcap file of this package.

    Returns:
        What was run, and its trace.

    Raises:
        LogError: The file is missing, torn, altered, or not a log of this package.
    """
    path = Path(path)
    if not path.is_file():
        raise LogError(f"{path}: no such log; give the .mcap that `deploy run` wrote")
    try:
        with path.open("rb") as stream:
            records = {
                record.name: record.metadata
                for record in StreamReader(stream, validate_crcs=True).records
                if isinstance(record, Metadata)
            }
        with AnyReader([path]) as reader:
            connections = [c for c in reader.connections if c.topic in READ_TOPICS]
            messages = [
                (time, connection.topic, reader.deserialize(raw, connection.msgtype))
                for connection, time, raw in reader.messages(connections=connections)
            ]
    except Exception as error:  # on torn bytes the readers raise whatever their parsing meets
        raise LogError(
            f"{path}: torn or altered log ({type(error).__name__}: {error}); a run that was cut off leaves "
            "such a file: run again, or recover its chunks with an MCAP tool"
        ) from error
    if "run" not in records:
        raise LogError(f"{path}: no metadata record 'run'; only logs of `deploy run` can be reported")
    values = {key: json.loads(text) for key, text in records["run"].items()}
    info = RunInfo(**{**values, "command": tuple(values["command"])})
    return info, _trace(path, messages)


def _trace(path: Path, messages: Iterable[tuple[int, str, Any]]) -> Trace:
    ticks: dict[int, dict[str, Any]] = {}
    for time, topic, message in messages:
        ticks.setdefault(time, {})[topic] = message
    rows, reason = [], ""
    for time, tick in sorted(ticks.items()):
        if absent := [topic for topic in READ_TOPICS[:-1] if topic not in tick]:
            raise LogError(f"{path}: no {absent[0]} at {time} ns; the log is incomplete: run again")
        joints, power, timing = tick["/joint_states"], tick["/power"], tick["/timing"]
        reason = tick["/controller"].reason
        rows.append(
            {
                "mode": tick["/controller"].mode,
                "time": time * 1e-9,
                "dq": joints.velocity,
                "tau": joints.effort,
                "late": timing.late,
                "skipped": timing.skipped,
                "clamped": tick["/controller"].clamped,
                "joint_energy_pos_j": power.joint_energy_pos_j,
                "states": power.states,
                "peak_w": power.peak_w,
                **_odometry(tick.get("/ground_truth")),
            }
        )
    if not rows:
        raise LogError(f"{path}: holds no tick; run again")
    return _stack(rows, reason)


def _odometry(message: Any) -> dict[str, Any]:
    if message is None:
        nothing = {"position": 3, "quat_wxyz": 4, "velocity": 3}
        return {**{name: np.full(size, np.nan) for name, size in nothing.items()}, "yaw_rate": np.nan}
    p, o = message.pose.pose.position, message.pose.pose.orientation
    v = message.twist.twist.linear
    return {
        "position": np.array([p.x, p.y, p.z]),
        "quat_wxyz": np.array([o.w, o.x, o.y, o.z]),
        "velocity": np.array([v.x, v.y, v.z]),
        "yaw_rate": message.twist.twist.angular.z,
    }
