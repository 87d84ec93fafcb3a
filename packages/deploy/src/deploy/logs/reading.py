"""Reads a log back: metadata and attachments with mcap, messages with rosbags from the schemas in the file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from deploy.bundles.loading import MANIFEST
from deploy.errors import LogError
from deploy.interfaces import Array
from deploy.logs.metadata import RunInfo, opened
from deploy.logs.trace import Trace, stack

NEEDED = ("/joint_states", "/controller", "/timing", "/power")
OPTIONAL = ("/joint_commands", "/ground_truth", "/depth/image")

CUT_OFF = "log ends while the robot was running"
"""Reason of a run whose log does not show its end."""


@dataclass(frozen=True)
class Log:
    """A log as a whole.

    Attributes:
        path: The file.
        info: What was run.
        trace: Its ticks.
        metadata: All metadata records by name, values decoded.
        joint_names: In the order of the trace's arrays.
        urdf: Description of the robot; empty if a damaged file lost it.
        scene: MJCF of the bundle's scene; empty where the log has none.
        manifest: Manifest of the bundle; None if a damaged file lost it.
        depth_time: Ticks on which an image entered the network, shape (K,), s.
        depth: Those images, shape (K, rows, columns), as the network read them.
    """

    path: Path
    info: RunInfo
    trace: Trace
    metadata: Mapping[str, Mapping[str, Any]]
    joint_names: tuple[str, ...]
    urdf: str
    scene: str
    manifest: Mapping[str, Any] | None
    depth_time: Array
    depth: NDArray[np.float32]


def read_log(path: str | Path) -> Log:
    """Read and check a log.

    Args:
        path: A complete .mcap file of this package.

    Raises:
        LogError: The file is missing, torn, altered, or not a log of this package.
    """
    path = Path(path)
    if not path.is_file():
        raise LogError(f"{path}: no such log; give the .mcap that `deploy run` wrote")
    try:
        with path.open("rb") as stream:
            extras = [
                record
                for record in StreamReader(stream, validate_crcs=True).records
                if isinstance(record, Metadata | Attachment)
            ]
        with AnyReader([path]) as reader:
            connections = [c for c in reader.connections if c.topic in NEEDED + OPTIONAL]
            messages: list[tuple[int, str, Any]] = [
                (time, connection.topic, reader.deserialize(raw, connection.msgtype))
                for connection, time, raw in reader.messages(connections=connections)
            ]
    except Exception as error:  # on torn bytes the readers raise whatever their parsing meets
        raise LogError(
            f"{path}: torn or altered log ({type(error).__name__}: {error}); "
            f"`deploy recover {path}` keeps what is intact"
        ) from error
    metadata = {record.name: opened(record.metadata) for record in extras if isinstance(record, Metadata)}
    if altered := sorted(name for name, values in metadata.items() if values is None):
        raise LogError(
            f"{path}: torn or altered log (metadata {altered[0]!r} fails its checksum); "
            f"`deploy recover {path}` keeps what is intact"
        )
    intact = {name: values for name, values in metadata.items() if values is not None}
    if "run" not in intact:
        raise LogError(f"{path}: no metadata record 'run'; only logs of `deploy run` can be reported")
    try:
        run = intact["run"]
        info = RunInfo(**{**run, "command": tuple(run["command"])})
    except (KeyError, TypeError) as error:
        raise LogError(
            f"{path}: metadata 'run' has other fields ({error}); read it with the version that wrote it"
        ) from error
    attached: dict[str, bytes] = {record.name: record.data for record in extras if isinstance(record, Attachment)}
    if MANIFEST in attached and hashlib.sha256(attached[MANIFEST]).hexdigest() != info.bundle_sha256:
        raise LogError(
            f"{path}: torn or altered log ({MANIFEST} is not the one that ran); "
            f"`deploy recover {path}` keeps what is intact"
        )
    names = next((tuple(message.name) for _, topic, message in messages if topic == "/joint_states"), ())
    depth = [(time * 1e-9, _pixels(message)) for time, topic, message in messages if topic == "/depth/image"]
    return Log(
        path=path,
        info=info,
        trace=_trace(path, messages),
        metadata=intact,
        joint_names=names,
        urdf=attached.get("robot.urdf", b"").decode("utf-8"),
        scene=attached.get("scene.xml", b"").decode("utf-8"),
        manifest=json.loads(attached[MANIFEST]) if MANIFEST in attached else None,
        depth_time=np.array([time for time, _ in depth]),
        depth=np.array([image for _, image in depth], dtype=np.float32),
    )


def _pixels(message: Any) -> NDArray[np.float32]:
    return message.data.view("<f4").reshape(message.height, message.width)


def _trace(path: Path, messages: Iterable[tuple[int, str, Any]]) -> Trace:
    ticks: dict[int, dict[str, Any]] = {}
    for time, topic, message in messages:
        ticks.setdefault(time, {})[topic] = message
    rows, reason = [], ""
    for time, tick in sorted(ticks.items()):
        if absent := [topic for topic in NEEDED if topic not in tick]:
            raise LogError(f"{path}: no {absent[0]} at {time} ns; the log is incomplete: run again")
        rows.append(_row(time, tick))
        reason = tick["/controller"].reason
    if not rows:
        raise LogError(f"{path}: holds no tick; run again")
    return stack(rows, reason or CUT_OFF)


def _row(time_ns: int, tick: Mapping[str, Any]) -> dict[str, Any]:
    joints, power, timing = tick["/joint_states"], tick["/power"], tick["/timing"]
    sent = tick.get("/joint_commands")
    return {
        "mode": tick["/controller"].mode,
        "time": time_ns * 1e-9,
        "due": timing.due_ns * 1e-9,
        "done": timing.done_ns * 1e-9,
        "q": joints.position,
        "q_target": np.full(len(joints.position), np.nan) if sent is None else sent.position,
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
