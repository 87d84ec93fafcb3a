"""Metrics for TensorBoard (extra `tensorboard`)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from locorl.training.trainer import Trainer


class TensorBoard:
    """Writes every metric as a scalar over iterations; a `Watcher`.

    A resumed run makes the event file anew from its rows, so that no iteration is in it twice, and a run that
    started without TensorBoard has all its iterations there.

    Args:
        folder: of the event file; event files found there are replaced.

    Raises:
        LookupError: TensorBoard is not installed; the message says how to install it.
    """

    def __init__(self, folder: Path) -> None:
        try:
            # takes a second, and the package is optional
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as error:
            raise LookupError(
                f"TensorBoard is not installed ({error.name}): pip install 'legged-locorl[tensorboard]'; "
                "metrics.jsonl holds the same numbers"
            ) from error
        self._make, self._folder = SummaryWriter, folder

    def begin(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Write the rows of the iterations that the run has behind it."""
        old = list(self._folder.glob("events.out.tfevents.*"))
        self._writer = self._make(str(self._folder))
        # as if they had come without a break
        seconds = list(itertools.accumulate(row["seconds"] for row in rows))
        for row, spent in zip(rows, seconds, strict=True):
            self._write(row, time.time() - seconds[-1] + spent)
        self._writer.flush()
        for path in old:
            path.unlink()

    def watch(self, trainer: Trainer, row: Mapping[str, float]) -> None:
        """Write the row of an iteration."""
        self._write(row, time.time())
        self._writer.flush()

    def end(self) -> None:
        """Close the file."""
        self._writer.close()

    def _write(self, row: Mapping[str, float], at: float) -> None:
        for name, value in row.items():
            if name != "iteration":
                self._writer.add_scalar(name, value, int(row["iteration"]), walltime=at)
