"""The loop that keeps an executor busy: ask, submit, poll, tell, and survive whatever happens in between."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from codesign_bo.errors import ExecutorError, StudyError
from codesign_bo.executors.evaluate import failure
from codesign_bo.executors.interfaces import Executor, Job
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult
from codesign_bo.records import Told
from codesign_bo.running.evaluation import checked

logger = logging.getLogger(__name__)

_SHORTEST_WAIT, _LONGEST_WAIT = 0.01, 0.5


class Work(Protocol):
    """What is to be evaluated, and where the results go."""

    def next(self, running: int) -> EvalRequest | None:
        """Return the next evaluation, committed; None while there is none to add to those that run."""
        ...

    def tell(self, request: EvalRequest, result: EvalResult) -> Told:
        """Commit a result."""
        ...

    def give_up(self, request: EvalRequest, message: str) -> Told:
        """Commit that an evaluation counts as lost."""
        ...

    def release(self, message: str) -> None:
        """Commit that whatever is still in hand was interrupted."""
        ...


class Observer(Protocol):
    """Sees what happens, to show it."""

    def started(self, request: EvalRequest) -> None:
        """An evaluation is about to be submitted."""
        ...

    def ended(self, request: EvalRequest, result: EvalResult, told: Told) -> None:
        """A result was committed."""
        ...


@dataclass(frozen=True, eq=False)
class _Flight:
    request: EvalRequest
    job: Job
    started: float

    @property
    def evaluation(self) -> tuple[int, int]:
        return _evaluation(self.request)


class Coordinator:
    """Evaluates some work on an executor, as many at once as it has slots.

    All results that are there are told, the lowest trial first, before the next evaluation is asked
    for, so each proposal knows as much as can be known. Time is measured on a steady clock; only `deadline`
    follows the machine's.

    Args:
        work: What to do.
        callback: Evaluates a design.
        executor: Where.
        observer: Who is shown what happens.
        patience: Seconds after which an evaluation that was not heard of is given up as lost. Its result is
            still taken should it come late.
        deadline: Unix time (s) at which everything in flight is cancelled and left open.
    """

    def __init__(
        self,
        work: Work,
        callback: Callback,
        executor: Executor,
        observer: Observer | None = None,
        patience: float | None = None,
        deadline: float | None = None,
    ) -> None:
        self._work = work
        self._callback = callback
        self._executor = executor
        self._observer = observer
        self._patience = patience
        self._deadline = deadline
        self._running: list[_Flight] = []
        self._given_up: list[_Flight] = []

    def run(self) -> None:
        """Work until there is nothing left to do, or the deadline has passed.

        Raises:
            BaseException: Whatever stops the loop, KeyboardInterrupt and ExecutorError too. What was in flight is then
                cancelled and left open; nothing that was told is lost.
        """
        wait = _SHORTEST_WAIT
        try:
            while not self._out_of_time():
                self._fill()
                if not self._running:
                    return
                if self._collect():
                    wait = _SHORTEST_WAIT
                else:
                    time.sleep(wait)
                    wait = min(2.0 * wait, _LONGEST_WAIT)
            self._collect()
            self._abandon("the deadline passed")
        except BaseException as error:
            # A full disk may be what stopped the loop, and then this cannot be committed either.
            with contextlib.suppress(StudyError):
                self._abandon(f"the coordinator stopped: {type(error).__name__}")
            raise

    def _out_of_time(self) -> bool:
        return self._deadline is not None and time.time() >= self._deadline

    def _fill(self) -> None:
        while len(self._running) < self._executor.slots and not self._out_of_time():
            request = self._work.next(len(self._running))
            if request is None:
                return
            request.workdir.mkdir(parents=True, exist_ok=True)
            if self._observer is not None:
                self._observer.started(request)
            started = time.monotonic()
            self._running.append(_Flight(request, self._executor.submit(self._callback, request), started))

    def _collect(self) -> bool:
        """Tell all results that are there, give up what takes too long, and return whether anything happened."""
        done = [flight for flight in self._running if flight.job.done()]
        for flight in sorted(done, key=lambda f: f.evaluation):
            if flight in self._running:  # a late result of another attempt may have settled it meanwhile
                self._running.remove(flight)
                self._tell(flight.request, _outcome(flight.job))
        late = [flight for flight in self._given_up if flight.job.done()]
        for flight in late:
            self._given_up.remove(flight)
            result = _outcome(flight.job)
            if not result.failed:  # failures were to be expected: the job is cancelled
                self._tell(flight.request, result)
        slow = [flight for flight in self._running if self._is_slow(flight)]
        for flight in slow:
            message = f"given up after {self._patience:.0f} s without a result"
            told = self._work.give_up(flight.request, message)
            flight.job.cancel()
            self._running.remove(flight)
            self._given_up.append(flight)
            self._show(flight.request, EvalResult.failure("lost", message), told)
        return bool(done or late or slow)

    def _is_slow(self, flight: _Flight) -> bool:
        return self._patience is not None and time.monotonic() - flight.started > self._patience

    def _tell(self, request: EvalRequest, result: EvalResult) -> None:
        told = self._work.tell(request, result)
        if told == "counted":
            self._cancel(lambda flight: flight.evaluation == _evaluation(request))
        self._show(request, result, told)

    def _cancel(self, which: Callable[[_Flight], bool]) -> None:
        for flight in [f for f in self._running if which(f)]:
            flight.job.cancel()
            self._running.remove(flight)

    def _show(self, request: EvalRequest, result: EvalResult, told: Told) -> None:
        if told != "counted":
            logger.warning("trial %d, attempt %d: %s (%s)", request.trial, request.attempt, result.status, told)
        if self._observer is not None:
            self._observer.ended(request, result, told)

    def _abandon(self, message: str) -> None:
        for flight in self._running + self._given_up:
            flight.job.cancel()
        self._work.release(message)


def _evaluation(request: EvalRequest) -> tuple[int, int]:
    return (-1 if request.repeat is None else request.repeat, request.trial)


def _outcome(job: Job) -> EvalResult:
    try:
        result = job.result()
    except ExecutorError:
        raise
    except Exception as error:  # an executor should not, but one that does must not end the study
        return EvalResult.failure("lost", f"the executor raised: {failure(error).message}")
    return checked(result)
