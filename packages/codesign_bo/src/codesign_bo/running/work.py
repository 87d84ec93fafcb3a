"""What a study gives its coordinator to do: a search, or a confirmation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from codesign_bo.errors import StudyError
from codesign_bo.interfaces import EvalRequest, EvalResult
from codesign_bo.records import ConfirmationRecord, Told, TrialRecord
from codesign_bo.running.dispatch import Dispatcher, Evaluation
from codesign_bo.space import Value
from codesign_bo.stopping import MedianStopping

if TYPE_CHECKING:
    from codesign_bo.study import Study

_BRAKE_FAILURES = 5


class Search:
    """Trials, until a number of them is finished.

    Args:
        study: The study.
        dispatcher: Its attempts.
        until: Total number of finished trials.
        deadline: Unix time (s) to pass on to the evaluations.
        stopping: Rule that stops hopeless evaluations.
        finished: Called with each trial as it finishes.
    """

    def __init__(
        self,
        study: Study,
        dispatcher: Dispatcher,
        until: int,
        deadline: float | None,
        stopping: MedianStopping | None,
        finished: Callable[[TrialRecord], None] | None,
    ) -> None:
        self._study = study
        self._dispatcher = dispatcher
        self._until = until
        self._deadline = deadline
        self._stopping = stopping
        self._finished = finished
        self._foreign = dispatcher.held
        self._failure: EvalResult | None = None

    def next(self, running: int) -> EvalRequest | None:
        """Return the next trial, unless those that run are enough.

        Raises:
            StudyError: More than half of the trials failed, at least 5, one of them since the last call.
        """
        if self._failure is not None:
            self._brake(self._failure)
            self._failure = None
        if self._study.finished() + running >= self._until:
            return None
        return self._study.ask(1, self._deadline, self._stopping)[0]

    def tell(self, request: EvalRequest, result: EvalResult) -> Told:
        """Commit a result."""
        told = self._study.tell(request.trial, result, request.token)
        if told == "counted":
            self._count(request.trial)
        return told

    def give_up(self, request: EvalRequest, message: str) -> Told:
        """Commit that an evaluation counts as lost."""
        told = self._study.give_up(request.trial, request.token, message)
        if told == "counted":
            self._count(request.trial)
        return told

    def release(self, message: str) -> None:
        """Leave what this search has in hand open."""
        self._dispatcher.release(self._dispatcher.held - self._foreign, message)

    def _count(self, trial: int) -> None:
        record = self._study.trials()[trial]
        if record.failed:
            self._failure = record.result
        if self._finished is not None:
            self._finished(record)

    def _brake(self, last: EvalResult) -> None:
        trials = self._study.trials()
        finished = sum(t.result is not None for t in trials)
        failures = sum(t.failed for t in trials)
        if failures >= _BRAKE_FAILURES and 2 * failures > finished:
            raise StudyError(
                f"{failures} of {finished} trials of {self._study.path} failed; the last ({last.status}): "
                f"{last.message}\n"
                "All are on record: repair the evaluation, then retry_failed() and run() again"
            )


class ConfirmationRuns:
    """Designs again, on fresh seeds.

    Args:
        dispatcher: The study's attempts.
        plan: Evaluations to do, with their seeds, in order.
        params: Design of each trial.
        finished: Called with each run as it finishes.
    """

    def __init__(
        self,
        dispatcher: Dispatcher,
        plan: Mapping[Evaluation, int],
        params: Mapping[int, Mapping[str, Value]],
        finished: Callable[[ConfirmationRecord], None] | None,
    ) -> None:
        self._dispatcher = dispatcher
        self._open = dict(plan)
        self._params = params
        self._finished = finished

    def next(self, running: int) -> EvalRequest | None:
        """Return the next run that is neither finished nor in hand."""
        for evaluation, seed in self._open.items():
            if evaluation not in self._dispatcher.held:
                return self._dispatcher.again(evaluation, self._params[evaluation[0]], seed)
        return None

    def tell(self, request: EvalRequest, result: EvalResult) -> Told:
        """Commit a result."""
        return self._settled(request, result, self._dispatcher.tell(_named(request), result, request.token))

    def give_up(self, request: EvalRequest, message: str) -> Told:
        """Commit that a run counts as lost."""
        told = self._dispatcher.give_up(_named(request), request.token, message)
        return self._settled(request, EvalResult.failure("lost", message), told)

    def release(self, message: str) -> None:
        """Leave what is in hand open."""
        self._dispatcher.release(self._open, message)

    def _settled(self, request: EvalRequest, result: EvalResult, told: Told) -> Told:
        if told == "counted":
            trial, repeat = _named(request)
            del self._open[trial, repeat]
            if self._finished is not None:
                self._finished(ConfirmationRecord(trial, repeat, request.seed, result, request.attempt))
        return told


def _named(request: EvalRequest) -> Evaluation:
    assert request.repeat is not None
    return request.trial, request.repeat
