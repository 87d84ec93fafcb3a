"""Metadata records of a log: what was run, as JSON texts under a checksum."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


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


def sealed(values: Mapping[str, object]) -> dict[str, str]:
    """Metadata as JSON texts, with a checksum, which MCAP has for chunks and attachments but not here."""
    texts = {key: json.dumps(value) for key, value in values.items()}
    return {**texts, "crc32": str(checksum(texts))}


def opened(texts: Mapping[str, str]) -> dict[str, Any] | None:
    """The values of a metadata record; None if its checksum does not hold or is absent."""
    if texts.get("crc32") != str(checksum(texts)):
        return None
    return {key: json.loads(text) for key, text in texts.items() if key != "crc32"}


def checksum(texts: Mapping[str, str]) -> int:
    """CRC-32 of all keys and values but `crc32`."""
    return zlib.crc32(json.dumps([[key, text] for key, text in texts.items() if key != "crc32"]).encode())
