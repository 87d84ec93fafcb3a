"""A run in the terminal while it runs."""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from deploy.bundles.manifest import Bundle
from deploy.control.guards import tilt_of
from deploy.control.states import Mode
from deploy.logs.messages import Sample
from deploy.measure.energy import positive_power

WIDTH = 21
"""Columns of a joint's bar."""


class LiveView:
    """A context manager; called after every tick, it draws some of them.

    Drawing takes time of the loop, so it happens `hz` times a second of real time at most.
    """

    def __init__(self, bundle: Bundle, console: Console | None = None, hz: float = 5.0) -> None:
        """Draw on `console`, standard error by default."""
        self._bundle = bundle
        self._lower, self._upper = bundle.per_joint("lower"), bundle.per_joint("upper")
        self._live = Live(console=console or Console(stderr=True), auto_refresh=False)
        self._pause = 1.0 / hz
        self._next = 0.0
        self._late = self._skipped = self._clamped = 0

    def __enter__(self) -> LiveView:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def __call__(self, sample: Sample) -> None:
        """Count a tick, and draw it if it is time."""
        tick = sample.tick
        self._late += tick.slot.late
        self._skipped += tick.slot.skipped
        self._clamped += tick.clamped
        now = time.monotonic()
        if now >= self._next or tick.mode is Mode.DAMP:
            self._next = now + self._pause
            self._live.update(self.table(sample), refresh=True)

    def table(self, sample: Sample) -> Table:
        """One tick as a table."""
        tick, state, step = sample.tick, sample.tick.state, sample.tick.step
        table = Table(title=f"{self._bundle.name}{' (dry run)' if tick.dry_run else ''}", show_header=False)
        mode = Text(tick.mode.value, style="bold red" if tick.mode is Mode.DAMP else "bold green")
        table.add_row("mode", mode.append(f"  {tick.reason}", style="red") if tick.reason else mode)
        table.add_row("time", f"{tick.slot.start_ns * 1e-9 % 1e6:.2f} s, tick {tick.slot.index}")
        table.add_row("late, skipped, cut", f"{self._late}, {self._skipped}, {self._clamped}")
        table.add_row("reading", f"{(tick.done_ns - state.stamp_ns) * 1e-6:.1f} ms old, tilt {tilt_of(state):.2f} rad")
        table.add_row("command", _numbers(tick.command))
        if step is not None and step.velocity is not None:
            table.add_row("velocity estimate", f"{_numbers(step.velocity)} m/s")
        if step is not None and step.seen is not None:
            age = "nothing yet"
            if step.seen.tick >= 0:
                age = f"{(tick.done_ns - step.seen.stamp_ns) * 1e-6:.0f} ms old, headings {_numbers(step.seen.heading)}"
            table.add_row("image in use", age)
        table.add_row("power", f"{float(positive_power(state.dq, state.tau)):.0f} W")
        for joint, name in enumerate(self._bundle.joint_names):
            table.add_row(name, self._bar(joint, sample))
        return table

    def _bar(self, joint: int, sample: Sample) -> Text:
        """Where a joint (o) and its target (|) stand in its range."""
        state, sent = sample.tick.state, sample.tick.joint_command
        bar = ["."] * WIDTH
        marks = [(state.q[joint], "o")] if sent is None else [(sent.q[joint], "|"), (state.q[joint], "o")]
        for angle, mark in marks:
            share = (angle - self._lower[joint]) / (self._upper[joint] - self._lower[joint])
            if np.isfinite(share):
                bar[int(np.clip(round(share * (WIDTH - 1)), 0, WIDTH - 1))] = mark
        return Text(f"{''.join(bar)} {state.q[joint]:+.2f} rad {state.tau[joint]:+6.1f} N m")


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:+.2f}" for value in values)
