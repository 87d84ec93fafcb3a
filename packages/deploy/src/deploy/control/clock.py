"""Real time, for robots of metal."""

from __future__ import annotations

import time


class WallClock:
    """Time since the epoch that never jumps: the wall clock at construction, then the monotonic one."""

    virtual = False

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Current time, ns."""
        return self._offset + time.monotonic_ns()

    def sleep_until(self, time_ns: int) -> None:
        """Return at `time_ns`, at once if it has passed."""
        if (left := time_ns - self.now_ns()) > 0:
            time.sleep(left * 1e-9)
