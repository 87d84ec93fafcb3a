"""`codesign status`: where a run stands, in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from legged_codesign.stages import RunError
from legged_codesign.watch.folders import RUNS, run_folders
from legged_codesign.watch.state import RunState, TrialState

_LOG_LINES = 8
_COLORS = {"running": "cyan", "finished": "green", "done": "green", "stopped": "yellow", "damaged": "red"}


@dataclass(frozen=True)
class Status:
    """Say where a run stands, or list all runs; nothing in their folders is written."""

    folder: Annotated[Path | None, tyro.conf.Positional] = None
    """Run folder; by default all under ./runs, a line each."""

    def run(self, console: Console) -> None:
        """Print it.

        Raises:
            RunError: the folder holds no run.
        """
        from legged_codesign.watch.reader import RunReader

        if self.folder is not None:
            state = RunReader(self.folder).read()
            if state.status == "no run":
                raise RunError(state.words)
            return _print_run(state, console)
        folders = run_folders(RUNS)
        if not folders:
            console.print(f"there is no run under ./{RUNS}; `codesign run` starts one", highlight=False)
        for folder in folders:
            state = RunReader(folder).read()
            console.print(
                f"{folder}  [{_COLORS.get(state.status, 'default')}]{state.status}[/]  {_line(state)}",
                highlight=False,
                soft_wrap=True,
            )


def duration(seconds: float) -> str:
    """A time for people: 12 s, 3 min 05 s, 2 h 10 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def _line(state: RunState) -> str:
    """A run in a line."""
    if state.status == "damaged":
        return state.words
    parts = []
    if state.current is not None:
        parts.append(f"stage {state.stages.index(state.current) + 1} of {len(state.stages)}, {state.current.name}")
    if state.planned is not None:
        parts.append(f"{sum(t.score is not None for t in state.trials)} of {state.planned} bodies scored")
    if state.result:
        parts.append(state.result)
    elif (best := _best(state)) is not None:
        parts.append(f"best so far {best.score:.4f} ({state.objective}, body {best.trial})")
    if state.left is not None:
        parts.append(f"about {duration(state.left)} left")
    return "; ".join(parts)


def _print_run(state: RunState, console: Console) -> None:
    def say(text: str, style: str | None = None) -> None:
        console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)

    say(f"{state.folder}  {state.title}".rstrip(), "bold")
    say(state.words, _COLORS.get(state.status))
    for problem in state.problems:
        say(problem, "red")
    if state.stages:
        console.print(_stage_table(state))
        left = f", about {duration(state.left)} left" if state.left is not None else ""
        idle = f"; last written {duration(state.idle)} ago" if state.idle is not None else ""
        say(f"{duration(state.elapsed)} so far{left}{idle}")
    if state.trials:
        console.print(_trial_table("search", state.trials, state))
    if state.confirmations:
        console.print(_trial_table("confirmation on fresh seeds", state.confirmations, state))
    if state.trials:
        best = "chosen" if state.best_is_final else "best so far"
        names = ", ".join(name.replace("_", " ") for name in state.trials[0].params)
        say(f"design: {names}. score: {state.objective}. error: of the speed, m/s. * {best}", "dim")
    if state.result:
        say(state.result)
    elif (best := _best(state)) is not None:
        say(f"best so far: body {best.trial}, {state.objective} {best.score:.4f}; not confirmed yet")
    if state.log:
        say("\nlast lines of log.txt", "bold")
        for line in state.log[-_LOG_LINES:]:
            say(f"  {line}")


def _best(state: RunState) -> TrialState | None:
    return next((t for t in state.trials if t.trial == state.best and t.score is not None), None)


def _stage_table(state: RunState) -> Table:
    table = Table("stage", "status", "time", "progress", "left", box=None, pad_edge=False, header_style="dim")
    for stage in state.stages:
        counted = f"{stage.done} of {stage.total}" if stage.total is not None else ""
        table.add_row(
            stage.name,
            f"[{_COLORS.get(stage.status, 'dim')}]{stage.status}[/]",
            duration(stage.seconds) if stage.seconds is not None else "",
            counted,
            f"about {duration(stage.left)}" if stage.left is not None else "",
        )
    return table


def _trial_table(title: str, rows: Sequence[TrialState], state: RunState) -> Table:
    columns = ("body", "from", "design", "score", "+-", "error", "time", "status")
    table = Table(*columns, title=title, title_justify="left", box=None, pad_edge=False, header_style="dim")
    for row in rows:
        best = row.repeat is None and row.trial == state.best
        table.add_row(
            f"{row.trial}{' *' if best else ''}",
            row.origin,
            " ".join(_value(value) for value in row.params.values()),
            _number(row.score, 4),
            _number(row.sem, 4),
            _number(row.tracking_error, 3),
            duration(row.seconds) if row.seconds is not None else "",
            row.status,
            style="bold" if best else None,
        )
    return table


def _value(value: float | int | str) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
