"""What looks on while a training runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from locorl.training.trainer import Trainer


class Watcher(Protocol):
    """Looks on, and changes nothing in the training."""

    def begin(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Called once before the first iteration, with the metrics of those that a resumed run has behind it."""
        ...

    def watch(self, trainer: Trainer, row: Mapping[str, float]) -> None:
        """Called after each iteration, with its metrics, once a checkpoint that is due has been written."""
        ...

    def end(self) -> None:
        """Called once at the end, also when the training fails."""
        ...
