"""What a health check says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info", "ok"]
"""How bad it is.

- `error`: the study cannot go on, or its results mean nothing.
- `warning`: results may mislead.
- `info`: worth knowing.
- `ok`: nothing wrong.
"""

SEVERITIES: tuple[Severity, ...] = ("error", "warning", "info", "ok")


@dataclass(frozen=True)
class Check:
    """Outcome of one health check.

    Attributes:
        name: What was checked.
        severity: How bad it is.
        sentence: What was found.
        way_out: What to do about it; empty if there is nothing to do.
    """

    name: str
    severity: Severity
    sentence: str
    way_out: str = ""


def worst(checks: Sequence[Check]) -> Severity:
    """Return the highest severity."""
    found: list[Severity] = [c.severity for c in checks]
    return min(found, key=SEVERITIES.index) if found else "ok"


def listed(words: Sequence[str]) -> str:
    """Return words with commas and an `and`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
