"""Evaluations on this machine, each in a fresh process that can be limited and killed."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import multiprocessing.util  # pyright: ignore[reportUnusedImport] (its exit handler must run after ours, see slots)
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from multiprocessing.context import SpawnProcess
from pathlib import Path

import psutil

from codesign_bo.executors import trial_process
from codesign_bo.executors.evaluate import CANCELLED, PickledCallback
from codesign_bo.executors.slots import SlotExecutor, SlotJob
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult

_POLL = 0.1  # s
_EXIT_GRACE = 10.0  # s for exit handlers once there is a result
_TAIL = 2000
_GB = 1e9


class LocalExecutor(SlotExecutor):
    """Runs each evaluation in a fresh process on this machine (Linux or macOS).

    The process starts empty (`spawn`), so neither CUDA nor a simulator is shared with the coordinator, and
    leads a session of its own. When the evaluation ends, is cancelled, takes too long or too much memory, or
    when the coordinator dies, even by kill -9, everything in that session is killed. What it prints is
    appended to `stdout.txt` and `stderr.txt` in `request.workdir`, and its result is left there in
    `result-<trial>-<attempt>.json`.

    A script that uses this executor needs the usual `if __name__ == "__main__":`. Several trials share the
    cores of a machine best with OMP_NUM_THREADS set.

    Args:
        slots: How many evaluations run at once.
        timeout: Longest wall-clock time (s) of one, or None; `request.deadline` holds as well.
        memory: Most resident memory (bytes) of one with all processes it started, or None. It is looked at
            now and then, and memory shared between processes counts in each.
        gpus: Devices for CUDA_VISIBLE_DEVICES, one entry such as 0 or "2,3" per slot; with more slots than
            entries, slots share them.
        reuse: Take the score that an attempt at the same evaluation (trial, design, seed and fidelity) has
            already left in the folder, if there is one, instead of evaluating again.

    Raises:
        ValueError: A limit is not positive, or there are more GPU entries than slots.
        RuntimeError: This is Windows.

    Example:
        >>> with LocalExecutor(slots=2, timeout=3600) as executor:  # doctest: +SKIP
        ...     print(executor.submit(evaluate, request).result())
    """

    def __init__(
        self,
        slots: int = 1,
        timeout: float | None = None,
        memory: int | None = None,
        gpus: Sequence[int | str] = (),
        reuse: bool = False,
    ) -> None:
        if sys.platform == "win32":
            raise RuntimeError("LocalExecutor needs process groups, which Windows lacks; use FuturesExecutor")
        for name, limit in (("timeout", timeout), ("memory", memory)):
            if limit is not None and not limit > 0:
                raise ValueError(f"{name} is {limit}; it must be positive, or None for no limit")
        if len(gpus) > slots:
            raise ValueError(f"{len(gpus)} GPU entries for {slots} slots: some would idle; set slots to {len(gpus)}")
        self._timeout = math.inf if timeout is None else timeout
        self._memory = memory
        self._gpus = [str(gpu) for gpu in gpus]
        self._reuse = reuse
        self._spawn = multiprocessing.get_context("spawn")
        super().__init__(slots)

    def submit(self, callback: Callback, request: EvalRequest) -> SlotJob:
        """Evaluate `callback(request)` as soon as a slot is free.

        Raises:
            TypeError: The callback cannot be pickled.
            RuntimeError: The executor is closed.
        """
        return super().submit(PickledCallback(callback), request)

    def _run(self, job: SlotJob, slot: int) -> EvalResult:
        request = job.request
        for attempt in range(request.attempt, 0, -1) if self._reuse else ():
            found = trial_process.read_result(request, attempt)
            if found is not None and found.ok:
                return found
        deadline = math.inf if request.deadline is None else request.deadline
        seconds = min(self._timeout, deadline - time.time())
        if seconds <= 0:
            return EvalResult.failure("timeout", "the deadline had passed before the evaluation could start")
        request.workdir.mkdir(parents=True, exist_ok=True)
        trial_process.result_path(request, request.attempt).unlink(missing_ok=True)
        begin = _open_logs(request)
        gpus = self._gpus[slot % len(self._gpus)] if self._gpus else None
        process = self._spawn.Process(target=trial_process.main, args=(job.callback, request, gpus, os.getpid()))
        with _guard() as guard:
            process.start()
            try:
                print(process.pid, file=guard.stdin, flush=True)
                stopped = self._watch(process, job, seconds)
            finally:
                _kill(process)
                guard.kill()
        # A result counts even if the process came to grief after it.
        result = trial_process.read_result(request, request.attempt) or stopped or _crash(process, request, begin)
        with contextlib.suppress(ValueError):  # not even dead: a system call that cannot be interrupted
            process.close()
        return result

    def _watch(self, process: SpawnProcess, job: SlotJob, seconds: float) -> EvalResult | None:
        """Wait until the process has ended, or return why it must be killed."""
        result = trial_process.result_path(job.request, job.request.attempt)
        end = time.monotonic() + seconds  # a deadline in Unix time would move when the clock is set
        exit_by = math.inf
        while process.exitcode is None:
            now = time.monotonic()
            if result.exists():
                exit_by = min(exit_by, now + _EXIT_GRACE)
            if now > exit_by:
                return None
            if job.cancelled.is_set():
                return CANCELLED
            if now > end:
                return EvalResult.failure("timeout", f"no result within {seconds:.1f} s")
            if self._memory is not None:
                resident, count = _resident(process)
                if resident > self._memory:
                    return EvalResult.failure(
                        "crash",
                        f"out of memory: {resident / _GB:.2f} GB resident in {count} processes, "
                        f"the limit is {self._memory / _GB:.2f} GB",
                    )
            job.cancelled.wait(_POLL)
        return None


def _open_logs(request: EvalRequest) -> int:
    """Head the logs of this attempt; return where it begins in `stderr.txt` (bytes)."""
    begin = 0
    for name in ("stdout.txt", "stderr.txt"):
        with open(request.workdir / name, "a", encoding="utf-8") as file:
            print(f"--- trial {request.trial}, attempt {request.attempt}, {time.ctime()} ---", file=file, flush=True)
            begin = file.tell()
    return begin


def _guard() -> subprocess.Popen[str]:
    """Start a shell that kills the group whose number it reads, as soon as this process dies, however it does.

    It needs no cooperation of the trial, as a thread of it would (and not get while a C function keeps the
    interpreter), and does not spare what the trial started, as the kernel's parent-death signal would.
    """
    return subprocess.Popen(
        ["/bin/sh", "-c", 'read -r group && { read -r end; kill -s KILL -- "-$group"; }'],
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _number(process: SpawnProcess) -> int:
    assert process.pid is not None, "only a process that was started has a number"
    return process.pid


def _resident(process: SpawnProcess) -> tuple[int, int]:
    """Return the resident memory (bytes) of a process with its descendants, and their number."""
    sizes: list[int] = []
    for member in _family(process):
        with contextlib.suppress(psutil.Error):
            sizes.append(member.memory_info().rss)
    return sum(sizes), len(sizes)


def _family(process: SpawnProcess) -> list[psutil.Process]:
    try:
        parent = psutil.Process(_number(process))
        return [parent, *parent.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _kill(process: SpawnProcess) -> None:
    """Kill a trial's session, even if its leader has ended, and descendants that left it; reap the leader."""
    family = _family(process) if process.exitcode is None else []
    with contextlib.suppress(ProcessLookupError, PermissionError):  # gone, or on macOS a zombie
        os.killpg(_number(process), signal.SIGKILL)
    for member in family:
        with contextlib.suppress(psutil.NoSuchProcess):
            member.kill()
    end = time.monotonic() + _EXIT_GRACE
    while process.exitcode is None and time.monotonic() < end:
        time.sleep(_POLL / 10)


def _crash(process: SpawnProcess, request: EvalRequest, begin: int) -> EvalResult:
    code = process.exitcode or 0  # not None, for it has ended
    stderr = _tail(request.workdir / "stderr.txt", begin)
    if code == trial_process.RESULT_NOT_WRITTEN:
        return EvalResult.failure("lost", f"the result could not be written\n{stderr}")
    if code < 0:
        message = f"killed by {_signal_name(-code)}"
        if -code == signal.SIGKILL:
            message += ", not by this executor: perhaps the machine ran out of memory"
    else:
        message = f"ended with exit code {code} and no result"
        if code == 1 and not stderr:
            message += "; a script that lacks `if __name__ == '__main__':` does this"
    return EvalResult.failure("crash", f"{message}\n{stderr}".strip())


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _tail(path: Path, begin: int) -> str:
    """Return the end of a log, but nothing before `begin` (bytes)."""
    try:
        with open(path, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(begin, size - _TAIL))
            return file.read().decode(errors="replace").strip()
    except OSError:
        return ""
