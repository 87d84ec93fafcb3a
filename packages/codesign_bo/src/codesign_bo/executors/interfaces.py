"""What a study needs from whatever runs its evaluations: a few slots and jobs that can be polled and killed."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from codesign_bo.interfaces import Callback, EvalRequest, EvalResult


class Job(Protocol):
    """One submitted evaluation."""

    def done(self) -> bool:
        """Whether there is a result; never blocks."""
        ...

    def result(self) -> EvalResult:
        """Wait until done and return the outcome, the same one each time.

        Whatever happened to the evaluation is an `EvalResult`, a failure if need be.

        Raises:
            ExecutorError: Nothing can run there any more, so that nothing is known of this evaluation.
        """
        ...

    def cancel(self) -> None:
        """Give the evaluation up, and kill it where the executor can; return without waiting for that.

        Soon afterwards the job is done: with its result if that came first, otherwise with a `lost` failure.
        What the evaluation returns later is ignored. Cancelling twice, or when done, does nothing.
        """
        ...


class Executor(Protocol):
    """Runs evaluations beside the coordinator, at most `slots` at once.

    Failures are told apart by their kind:

    - `crash`: the callback raised, returned something else than an `EvalResult`, ended its process or ran
      out of memory. The same would probably happen again.
    - `diverged`: its mean is not finite.
    - `timeout`: it took longer than the executor or `request.deadline` allows.
    - `lost`: nothing is known about the design, because the machine failed (an `OSError` counts as that),
      the worker vanished, or the evaluation was cancelled. It may be tried again.
    """

    @property
    def slots(self) -> int:
        """How many evaluations run at once."""
        ...

    def submit(self, callback: Callback, request: EvalRequest) -> Job:
        """Evaluate `callback(request)` as soon as a slot is free.

        Raises:
            TypeError: The callback cannot be sent to where it is to run.
            RuntimeError: The executor is closed or can run nothing any more.
        """
        ...

    def close(self) -> None:
        """Cancel all jobs that are not done and release processes and threads. Closing twice does nothing."""
        ...

    def __enter__(self) -> Self:
        """Return the executor, to be closed at the end of the block."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the executor."""
        ...
