"""Writes MCAP with ROS 2 messages from a thread of its own; no ROS needed to write or to read it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from itertools import count
from pathlib import Path
from queue import Full, Queue
from threading import Thread
from types import TracebackType

from mcap.writer import Writer

from deploy.bundles.loading import MANIFEST
from deploy.bundles.manifest import Bundle
from deploy.errors import LogError
from deploy.logs.messages import TOPICS, Composer, Encoder, Sample
from deploy.logs.metadata import RunInfo, sealed
from deploy.logs.provenance import provenance
from deploy.logs.storage import ReservedFile

FLUSH_TICKS = 10
"""Ticks in a chunk: at 50 Hz a killed process loses 0.2 s, and what the queue holds."""

QUEUE_TICKS = {True: 500, False: 5}
"""Ticks that may wait for the disk: in real time it may stall for 10 s at 50 Hz, a simulation waits for it."""

COPIES = {"run": 2}
"""Metadata written more than once: without it a damaged log means nothing."""

MAX_SCENE = 2**20
"""Largest scene that goes into every log, bytes; it lets the run be drawn again."""

CLOSED = "closed"
"""Metadata at the end of a log that was closed: its number of ticks, and how many it had to leave out."""


def library(release: str) -> str:
    """What a log says of its writer."""
    return f"legged-deploy {release}"


def partial_path(path: Path) -> Path:
    """Where a log grows until it is complete."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def _set_aside(partial: Path) -> None:
    """Keep what a killed run left: it may be the only witness."""
    if partial.is_file():
        taken = (partial.with_name(f"{partial.stem}-{number}.mcap") for number in count(1))
        partial.rename(next(path for path in taken if not path.exists()))


class LogWriter:
    """A context manager that writes one log.

    `write` only queues; a thread encodes, compresses and writes, so that no disk delays the robot. The log
    grows beside its final place and moves there when it is closed, also after an error: a file under the
    final name is always complete, and an older one stays until then.

    Attributes:
        failure: Why the log cannot go on, beginning with `log: `; None while all is well. It comes from the
            thread: whoever drives the robot looks at it every tick and comes to an end.
        dropped: Ticks left out because the disk was too slow.
    """

    def __init__(self, path: str | Path, bundle: Bundle, info: RunInfo, realtime: bool = False) -> None:
        """Open the log and write what does not change: robot, manifest, metadata.

        Args:
            path: Final path, suffix .mcap.
            bundle: What runs.
            info: What is asked for.
            realtime: Leave out a tick rather than wait for a slow disk.

        Raises:
            LogError: The path has another suffix or cannot be written.
        """
        self._path = Path(path)
        if self._path.suffix != ".mcap":
            raise LogError(f"{self._path}: a log's name must end in .mcap, other readers go by it")
        self._partial = partial_path(self._path)
        self._encoder = Encoder()
        self._composer = Composer(bundle, self._encoder)
        self._ticks = 0
        self._realtime = realtime
        self._queue: Queue[Sample | tuple[str, dict[str, str]] | None] = Queue(QUEUE_TICKS[realtime])
        self._broken: Exception | None = None
        self.failure: str | None = None
        self.dropped = 0
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            _set_aside(self._partial)
            self._file = ReservedFile(self._partial)
            try:
                self._begin(bundle, info)
            except BaseException:
                self._file.close()
                raise
        except OSError as error:
            raise LogError(
                f"{self._partial}: cannot write the log ({error}); free space or choose another path"
            ) from error
        self._whole = self._file.tell()
        self._thread = Thread(target=self._work, name="log", daemon=True)
        self._thread.start()

    def _begin(self, bundle: Bundle, info: RunInfo) -> None:
        self._writer = Writer(self._file, chunk_size=2**30)  # type: ignore[arg-type]
        self._writer.start(profile="ros2", library=library(info.version))
        self._channels = register(self._writer, self._encoder)
        urdf = bundle.path(bundle.robot.urdf).read_bytes()
        manifest = bundle.path(MANIFEST).read_bytes()
        facts = json.loads(manifest)
        networks = [facts[part]["file"] for part in ("policy", "depth") if part in facts]
        self._metadata("run", sealed(asdict(info)))
        self._metadata(
            "policy",
            sealed(
                {
                    "sha256": {name: facts["files"][name] for name in networks},
                    "scales": info.design,
                    "exported_by": facts["generator"],
                }
            ),
        )
        self._metadata("provenance", sealed(provenance()))
        self._writer.add_attachment(0, 0, "robot.urdf", "application/xml", urdf)
        self._writer.add_attachment(0, 0, MANIFEST, "application/json", manifest)
        scene = bundle.path(bundle.robot.scene)
        if scene.stat().st_size <= MAX_SCENE:
            self._writer.add_attachment(0, 0, "scene.xml", "application/xml", scene.read_bytes())
        self._description = urdf.decode("utf-8")

    def _metadata(self, name: str, values: dict[str, str]) -> None:
        for _ in range(COPIES.get(name, 1)):
            self._writer.add_metadata(name, values)

    def add_metadata(self, name: str, values: Mapping[str, object]) -> None:
        """Add a metadata record; values are kept as JSON text."""
        self._queue.put((name, sealed(values)))

    def write(self, sample: Sample) -> None:
        """Queue a tick; its messages are stamped with its start. Raises nothing: see `failure`."""
        if not self._realtime:
            self._queue.put(sample)
            return
        try:
            self._queue.put_nowait(sample)
        except Full:
            self.dropped += 1

    def drain(self) -> None:
        """Wait until everything queued has been handled."""
        self._queue.join()

    def _work(self) -> None:
        """The thread: goes on emptying the queue after a failure, so that nobody waits for it."""
        while True:
            item = self._queue.get()
            try:
                if self._broken is None:
                    self._handle(item)
            except Exception as error:  # whatever goes wrong in here must stop the robot softly
                self._broken = error
                self.failure = f"log: cannot go on writing {self._partial} ({error})"
            finally:
                self._queue.task_done()
            if item is None:
                return

    def _handle(self, item: Sample | tuple[str, dict[str, str]] | None) -> None:
        match item:
            case None:
                self._writer.flush()
                self._metadata(CLOSED, sealed({"ticks": self._ticks, "dropped": self.dropped}))
                self._writer.finish()
            case Sample():
                self._add(item)
                self._ticks += 1
                if self._ticks % FLUSH_TICKS == 0:
                    self._writer.flush()
                    self._whole = self._file.tell()
            case (name, values):
                self._metadata(name, values)
        if self._file.full and self.failure is None:
            self.failure = f"log: no space left on the disk of {self._path}; free some before the next run"

    def _add(self, sample: Sample) -> None:
        slot = sample.tick.slot
        messages = list(self._composer.messages(sample))
        if self._ticks == 0:
            messages.insert(0, ("/robot_description", self._composer.text(self._description)))
        for topic, message in messages:
            self._writer.add_message(
                self._channels[topic],
                log_time=slot.start_ns,
                data=self._encoder.encode(message),
                publish_time=slot.start_ns,
                sequence=slot.index,
            )

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the log.

        Raises:
            LogError: The disk refused; what it took is under the partial name.
        """
        self._queue.put(None)
        self._thread.join()
        try:
            if self._broken is not None:
                self._file.cut(self._whole)  # half a chunk is worth nothing and takes room
            self._file.close()
            if self._broken is None:
                os.replace(self._partial, self._path)
        except OSError as failure:
            self._broken = self._broken or failure
        if self._broken is not None:
            raise LogError(
                f"{self._partial}: the log ends early ({self._broken}); `deploy recover {self._partial}` makes "
                "what is there readable; free space or choose another path for the next run"
            ) from (error or self._broken)


def register(writer: Writer, encoder: Encoder) -> dict[str, int]:
    """Register all schemas and channels.

    Returns:
        The channel of each topic.
    """
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for topic, typename in TOPICS.items():
        if typename not in schemas:
            schemas[typename] = writer.register_schema(typename, "ros2msg", encoder.definition(typename).encode())
        channels[topic] = writer.register_channel(topic, "cdr", schemas[typename])
    return channels
