"""Damps a robot whose loop hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType

from deploy.errors import DeployError
from deploy.logs.messages import Sample


class Watchdog:
    """Called after every tick; where no call comes for a while, it damps the robot from a thread of its own.

    A context manager. It does not stop the run: a loop that comes back after so long finds its own guard. What it
    cannot help is a driver that hangs while it sends.

    Attributes:
        bites: How often it has damped.
    """

    def __init__(self, damp: Callable[[], None], seconds: float) -> None:
        """Call `damp` whenever `seconds` of real time have passed without a tick, and again until one comes."""
        self._damp, self._seconds = damp, seconds
        self._fed = time.monotonic()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self.bites = 0

    def __enter__(self) -> Watchdog:
        self._fed = time.monotonic()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()

    def __call__(self, sample: Sample) -> None:
        """A tick has ended."""
        self._fed = time.monotonic()

    def _watch(self) -> None:
        while not self._done.wait(self._seconds / 4):
            if time.monotonic() - self._fed > self._seconds:
                self.bites += 1
                try:
                    self._damp()
                except DeployError:  # the driver says why to the loop as well; here the next try counts
                    continue
