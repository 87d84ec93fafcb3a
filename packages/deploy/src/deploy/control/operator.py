"""The operator: says when the robot may go on, and can stop it in every state."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any, Protocol, TextIO


class Operator(Protocol):
    """Asked once per tick: first `stop`, then `go`, where the robot waits for it."""

    def go(self) -> bool:
        """Whether the robot may stand up, and later whether the policy may take over; consent given earlier is none."""
        ...

    def stop(self) -> str | None:
        """Why the robot must be damped, None while it need not be."""
        ...


class Unattended:
    """Agrees to everything, stops nothing: for simulation."""

    def go(self) -> bool:
        """Always."""
        return True

    def stop(self) -> str | None:
        """Never."""
        return None


class Keyboard:
    """Enter lets the robot go on where it waits, any other key stops it; so does a keyboard that is gone.

    An Enter pressed while nobody waits for one is forgotten with the next tick.

    A context manager: keys count at once, without Enter behind them, where standard input is a terminal.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        """Listen to `stream`, by default standard input."""
        self._stream = stream or sys.stdin
        self._settings: list[Any] | None = None
        self._go = False
        self._stop: str | None = None

    def __enter__(self) -> Keyboard:
        if self._stream.isatty():
            import termios
            import tty

            self._settings = termios.tcgetattr(self._stream)
            tty.setcbreak(self._stream)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._settings is not None:
            import termios

            termios.tcsetattr(self._stream, termios.TCSADRAIN, self._settings)

    def go(self) -> bool:
        """Whether Enter was pressed since the `stop` before last; says so once."""
        self._poll()
        agreed, self._go = self._go, False
        return agreed

    def stop(self) -> str | None:
        """Whether any other key was ever pressed, or the keyboard is gone; forgets an Enter that came before."""
        self._go = False
        self._poll()
        return self._stop

    def _poll(self) -> None:
        while self._stop is None and select.select([self._stream], [], [], 0.0)[0]:
            # past the buffer of the stream, which `select` does not know of
            keys = os.read(self._stream.fileno(), 64).decode(errors="replace")
            others = [key for key in keys if key not in "\r\n"]
            if others:
                self._stop = f"operator stop: key {others[0]!r}"
            elif not keys:
                self._stop = "operator stop: the keyboard is gone"
            else:
                self._go = True


class Interrupts:
    """Ctrl-C, Ctrl-Z, a closed terminal and a request to terminate as a stop, not in the middle of a tick.

    A context manager around another operator. The second signal raises KeyboardInterrupt, for a driver that hangs.
    Only the main thread can take signals; elsewhere this changes nothing.
    """

    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)
    """What would leave the motors with their last command if it ended or paused the process."""

    def __init__(self, operator: Operator) -> None:
        """Listen to signals beside `operator`."""
        self._operator = operator
        self._stop: str | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._take) for number in self.SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if self._stop is not None:
            raise KeyboardInterrupt
        self._stop = f"operator stop: {signal.Signals(number).name}"

    def go(self) -> bool:
        """What the other operator says."""
        return self._operator.go()

    def stop(self) -> str | None:
        """A signal, or what the other operator says."""
        return self._stop or self._operator.stop()
