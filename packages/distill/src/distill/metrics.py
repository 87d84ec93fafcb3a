"""One JSON object per iteration, in a file that a resumed run continues."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path


class MetricsLog:
    """`metrics.jsonl`: appended line by line; `rewind` drops what a resumed run will write again."""

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)

    def rewind(self, iteration: int) -> None:
        """Keep the complete lines of iterations before `iteration`."""
        if not self._path.exists():
            return
        kept = [line for line in self._path.read_text().splitlines() if _iteration(line) < iteration]
        temporary = self._path.with_name(f".{self._path.name}.tmp")
        temporary.write_text("".join(f"{line}\n" for line in kept))
        os.replace(temporary, self._path)

    def append(self, row: Mapping[str, float]) -> None:
        """Write one line; `row` must hold "iteration"."""
        with self._path.open("a") as file:
            file.write(json.dumps(row) + "\n")


def _iteration(line: str) -> float:
    try:
        return float(json.loads(line)["iteration"])
    except (ValueError, KeyError, TypeError):
        return float("inf")  # a line cut off by a crash
