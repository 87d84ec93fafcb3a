"""What is shown while a study runs: a live table in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from codesign_bo.interfaces import EvalRequest, EvalResult
from codesign_bo.records import Told
from codesign_bo.space import Value

_SHOWN = 12
_REASON = 60
_WIDEST = 36


class Display(AbstractContextManager[object], Protocol):
    """An observer of the coordinator that is shown within a `with` block."""

    def started(self, request: EvalRequest) -> None:
        """An evaluation is about to be submitted."""
        ...

    def ended(self, request: EvalRequest, result: EvalResult, told: Told) -> None:
        """A result was committed."""
        ...


class Tally:
    """Counts evaluations and estimates the time left, on a steady clock.

    What runs is credited with the share of the mean duration that it has run, so that the first result of four that
    run at once does not look like a quarter of the real rate.

    Args:
        done: Evaluations that are finished already, failed ones included.
        total: Evaluations to be finished.
        best: Says in words what the best is so far; asked after each that is finished.
        failed: How many of those that are finished failed.
    """

    def __init__(self, done: int, total: int, best: Callable[[], str], failed: int = 0) -> None:
        self._before = done
        self._done = done
        self._total = total
        self._best = best
        self._failed = failed
        self._words = ""
        self._start = time.monotonic()
        self._durations: list[float] = []

    def count(self, failed: bool = False, seconds: float | None = None) -> None:
        """One more is finished.

        Args:
            failed: Whether it failed.
            seconds: How long it took, if known.
        """
        self._done += 1
        self._failed += failed
        self._durations += [] if seconds is None else [seconds]
        self._words = self._best()

    def words(self, running: Sequence[float] = ()) -> str:
        """Return the count, failures, the rate, the time left and the best so far.

        Args:
            running: For how long (s) each of the evaluations that run has been running.
        """
        parts = [f"{self._done}/{self._total}"] + ([f"{self._failed} failed"] if self._failed else [])
        seconds, here = time.monotonic() - self._start, self._done - self._before
        if here:
            typical = sum(self._durations) / len(self._durations) if self._durations else math.inf
            credit = sum(min(age / max(typical, 1e-9), 1.0) for age in running)
            rate = (here + credit) / max(seconds, 1e-9)
            left = max(self._total - self._done - credit, 0.0) / rate
            parts += [f"{3600.0 * rate:.3g} per hour", f"{duration(left)} left"]
        return ", ".join([*parts, *([self._words] if self._words else [])])

    def __str__(self) -> str:
        return self.words()


class _Watch:
    """What both displays know: which evaluations run since when."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._running: dict[str, tuple[EvalRequest, float]] = {}

    def _begin(self, request: EvalRequest) -> None:
        self._running[request.token] = (request, time.monotonic())

    def _end(self, request: EvalRequest, result: EvalResult, told: Told) -> float:
        """Return how long an evaluation took (s)."""
        now = time.monotonic()
        _, start = self._running.pop(request.token, (request, now))
        if told == "counted":
            self._tally.count(result.failed, now - start)
            same = [token for token, (other, _) in self._running.items() if _label(other) == _label(request)]
            for token in same:  # attempts at the same evaluation, which are cancelled
                del self._running[token]
        return now - start

    def _summary(self) -> str:
        now = time.monotonic()
        return self._tally.words([now - start for _, start in self._running.values()])


class PlainLines(_Watch, AbstractContextManager[object]):
    """One line per outcome, for logs.

    Args:
        tally: The count.
        console: Where to print.
    """

    def __init__(self, tally: Tally, console: Console) -> None:
        super().__init__(tally)
        self._console = console

    def __exit__(self, *error: object) -> None:
        pass

    def started(self, request: EvalRequest) -> None:
        """Note the time."""
        self._begin(request)

    def ended(self, request: EvalRequest, result: EvalResult, told: Told) -> None:
        """Print what came of an evaluation, and what still runs."""
        seconds = self._end(request, result, told)
        what = f"{_label(request)} ({design(request.params)}) {_state(result, told)} {_outcome(result)}"
        others = ", ".join(_label(r) for r, _ in list(self._running.values())[:_SHOWN])
        more = f", and {len(self._running) - _SHOWN} more" if len(self._running) > _SHOWN else ""
        self._console.print(
            f"{what} in {duration(seconds)}; {self._summary()}" + (f"; running: {others}{more}" if others else ""),
            markup=False,
            highlight=False,
            soft_wrap=True,
        )


class LiveTable(_Watch):
    """A table of what ended last and what runs, redrawn in place twice a second.

    Args:
        tally: The count.
        console: Where to draw.
    """

    def __init__(self, tally: Tally, console: Console) -> None:
        super().__init__(tally)
        self._ended: deque[tuple[EvalRequest, EvalResult, Told, float]] = deque(maxlen=_SHOWN)
        self._live = Live(console=console, refresh_per_second=2, get_renderable=self._draw)

    def __enter__(self) -> LiveTable:
        self._live.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.__exit__(None, None, None)

    def started(self, request: EvalRequest) -> None:
        """Show that an evaluation runs."""
        self._begin(request)
        self._live.refresh()

    def ended(self, request: EvalRequest, result: EvalResult, told: Told) -> None:
        """Show what came of it."""
        self._ended.append((request, result, told, self._end(request, result, told)))
        self._live.refresh()

    def _draw(self) -> RenderableType:
        table = Table()
        for name in ("trial", "time"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("design", overflow="fold")
        table.add_column("state", no_wrap=True)
        table.add_column("score", no_wrap=True, max_width=_WIDEST)
        now = time.monotonic()
        for request, result, told, seconds in list(self._ended):
            style = "red" if result.failed else "cyan" if result.status == "stopped" else "green"
            cells = (Text(design(request.params)), Text(_state(result, told), style), Text(_outcome(result)))
            table.add_row(_label(request), duration(seconds), *cells)
        running = list(self._running.values())
        for request, start in running[:_SHOWN]:
            state = "running" if request.attempt == 1 else f"running (attempt {request.attempt})"
            table.add_row(_label(request), duration(now - start), Text(design(request.params)), Text(state, "bold"))
        more = [Text(f"and {len(running) - _SHOWN} more running")] if len(running) > _SHOWN else []
        return Group(table, *more, Text(f"{len(running)} running, {self._summary()}"))


def display(show: bool | None, tally: Tally, console: Console | None = None) -> Display | None:
    """Return what shows the progress.

    Args:
        show: True: a live table in a terminal, lines elsewhere. None: the same, but nothing outside a
            terminal. False: nothing.
        tally: The count.
        console: Where to show it; by default the standard error stream.
    """
    console = Console(stderr=True) if console is None else console
    if show is False or (show is None and not console.is_terminal):
        return None
    return LiveTable(tally, console) if console.is_terminal else PlainLines(tally, console)


def design(params: Mapping[str, Value]) -> str:
    """Return a design in words."""
    return ", ".join(f"{n}={v:.4g}" if isinstance(v, float) else f"{n}={v}" for n, v in params.items())


def score(result: EvalResult | None) -> str:
    """Return a score with its standard error, or `-`; what was stopped keeps the score it had, in brackets."""
    if result is not None and result.status == "stopped":
        last = result.scores[-1]
        return f"({last.mean:.4g} at {last.fidelity:.0%})"
    if result is None or not result.ok:
        return "-"
    return f"{result.mean:.4g}" + ("" if result.sem is None else f" ± {result.sem:.2g}")


def duration(seconds: float) -> str:
    """Return a time span in words, such as `1:02:03` or `4.2 s`."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d} min"


def _state(result: EvalResult, told: Told) -> str:
    return result.status if told == "counted" else f"{result.status}, {told}"


def _outcome(result: EvalResult) -> str:
    """Return the score, or for a failure the last line of its message, which says what was raised."""
    lines = result.message.strip().splitlines()
    if not result.failed or not lines:
        return score(result)
    return lines[-1] if len(lines[-1]) <= _REASON else f"{lines[-1][: _REASON - 1]}…"


def _label(request: EvalRequest) -> str:
    """Return the trial, with the number of the confirmation run if it is one."""
    return f"{request.trial}" if request.repeat is None else f"{request.trial}, seed {request.repeat}"
