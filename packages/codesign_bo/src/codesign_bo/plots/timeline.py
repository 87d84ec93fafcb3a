"""Time line: every attempt at an evaluation as a bar, in the slot where it ran, coloured by outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.style import FRAME, INK, MUTED, OUTCOMES, PLAIN, Labels, figure, label, legend
from codesign_bo.records import AttemptRecord, AttemptStatus
from codesign_bo.running.progress import duration
from codesign_bo.view import StudyView

_LONG_GAP, _SHORTEST_PAUSE = 0.1, 60.0  # share of the working time, and s
_BREAK = 0.03
_NARROWEST = 0.0025


@dataclass(frozen=True)
class Bar:
    """One attempt.

    Attributes:
        trial: The trial.
        repeat: Confirmation run, or None for the search.
        attempt: Number of the attempt, from 1.
        status: Its outcome.
        start: When it began, in working time (s): long times in which nothing ran are left out.
        seconds: How long it took.
        slot: Where it is drawn; no two bars of a slot overlap.
    """

    trial: int
    repeat: int | None
    attempt: int
    status: AttemptStatus
    start: float
    seconds: float
    slot: int = 0


@dataclass(frozen=True)
class Timeline:
    """When what was evaluated.

    Attributes:
        bars: The attempts, by their start.
        breaks: Times (s) at which a pause was left out, with its length (s).
    """

    bars: tuple[Bar, ...]
    breaks: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, view: StudyView) -> Timeline:
        """Take it from a study.

        Raises:
            NothingToShowError: No attempt has a time.
        """
        return cls.from_attempts(view.attempts())

    @classmethod
    def from_attempts(cls, attempts: Sequence[AttemptRecord]) -> Timeline:
        """Lay out attempts; those that still run, or whose end nobody saw, reach to the last known moment.

        Raises:
            NothingToShowError: None has a time.
        """
        known = [(a, a.started) for a in attempts if a.started is not None]
        if not known:
            raise NothingToShowError("no evaluation has begun, or none left its time")
        lengths = [_seconds(a, start) for a, start in known]
        told = [length for length in lengths if length is not None]
        edge = max(start + (length or 0.0) for (_, start), length in zip(known, lengths, strict=True))
        edge = max(edge, max(start for _, start in known) + (float(np.median(told)) if told else 1.0))
        bars = [
            Bar(a.trial, a.repeat, a.attempt, a.status, start, edge - start if length is None else length)
            for (a, start), length in zip(known, lengths, strict=True)
        ]
        bars, breaks = _without_pauses(sorted(bars, key=lambda b: (b.start, b.trial)))
        return cls(tuple(_in_slots(bars)), tuple(breaks))

    @property
    def slots(self) -> int:
        """Most attempts at once."""
        return 1 + max(b.slot for b in self.bars)

    @property
    def end(self) -> float:
        """When the last bar ends (s)."""
        return max(b.start + b.seconds for b in self.bars)

    @property
    def busy(self) -> float:
        """Share of the slots' time in which something ran."""
        return sum(b.seconds for b in self.bars) / max(self.slots * self.end, 1e-9)

    def figure(self, labels: Labels) -> Figure:
        """Draw one line of bars for each slot."""
        made, (ax,) = figure(10.2, 0.42 * self.slots + 1.9)
        unit, word = _unit(self.end)
        width = self.end / unit
        for b in self.bars:
            look = OUTCOMES[b.status]
            ax.barh(
                b.slot, max(b.seconds / unit, _NARROWEST * width), 0.78, b.start / unit, color=look.colour,
                alpha=1.0 if b.repeat is None else 0.55, hatch=look.hatch, edgecolor="white", linewidth=0.8,
            )  # fmt: skip
            name = f"{b.trial}" + ("" if b.attempt == 1 else f"/{b.attempt}")
            if b.seconds / unit > 0.0095 * len(name) * width:
                dark = b.status in ("lost", "failed", "running", "ok", "crash")
                ax.text(
                    (b.start + b.seconds / 2) / unit, b.slot, name, ha="center", va="center", fontsize=8.5,
                    color="white" if dark and b.repeat is None else INK,
                )  # fmt: skip
        for at, length in self.breaks:
            ax.axvline(at / unit, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
            ax.annotate(
                f"pause {duration(length)}", (at / unit, 1.0), (0, 2), xycoords=("data", "axes fraction"),
                textcoords="offset points", ha="center", fontsize=8.5, color=MUTED,
            )  # fmt: skip
        ax.set_yticks(range(self.slots), [f"{i + 1}" for i in range(self.slots)])
        ax.set_ylim(self.slots - 0.4, -0.6)
        ax.set_xlim(0.0, 1.01 * width)
        ax.grid(visible=False, axis="y")
        label(ax, f"time since the first trial began ({word})", "slot")
        present: list[AttemptStatus] = [s for s in OUTCOMES if any(b.status == s for b in self.bars)]
        patches = [
            Patch(facecolor=OUTCOMES[s].colour, hatch=OUTCOMES[s].hatch, edgecolor="white", label=_legend_word(s))
            for s in present
        ]
        if any(b.repeat is not None for b in self.bars):
            patches.append(Patch(facecolor=FRAME, label="paler: confirmation"))
        legend(made, patches, 6)
        return made

    def sentence(self, labels: Labels) -> str:
        """Say how busy the slots were, and what was lost."""
        useful = sum(b.seconds for b in self.bars if b.status in ("ok", "stopped"))
        total = sum(b.seconds for b in self.bars)
        wasted = 1.0 - useful / total if total > 0 else 0.0
        attempts = "1 attempt" if len(self.bars) == 1 else f"{len(self.bars)} attempts"
        slots = "1 slot was" if self.slots == 1 else f"{self.slots} slots were"
        return (
            f"{attempts} in {duration(self.end)} of work: {slots} busy {self.busy:.0%} of the time, "
            f"and {wasted:.0%} of that went into attempts without a score. Numbers: trial/attempt."
        )


def plot_timeline(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw all attempts as bars in slots, coloured by outcome.

    Raises:
        NothingToShowError: No attempt has a time.
    """
    return Timeline.of(view).figure(labels)


def _seconds(attempt: AttemptRecord, started: float) -> float | None:
    """Return how long an attempt took; None while it runs. The steady clock is believed more than the wall clock."""
    if attempt.seconds is not None:
        return attempt.seconds
    if attempt.status == "running":
        return None
    return max((attempt.ended if attempt.ended is not None else started) - started, 0.0)


def _without_pauses(bars: list[Bar]) -> tuple[list[Bar], list[tuple[float, float]]]:
    """Start at 0 and close long pauses in which nothing ran, such as nights.

    Returns:
        The bars, and where pauses were (s), with their lengths (s).
    """
    gaps: list[tuple[float, float]] = []
    reached = bars[0].start
    working = 0.0
    for b in bars:
        if b.start > reached:
            gaps.append((reached, b.start))
        working += max(b.start + b.seconds - max(reached, b.start), 0.0)
        reached = max(reached, b.start + b.seconds)
    long = [(begin, end) for begin, end in gaps if end - begin > max(_LONG_GAP * working, _SHORTEST_PAUSE)]
    shown = _BREAK * working

    def moved(time: float) -> float:
        cut = sum(end - begin - shown for begin, end in long if end <= time)
        return time - bars[0].start - cut

    breaks = [(moved(end) - shown / 2.0, end - begin) for begin, end in long]
    return [replace(b, start=moved(b.start)) for b in bars], breaks


def _in_slots(bars: list[Bar]) -> list[Bar]:
    """Put each bar into the first slot that is free when it starts."""
    free: list[float] = []
    placed: list[Bar] = []
    for b in bars:
        slot = next((i for i, end in enumerate(free) if end <= b.start + 1e-6), len(free))
        free[slot : slot + 1] = [b.start + b.seconds]
        placed.append(replace(b, slot=slot))
    return placed


def _unit(seconds: float) -> tuple[float, str]:
    return (1.0, "s") if seconds < 180.0 else (60.0, "min") if seconds < 3 * 3600.0 else (3600.0, "h")


def _legend_word(status: AttemptStatus) -> str:
    return "running, or its coordinator died" if status == "running" else status
