"""Write a run as MCAP with ROS 2 messages; no ROS needed to write or to read it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType

from mcap.writer import Writer

from deploy.bundles.loading import MANIFEST
from deploy.bundles.manifest import Bundle
from deploy.errors import LogError
from deploy.logs.messages import TOPICS, Encoder, Sample

FLUSH_TICKS = 25
"""Ticks between flushes: a killed process loses half a second at 50 Hz."""


@dataclass(frozen=True)
class RunInfo:
    """What was run; kept in the log as metadata so that a report needs nothing else.

    Units: `total_mass` in kg, `policy_hz` in Hz, `command` (vx, vy, yaw_rate) in m/s and rad/s, `duration_s`
    of full control by the policy in s.
    """

    bundle: str
    bundle_sha256: str
    robot: str
    design: Mapping[str, float]
    total_mass: float
    policy_hz: float
    command: tuple[float, float, float]
    duration_s: float
    seed: int
    version: str


def partial_path(path: Path) -> Path:
    """Where a log grows until it is complete."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


class LogWriter:
    """A context manager that writes one log.

    The log grows beside its final place and moves there when it is closed, also after an error: a file under
    the final name is always complete, and an older one stays until then.
    """

    def __init__(self, path: str | Path, bundle: Bundle, info: RunInfo) -> None:
        """Open the log and write what does not change: robot, manifest, metadata.

        Args:
            path: Final path, suffix .mcap.
            bundle: What runs.
            info: What is asked for.

        Raises:
            LogError: The path has another suffix or cannot be written.
        """
        self._path = Path(path)
        if self._path.suffix != ".mcap":
            raise LogError(f"{self._path}: a log's name must end in .mcap, other readers go by it")
        self._partial = partial_path(self._path)
        self._encoder = Encoder(bundle)
        self._channels: dict[str, int] = {}
        self._ticks = 0
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._partial.open("wb")
            self._writer = Writer(self._stream)
            self._writer.start(profile="ros2", library=f"legged-deploy {info.version}")
            self._register_topics()
            self.add_metadata("run", asdict(info))
            urdf = bundle.path(bundle.robot.urdf).read_bytes()
            manifest = bundle.path(MANIFEST).read_bytes()
            self._writer.add_attachment(0, 0, "robot.urdf", "application/xml", urdf)
            self._writer.add_attachment(0, 0, MANIFEST, "application/json", manifest)
        except OSError as error:
            raise self._unwritable(error) from error
        self._description = urdf.decode("utf-8")

    def _register_topics(self) -> None:
        schemas: dict[str, int] = {}
        for topic, typename in TOPICS.items():
            if typename not in schemas:
                text = self._encoder.definition(typename)
                schemas[typename] = self._writer.register_schema(typename, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schemas[typename])

    def _unwritable(self, error: OSError) -> LogError:
        return LogError(f"{self._partial}: cannot write the log ({error}); free space or choose another path")

    def add_metadata(self, name: str, values: Mapping[str, object]) -> None:
        """Add a metadata record; values are kept as JSON text."""
        self._writer.add_metadata(name, {key: json.dumps(value) for key, value in values.items()})

    def write(self, sample: Sample) -> None:
        """Add all messages of a tick, stamped with its start.

        Raises:
            LogError: The disk refuses.
        """
        slot = sample.tick.slot
        try:
            if self._ticks == 0:
                self._add("/robot_description", self._encoder.text(self._description), slot.start_ns, slot.index)
            for topic, message in self._encoder.messages(sample):
                self._add(topic, message, slot.start_ns, slot.index)
            self._ticks += 1
            if self._ticks % FLUSH_TICKS == 0:
                self._writer.flush()
        except OSError as error:
            raise self._unwritable(error) from error

    def _add(self, topic: str, message: object, time_ns: int, sequence: int) -> None:
        self._writer.add_message(
            self._channels[topic],
            log_time=time_ns,
            data=self._encoder.encode(message),
            publish_time=time_ns,
            sequence=sequence,
        )

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._writer.finish()
            self._stream.close()
            os.replace(self._partial, self._path)
        except OSError as failure:
            raise self._unwritable(failure) from (error or failure)
