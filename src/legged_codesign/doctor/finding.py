"""What a check found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """One line of the doctor.

    Attributes:
        topic: what was looked at, such as `memory`.
        status: `fail` if a run cannot be done here, `warn` if it is slower or poorer than it could be.
        text: what was found.
        remedy: the way out; empty where there is nothing to do.
    """

    topic: str
    status: Status
    text: str
    remedy: str = ""
