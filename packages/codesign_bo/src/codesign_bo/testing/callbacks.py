"""Callbacks that behave and misbehave, at the top level of a module so that any process can load them.

A request's `params["x"]` is the score. Those that wait write their process number to `begun` in the work
folder, and go on when `go` appears beside that folder.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from codesign_bo.interfaces import EvalRequest, EvalResult

WAIT = 300.0  # s; ends everything here in case nobody else does


def echo(request: EvalRequest) -> EvalResult:
    """Return a result with a value in every field, the request in its message."""
    return EvalResult(
        request.params["x"], 0.1 + 0.2, 7, {"cost": math.inf, "unit": 1 / 3}, ((0.0, 1e-300), (1.0, -2.0)), "ok",
        request.to_json(),
    )  # fmt: skip


def large(request: EvalRequest) -> EvalResult:
    """Return a learning curve of some megabytes."""
    return EvalResult(request.params["x"], curve=tuple((float(i), i / 7) for i in range(100_000)))


def subclass(request: EvalRequest) -> EvalResult:
    """Return a result that cannot be pickled."""

    class Local(EvalResult):
        lock = threading.Lock()

    return Local(request.params["x"])


def infeasible(request: EvalRequest) -> EvalResult:
    """Report a failure."""
    return EvalResult.failure("infeasible", "the legs collide", {"overlap": 0.25})


class UnpicklableError(Exception):
    """An exception that does not pickle, and would not unpickle."""

    def __init__(self, legs: int, robot: str) -> None:
        super().__init__(f"{legs} legs on {robot}")
        self.lock = threading.Lock()


class SpeechlessError(Exception):
    """An exception that cannot be printed."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


def raise_error(request: EvalRequest) -> EvalResult:
    """Raise an ordinary exception."""
    raise ValueError("three legs")


def raise_unpicklable(request: EvalRequest) -> EvalResult:
    """Raise an exception that cannot leave its process."""
    raise UnpicklableError(3, "go2")


def raise_speechless(request: EvalRequest) -> EvalResult:
    """Raise an exception that cannot be printed."""
    raise SpeechlessError


def raise_exit(request: EvalRequest) -> EvalResult:
    """Leave by sys.exit."""
    sys.exit("no more legs")


def raise_os_error(request: EvalRequest) -> EvalResult:
    """Meet a fault of the machine."""
    raise OSError("no space left")


def raise_memory_error(request: EvalRequest) -> EvalResult:
    """Run out of memory in Python."""
    raise MemoryError("no room for legs")


def nan(request: EvalRequest) -> EvalResult:
    """Return a mean that is not a number, which `EvalResult` refuses."""
    return EvalResult(math.nan)


def smuggled_nan(request: EvalRequest) -> EvalResult:
    """Return a mean that is not a number, past the checks of `EvalResult`."""
    result = EvalResult(1.0)
    object.__setattr__(result, "mean", math.nan)
    return result


def wrong_type(request: EvalRequest) -> Any:
    """Return a number."""
    return request.params["x"]


def exit_process(request: EvalRequest) -> EvalResult:
    """End the process without a word."""
    os._exit(3)


def kill_process(request: EvalRequest) -> EvalResult:
    """Kill the process as `kill -9` does."""
    os.kill(os.getpid(), signal.SIGKILL)
    return EvalResult(request.params["x"])


def wait_for_go(request: EvalRequest) -> EvalResult:
    """Wait until `go` appears beside the work folder."""
    part = request.workdir / "begun.part"
    part.write_text(str(os.getpid()))
    part.rename(request.workdir / "begun")
    _wait_for(request.workdir.parent / "go")
    (request.workdir / "ended").touch()
    return EvalResult(request.params["x"])


def interval(request: EvalRequest) -> EvalResult:
    """Take a moment; return in `extras` when it began and ended (Unix time, s)."""
    begin = time.time()
    time.sleep(0.2)
    return EvalResult(request.params["x"], extras={"begin": begin, "end": time.time()})


def _wait_for(path: Path) -> None:
    end = time.monotonic() + WAIT
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.02)
