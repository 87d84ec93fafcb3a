"""Makes a torn or damaged log readable again and says what is lost."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from deploy.bundles.loading import MANIFEST
from deploy.errors import LogError
from deploy.logs.messages import TOPICS, Encoder
from deploy.logs.metadata import opened, sealed
from deploy.logs.salvage import Salvage, salvage
from deploy.logs.writer import CLOSED, library, partial_path

EXPECTED_ATTACHMENTS = ("robot.urdf", MANIFEST)
EXPECTED_METADATA = ("run", "policy", "provenance")


@dataclass(frozen=True)
class Gap:
    """A stretch without ticks, between two that are left, s on the robot's clock; None where none is left."""

    after_s: float | None
    before_s: float | None

    def __str__(self) -> str:
        if self.after_s is None:
            return f"before {self.before_s:.2f} s"
        return f"after {self.after_s:.2f} s" + ("" if self.before_s is None else f" and before {self.before_s:.2f} s")


@dataclass(frozen=True)
class Recovery:
    """What a recovery kept and what it could not.

    Attributes:
        source: The damaged log.
        out: The recovered one.
        ticks: Ticks kept.
        messages: Messages kept.
        ticks_lost: Exact; None for a log that was never closed, whose own count is missing.
        gaps: Where ticks are lost.
        lost: Attachments and metadata records that are lost.
        damaged_bytes: Bytes of the source that belong to nothing intact.
    """

    source: str
    out: str
    ticks: int
    messages: int
    ticks_lost: int | None
    gaps: tuple[Gap, ...]
    lost: tuple[str, ...]
    damaged_bytes: int

    def sentences(self) -> list[str]:
        """The same in words."""
        said = [f"{self.out}: {self.ticks} ticks, {self.messages} messages, each proved by a checksum."]
        if self.ticks_lost == 0:
            said.append("No tick is lost.")
        elif self.ticks_lost is not None:
            said.append(f"Lost: {self.ticks_lost} of {self.ticks + self.ticks_lost} ticks.")
        else:
            said.append(
                "The log was not closed: what came after its last tick is lost; a kill costs half a second at most."
            )
        said += [f"Lost: ticks {gap}." for gap in self.gaps]
        said += [f"Lost: {name}." for name in self.lost]
        if self.damaged_bytes:
            said.append(f"{self.damaged_bytes} damaged bytes were left out; {self.source} is unchanged.")
        return said


def recover(source: str | Path, out: str | Path | None = None) -> Recovery:
    """Write a readable copy of everything in a log that a checksum proves intact.

    Args:
        source: A log that was cut off while written, truncated or altered. It is not changed.
        out: Where the copy goes; beside the source, ending in `.recovered.mcap`, if None.

    Returns:
        What was kept and what is lost. Two libraries have read the copy back before it got its name.

    Raises:
        LogError: Nothing can be kept, or the copy cannot be written.
    """
    source = Path(source)
    out = Path(out) if out is not None else source.with_name(f"{source.stem.removesuffix('.partial')}.recovered.mcap")
    if not source.is_file():
        raise LogError(f"{source}: no such log; give the file that a run left behind")
    if out.resolve() == source.resolve() or out.suffix != ".mcap":
        raise LogError(f"{out}: choose another file, ending in .mcap, for the recovered log")
    data = source.read_bytes()
    found = salvage(data)
    if not any(isinstance(record, Message) for chunk in found.chunks for record in chunk):
        raise LogError(f"{source}: no tick in it is intact, there is nothing to recover")
    schemas, channels = _definitions(source, data, found)
    recovery = _describe(source, out, found)
    partial = partial_path(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        _write(partial, found, schemas, channels, recovery)
        _verify(partial, recovery.messages)
        os.replace(partial, out)
    except OSError as error:
        raise LogError(f"{out}: cannot write the recovered log ({error}); choose another path with --out") from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
    return recovery


def _describe(source: Path, out: Path, found: Salvage) -> Recovery:
    times = [[record.log_time for record in chunk if isinstance(record, Message)] for chunk in found.chunks]
    ticks = np.unique([time for chunk in times for time in chunk])
    closed = opened(found.metadata[CLOSED]) if CLOSED in found.metadata else None
    missing = None if closed is None else int(closed["ticks"]) - len(ticks)
    period = float(np.median(np.diff(ticks))) if len(ticks) > 1 else 0.0
    gaps = []
    for index in sorted(set(found.broken_before)) if missing != 0 else ():
        after = max(times[index - 1]) if index else None
        before = min(times[index]) if index < len(times) else None
        if after is None and found.first_sequence == 0:
            continue  # what stands before the first chunk was hit
        if after is None or before is None or before - after > 1.5 * period:
            gaps.append(Gap(*(None if time is None else time * 1e-9 for time in (after, before))))
    lost = [f"attachment {name}" for name in EXPECTED_ATTACHMENTS if name not in found.attachments]
    lost += [f"metadata {name}" for name in EXPECTED_METADATA if name not in found.metadata]
    return Recovery(
        source=str(source),
        out=str(out),
        ticks=len(ticks),
        messages=sum(map(len, times)),
        ticks_lost=missing,
        gaps=tuple(gaps),
        lost=tuple(lost),
        damaged_bytes=found.damaged_bytes,
    )


def _definitions(source: Path, data: bytes, found: Salvage) -> tuple[dict[int, Schema], dict[int, Channel]]:
    """Schemas and channels by number: from the first chunk, or this package's own if that is lost."""
    records = [record for chunk in found.chunks for record in chunk]
    schemas = {record.id: record for record in records if isinstance(record, Schema)}
    channels = {record.id: record for record in records if isinstance(record, Channel)}
    if {record.channel_id for record in records if isinstance(record, Message)} <= channels.keys():
        return schemas, channels
    if library(version("legged-deploy")).encode() not in data[:256]:
        raise LogError(
            f"{source}: the message definitions are damaged; recover it with the version of legged-deploy that wrote it"
        )
    names = list(dict.fromkeys(TOPICS.values()))
    encoder = Encoder()
    schemas = {
        number: Schema(data=encoder.definition(name).encode(), encoding="ros2msg", id=number, name=name)
        for number, name in enumerate(names, start=1)
    }
    channels = {
        number: Channel(
            id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=names.index(typename) + 1
        )
        for number, (topic, typename) in enumerate(TOPICS.items(), start=1)
    }
    return schemas, channels


def _write(
    path: Path,
    found: Salvage,
    schemas: Mapping[int, Schema],
    channels: Mapping[int, Channel],
    recovery: Recovery,
) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2**30)
        writer.start(profile="ros2", library=library(version("legged-deploy")))
        for name, texts in found.metadata.items():
            writer.add_metadata(name, texts)
        writer.add_metadata("recovery", sealed(asdict(recovery)))
        for record in found.attachments.values():
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
        schema_ids = {old: writer.register_schema(s.name, s.encoding, s.data) for old, s in schemas.items()}
        channel_ids = {
            old: writer.register_channel(c.topic, c.message_encoding, schema_ids[c.schema_id], c.metadata)
            for old, c in channels.items()
        }
        for chunk in found.chunks:
            for record in chunk:
                if isinstance(record, Message):
                    writer.add_message(
                        channel_ids[record.channel_id],
                        record.log_time,
                        record.data,
                        record.publish_time,
                        record.sequence,
                    )
            writer.flush()
        writer.finish()


def _verify(path: Path, messages: int) -> None:
    """Count what mcap and rosbags read; a recovery that nobody can open is none."""
    with path.open("rb") as stream:
        by_mcap = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
    with AnyReader([path]) as reader:
        by_rosbags = sum(1 for _ in reader.messages())
    if not messages == by_mcap == by_rosbags:
        raise LogError(
            f"{path}: {messages} messages were written, mcap reads {by_mcap} and rosbags {by_rosbags}; "
            "keep the damaged log and report this"
        )
