"""One session of work on an executor, shown while it goes on."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from contextlib import nullcontext
from typing import TypeVar

from codesign_bo.executors.interfaces import Executor
from codesign_bo.interfaces import Callback
from codesign_bo.running.coordinator import Coordinator, Work
from codesign_bo.running.evaluation import InProcess
from codesign_bo.running.progress import Tally, display

Record = TypeVar("Record")


def coordinate(
    work: Work,
    callback: Callback,
    executor: Executor | None,
    tally: Tally,
    show: bool | None,
    patience: float | None,
    deadline: float | None = None,
) -> None:
    """Work until there is nothing left to do (see `Coordinator`).

    Args:
        work: What to do.
        callback: Evaluates a design.
        executor: Where; None for this process.
        tally: Counts what is finished.
        show: Whether the progress is shown (see `display`).
        patience: Seconds after which an evaluation that was not heard of is given up.
        deadline: Unix time (s) at which everything in flight is cancelled.

    Raises:
        TypeError: The executor is a bare pool, which does not say how many evaluations it runs at once.
    """
    if isinstance(executor, concurrent.futures.Executor):
        raise TypeError(f"wrap the {type(executor).__name__}: codesign_bo.executors.FuturesExecutor(pool, slots=4)")
    shown = display(show, tally)
    with shown or nullcontext():
        Coordinator(work, callback, executor or InProcess(), shown, patience, deadline).run()


def listener(
    progress: Callable[[Record], None] | bool | None,
) -> tuple[Callable[[Record], None] | None, bool | None]:
    """Return who is called with each result, and whether progress is shown."""
    return (progress, False) if callable(progress) else (None, progress)
