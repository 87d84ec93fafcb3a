"""Executors that guard each running evaluation with a thread: queue, slots and cancelling, once for all of them."""

from __future__ import annotations

import atexit
import logging
import threading
from abc import ABC, abstractmethod
from concurrent.futures import CancelledError, Future
from queue import SimpleQueue
from types import TracebackType
from typing import Self

from codesign_bo.errors import ExecutorError
from codesign_bo.executors.evaluate import CANCELLED
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult

logger = logging.getLogger(__name__)


class SlotJob:
    """An evaluation that waits for a slot, or is run by one (a `Job`).

    Attributes:
        callback: What evaluates.
        request: What is evaluated.
        cancelled: Set when the evaluation is to be killed.
        future: Its result.
    """

    def __init__(self, callback: Callback, request: EvalRequest) -> None:
        self.callback = callback
        self.request = request
        self.cancelled = threading.Event()
        self.future: Future[EvalResult] = Future()

    def done(self) -> bool:
        """Whether there is a result."""
        return self.future.done()

    def result(self) -> EvalResult:
        """Wait until done and return the outcome.

        Raises:
            ExecutorError: Nothing can run there any more.
        """
        try:
            return self.future.result()
        except CancelledError:
            return CANCELLED

    def cancel(self) -> None:
        """Kill the evaluation, or never start it."""
        self.cancelled.set()
        self.future.cancel()


class SlotExecutor(ABC):
    """Takes evaluations from a queue with one thread per slot; a subclass says how a single one is run.

    Args:
        slots: How many run at once.

    Raises:
        ValueError: `slots < 1`.
    """

    def __init__(self, slots: int) -> None:
        if slots < 1:
            raise ValueError(f"slots is {slots}; an executor needs at least 1")
        self.slots = slots
        self._queue: SimpleQueue[SlotJob | None] = SimpleQueue()
        self._unfinished: set[SlotJob] = set()
        self._lock = threading.Lock()
        self._closed = False
        # Daemons, because the interpreter joins other threads before it gets to the exit handler below.
        self._threads = [threading.Thread(target=self._serve, args=(slot,), daemon=True) for slot in range(slots)]
        for thread in self._threads:
            thread.start()
        # Handlers run last in, first out: before that of multiprocessing, which would wait for the processes,
        # if that module was imported before.
        atexit.register(self.close)

    @abstractmethod
    def _run(self, job: SlotJob, slot: int) -> EvalResult:
        """Run one evaluation to its end, or until `job.cancelled` is set, and leave nothing of it behind.

        Raises:
            ExecutorError: Nothing can run there any more.
        """

    def submit(self, callback: Callback, request: EvalRequest) -> SlotJob:
        """Evaluate `callback(request)` as soon as a slot is free.

        Raises:
            RuntimeError: The executor is closed.
        """
        job = SlotJob(callback, request)
        with self._lock:
            if self._closed:
                raise RuntimeError(f"this {type(self).__name__} is closed; make a new one")
            self._unfinished.add(job)
        job.future.add_done_callback(lambda _: self._unfinished.discard(job))
        self._queue.put(job)
        return job

    def _serve(self, slot: int) -> None:
        while (job := self._queue.get()) is not None:
            if job.future.set_running_or_notify_cancel():
                try:
                    result = self._run(job, slot)
                except ExecutorError as error:
                    job.future.set_exception(error)
                    continue
                except Exception as error:
                    logger.exception("trial %d could not be run", job.request.trial)
                    result = EvalResult.failure("lost", f"the evaluation could not be run: {error!r}")
                job.future.set_result(result)

    def close(self) -> None:
        """Kill all evaluations that are not done, and end the threads."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        atexit.unregister(self.close)
        for job in list(self._unfinished):
            job.cancel()
        for _ in self._threads:
            self._queue.put(None)
        for thread in self._threads:
            thread.join()

    def __enter__(self) -> Self:
        """Return the executor, to be closed at the end of the block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the executor."""
        self.close()
