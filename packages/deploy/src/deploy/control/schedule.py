"""Absolute deadlines: tick k is due at start + k * period, whatever happened before."""

from __future__ import annotations

from dataclasses import dataclass

from deploy.interfaces import Clock


@dataclass(frozen=True)
class Slot:
    """One tick of the schedule, times in ns on the robot's clock.

    Attributes:
        index: Position in the schedule, counting skipped slots.
        due_ns: When it should start.
        start_ns: When it did.
        late: Started more than the tolerance after its time.
        skipped: Slots given up since the previous tick.
    """

    index: int
    due_ns: int
    start_ns: int
    late: bool
    skipped: int


class Schedule:
    """Paces a loop; a loop that falls behind skips whole slots and never runs two ticks to catch up."""

    def __init__(self, clock: Clock, period_ns: int, tolerance_ns: int = 2_000_000) -> None:
        self._clock = clock
        self._period = period_ns
        self._tolerance = tolerance_ns
        self._origin = clock.now_ns()
        self._next = 0

    def wait(self) -> Slot:
        """Sleep until the next slot; the first one is due at construction."""
        behind = (self._clock.now_ns() - self._origin) // self._period
        index = max(self._next, behind)
        skipped = index - self._next
        self._next = index + 1
        due = self._origin + index * self._period
        self._clock.sleep_until(due)
        start = self._clock.now_ns()
        return Slot(index, due, start, late=start - due > self._tolerance, skipped=skipped)
