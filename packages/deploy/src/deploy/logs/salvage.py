"""Finds what is intact in the bytes of a damaged MCAP file; nothing without a checksum is trusted."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from deploy.logs.metadata import opened

ZSTD = struct.pack("<I", 4) + b"zstd"
"""The compression field of a chunk, at `CHUNK_FIELDS` bytes after its opcode: what a lost reader looks for."""

CHUNK_FIELDS = struct.Struct("<BQQQQI")
"""Opcode, length, first and last time, size and CRC-32 of the content before compression."""

MAX_CHUNK = 2**30
"""Content of a chunk, bytes; a damaged size must not ask for all memory."""

RECORD = struct.Struct("<BQ")


@dataclass
class Salvage:
    """What is intact, in the order of the file.

    Attributes:
        chunks: Records of each chunk whose checksum holds.
        broken_before: Indices into `chunks` (or its length) in front of which bytes were damaged.
        attachments: Those whose checksum holds, by name.
        metadata: Those whose checksum holds, by name, as texts.
        damaged_bytes: How many bytes belong to nothing intact.
        complete: The end of the file is there: whoever wrote it had finished.
    """

    chunks: list[list[Schema | Channel | Message]] = field(default_factory=list)
    broken_before: list[int] = field(default_factory=list)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damaged_bytes: int = 0
    complete: bool = False

    @property
    def first_sequence(self) -> int | None:
        """Slot of the first tick that is left; 0 is the first that was written."""
        return next((r.sequence for chunk in self.chunks for r in chunk if isinstance(r, Message)), None)


def salvage(data: bytes) -> Salvage:
    """Walk through the records; where one is damaged, go on at the next that proves intact."""
    found = Salvage()
    position = len(MCAP0_MAGIC)
    if data[:position] != MCAP0_MAGIC:
        found.damaged_bytes += position
    found.complete = data.endswith(MCAP0_MAGIC) and len(data) > 2 * position
    end = len(data) - (position if found.complete else 0)
    while position < end:
        after = _take(data, position, end, found)
        if after is not None:
            position = after
            continue
        resumed = _next_intact(data, position, end)
        found.damaged_bytes += resumed - position
        found.broken_before.append(len(found.chunks))
        position = resumed
    return found


def _take(data: bytes, position: int, end: int, found: Salvage) -> int | None:
    """Keep the record at `position` and return where it ends; None if it is not intact."""
    if position + RECORD.size > end:
        return None
    if data.startswith(ZSTD, position + CHUNK_FIELDS.size):
        chunk = _chunk(data, position, end)
        if chunk is None:
            return None
        found.chunks.append(chunk[0])
        return chunk[1]
    opcode, length = RECORD.unpack_from(data, position)
    body, after = position + RECORD.size, position + RECORD.size + length
    if after > end:
        return None
    content = data[body:after]
    if opcode == Opcode.METADATA:
        record = _metadata(content)
        if record is None:
            return None
        found.metadata[record.name] = record.metadata
    elif opcode == Opcode.ATTACHMENT:
        attachment = _attachment(content)
        if attachment is None:
            return None
        found.attachments[attachment.name] = attachment
    elif opcode == Opcode.MESSAGE_INDEX:
        if length < 6 or length != 6 + struct.unpack_from("<I", content, 2)[0]:
            return None
    elif opcode == Opcode.HEADER:
        if length != _strings_size(content, 2):
            return None
    elif not 1 <= opcode <= Opcode.DATA_END or opcode == Opcode.CHUNK:
        return None
    return after


def _chunk(data: bytes, position: int, end: int) -> tuple[list[Schema | Channel | Message], int] | None:
    """Records of the chunk at `position` and its end, or None. Only the inner lengths count."""
    _, _, first, last, size, crc = CHUNK_FIELDS.unpack_from(data, position)
    start = position + CHUNK_FIELDS.size + len(ZSTD) + 8
    if start > end or size > MAX_CHUNK or crc == 0:
        return None
    (stored,) = struct.unpack_from("<Q", data, start - 8)
    packed = data[start : start + stored]
    try:
        if start + stored > end or zstandard.frame_content_size(packed) != size:
            return None
        records = breakup_chunk(Chunk("zstd", packed, last, first, crc, size), validate_crc=True)
    except (ValueError, zstandard.ZstdError):  # a failed checksum is a ValueError
        return None
    return [record for record in records if isinstance(record, Schema | Channel | Message)], start + stored


def _strings_size(content: bytes, count: int) -> int:
    """Bytes that so many length-prefixed strings at the start take; -1 if they are not there."""
    size = 0
    for _ in range(count):
        if size + 4 > len(content):
            return -1
        size += 4 + struct.unpack_from("<I", content, size)[0]
    return size


def _metadata(content: bytes) -> Metadata | None:
    stream = ReadDataStream(BytesIO(content))
    try:
        record = Metadata.read(stream)
    except Exception:  # whatever the parser meets in damaged bytes
        return None
    return record if stream.count == len(content) and opened(record.metadata) is not None else None


def _attachment(content: bytes) -> Attachment | None:
    if len(content) < 4 or zlib.crc32(content[:-4]) != struct.unpack("<I", content[-4:])[0]:
        return None
    return Attachment.read(ReadDataStream(BytesIO(content)))


def _next_intact(data: bytes, position: int, end: int) -> int:
    """Where the first record after `position` starts that its checksum proves, or the end."""
    marker, chunk = position, end
    while (marker := data.find(ZSTD, marker, end)) >= 0:
        start = marker - CHUNK_FIELDS.size
        if start >= position and _chunk(data, start, end) is not None:
            chunk = start
            break
        marker += 1
    for opcode, read in ((Opcode.METADATA, _metadata), (Opcode.ATTACHMENT, _attachment)):
        start = position
        while (start := data.find(bytes([opcode]), start + 1, chunk)) >= 0:
            if start + RECORD.size > end:
                break
            body = start + RECORD.size
            after = body + RECORD.unpack_from(data, start)[1]
            if after <= chunk and read(data[body:after]) is not None:
                chunk = start
                break
    return chunk
