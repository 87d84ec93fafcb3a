"""Metrics on disk (JSONL) and progress on screen."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from locorl import checkpoint


class MetricsFile:
    """Appends one JSON object per line; a resumed run first drops the lines it will write again.

    Attributes:
        rows: those that were there and stay.
    """

    def __init__(self, path: Path, keep_until: int = 0) -> None:
        self._path = path
        self.rows = [row for row in read_metrics(path) if row["iteration"] <= keep_until]
        checkpoint.write_text(path, "".join(json.dumps(row) + "\n" for row in self.rows))

    def write(self, row: Mapping[str, float]) -> None:
        """Append one row.

        Raises:
            CheckpointError: the disk is full; the rows before it are untouched.
        """
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(dict(row)) + "\n")
        except OSError as error:
            raise checkpoint.CheckpointError(
                f"cannot write {self._path}: {error}; free the disk and start again"
            ) from error


def read_metrics(path: Path) -> list[dict[str, float]]:
    """All complete rows of a metrics file; a torn last line is skipped, a missing file is empty."""
    rows: list[dict[str, float]] = []
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                rows.append(json.loads(line))
            except json.JSONDecodeError:
                continue
    return rows


class TrainingProgress:
    """A progress bar with rate and time left; plain lines where the output is no terminal."""

    def __init__(self, title: str, total: int, done: int, quiet: bool = False) -> None:
        self._console = Console()
        self._live = self._console.is_terminal and not quiet
        self._plain = not self._live and not quiet
        self._title, self._total, self._last_line = title, total, 0.0
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            speed_estimate_period=300.0,  # iterations may take long
            disable=not self._live,
        )
        self._task = self._bar.add_task(title, total=total, completed=done, note="")

    def __enter__(self) -> TrainingProgress:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.stop()

    def update(self, done: int, note: str) -> None:
        """Show that `done` iterations are over."""
        self._bar.update(self._task, completed=done, note=note)
        if self._plain and (time.monotonic() - self._last_line > 10 or done == self._total):
            self._last_line = time.monotonic()
            seconds = self._bar.tasks[0].time_remaining
            left = f"  {timedelta(seconds=round(seconds))} left" if seconds else ""
            self._console.print(f"{self._title} {done}/{self._total} {note}{left}", highlight=False, soft_wrap=True)
