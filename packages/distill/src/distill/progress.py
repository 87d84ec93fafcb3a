"""A progress bar with rate and time left."""

from __future__ import annotations

from types import TracebackType

from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress


class Progress:
    """Counts iterations; shows samples per second, action loss, time spent and time left."""

    def __init__(self, total: int, done: int, title: str, *, shown: bool) -> None:
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            disable=not shown,
        )
        self._task = self._bar.add_task(title, total=total, completed=done, note="")
        self._samples = 0

    def __enter__(self) -> Progress:
        """Start drawing."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop drawing."""
        self._bar.stop()

    def advance(self, samples: int, loss: float) -> None:
        """One more iteration of `samples` states, with its action loss."""
        self._samples += samples
        elapsed = self._bar.tasks[0].elapsed or 0.0
        rate = f"{self._samples / elapsed:,.0f} states/s, " if elapsed > 0 else ""
        self._bar.update(self._task, advance=1, note=f"{rate}action loss {loss:.4f}")
