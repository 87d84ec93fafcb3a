"""Evaluations on any `concurrent.futures.Executor`: a thread pool, a process pool, Dask's client, ..."""

from __future__ import annotations

import concurrent.futures
from concurrent.futures import BrokenExecutor, CancelledError, Future, ProcessPoolExecutor
from types import TracebackType
from typing import Self

from codesign_bo.executors.evaluate import CANCELLED, PickledCallback, evaluate
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult

_BROKEN = (
    "the pool broke: one of its processes died, and took with it all evaluations in flight; "
    "give a new pool, or use LocalExecutor, where a dying evaluation harms no other"
)


class FutureJob:
    """An evaluation in a pool (a `Job`)."""

    def __init__(self, future: Future[str]) -> None:
        self._future = future
        self._given_up = False

    def done(self) -> bool:
        """Whether there is a result."""
        return self._given_up or self._future.done()

    def result(self) -> EvalResult:
        """Wait until done and return the outcome."""
        if self._given_up:
            return CANCELLED
        try:
            error = self._future.exception()
        except CancelledError:
            return CANCELLED
        if error is None:
            return EvalResult.from_json(self._future.result())
        # evaluate() raises nothing, so this is the pool's
        broken = isinstance(error, BrokenExecutor)
        return EvalResult.failure("lost", _BROKEN if broken else f"the pool failed: {error!r}")

    def cancel(self) -> None:
        """Give the evaluation up. If it is running, it runs on: a pool offers no way to kill it."""
        if not self._future.cancel() and not self._future.done():
            self._given_up = True


class FuturesExecutor:
    """Runs evaluations in a pool that somebody else wrote.

    A pool has no time limit, cannot stop what is running, and most share their threads or processes among
    evaluations: an evaluation that ends its process breaks a process pool, and hanging ones fill it up.

    Args:
        pool: The pool; it is shut down when this executor is closed.
        slots: How many evaluations it runs at once.

    Raises:
        ValueError: `slots < 1`.

    Example:
        >>> with FuturesExecutor(ThreadPoolExecutor(4), slots=4) as executor:  # doctest: +SKIP
        ...     print(executor.submit(evaluate, request).result())
    """

    def __init__(self, pool: concurrent.futures.Executor, slots: int) -> None:
        if slots < 1:
            raise ValueError(f"slots is {slots}; an executor needs at least 1")
        self.slots = slots
        self._pool = pool
        self._jobs: list[FutureJob] = []

    def submit(self, callback: Callback, request: EvalRequest) -> FutureJob:
        """Evaluate `callback(request)` in the pool.

        Raises:
            TypeError: The pool is a process pool, and the callback cannot be pickled.
            RuntimeError: The pool is broken or shut down.
        """
        if isinstance(self._pool, ProcessPoolExecutor):
            callback = PickledCallback(callback)
        try:
            job = FutureJob(self._pool.submit(evaluate, callback, request))
        except BrokenExecutor as error:
            raise RuntimeError(_BROKEN) from error
        self._jobs = [*(j for j in self._jobs if not j.done()), job]
        return job

    def close(self) -> None:
        """Cancel all jobs and shut the pool down, which waits for evaluations that are running."""
        for job in self._jobs:
            job.cancel()
        self._pool.shutdown(wait=True)

    def __enter__(self) -> Self:
        """Return the executor, to be closed at the end of the block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the executor."""
        self.close()
