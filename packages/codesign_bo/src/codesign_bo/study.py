"""The search: ask for designs, tell their scores, recommend the best and confirm it."""

# pyright: reportArgumentType=false
# designs are numbers here until records hold integers and categories too
from __future__ import annotations

import logging
import math
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from codesign_bo.confirm import NOMINAL_TRIAL, Confirmation
from codesign_bo.errors import StudyError
from codesign_bo.header import Header
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult
from codesign_bo.proposal import derive_seed, propose
from codesign_bo.records import ConfirmationRecord, TrialRecord
from codesign_bo.space import BoxSpace, Feasible
from codesign_bo.storage import Storage
from codesign_bo.view import StudyView

logger = logging.getLogger(__name__)

_BRAKE_FAILURES = 5
_MIN_SCORES = 2


class Study(StudyView):
    """A durable Bayesian optimisation over a box; opening the same file again goes on where it stopped.

    Trial 0 is the nominal design, then come queued designs, then Sobol points up to trial `n_init`, then
    the maxima of noisy expected improvement. What is proposed depends only on the settings and on the
    results told so far, so a killed and resumed study has the same trial table as an uninterrupted one.

    Args:
        space: What is searched.
        storage: Path of the SQLite file.
        seed: Seed of everything random in the study; trial seeds derive from it.
        maximize: Whether higher means are better.
        n_init: Trials before the surrogate takes over; by default twice the number of free parameters.
        feasible: Predicate over designs (n, d) in natural units; only feasible ones are proposed.
        workdir: Folder in which each evaluation gets its own; by default `trials` beside the file.

    Raises:
        StudyError: The file is damaged, in use, not writable, or belongs to a study with other settings.
        ValueError: The nominal design is infeasible, or a setting is out of range.

    Example:
        >>> space = BoxSpace.box(["thigh", "shank"], low=0.6, high=1.4, nominal=1.0)
        >>> with Study(space, "study.sqlite", seed=1) as study:  # doctest: +SKIP
        ...     study.run(evaluate, until=30)
        ...     print(study.best().params, study.confirm(evaluate).best)
    """

    def __init__(
        self,
        space: BoxSpace,
        storage: Path | str,
        seed: int = 0,
        maximize: bool = True,
        n_init: int | None = None,
        feasible: Feasible | None = None,
        workdir: Path | str | None = None,
    ) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        n_init = 2 * space.dim if n_init is None else n_init
        if n_init < 1:
            raise ValueError(f"n_init is {n_init}; it must be >= 1")
        self._feasible = feasible
        self._check_feasible(space, [space.nominal])
        opened = Storage(Path(storage))
        try:
            opened.bind(Header(space.signature(), seed, n_init, maximize))
            super().__init__(opened)
        except BaseException:
            opened.close()
            raise
        self.workdir = self.path.parent / "trials" if workdir is None else Path(workdir)
        self._dispatched: set[int] = set()

    # --- ask and tell ---------------------------------------------------------------------------------

    def ask(self, n: int = 1, deadline: float | None = None) -> list[EvalRequest]:
        """Return n evaluations to do, committed before they are returned.

        Trials left unfinished by an earlier coordinator come first, with the same design and seed.

        Args:
            n: How many.
            deadline: Unix time (s) to pass on to the evaluations.
        """
        return [self._ask_one(deadline) for _ in range(n)]

    def _ask_one(self, deadline: float | None) -> EvalRequest:
        trials = self.trials()
        for record in trials:
            if record.result is None and record.trial not in self._dispatched:
                attempt = self._storage.add_attempt(record.trial)
                self._dispatched.add(record.trial)
                return self._request(record, attempt, deadline)
        trial = len(trials)
        scored = [t for t in trials if t.ok]
        ready = trial >= self.n_init and len(scored) >= _MIN_SCORES
        # Failed designs count as pending, because nothing is to be gained from trying them again.
        avoid = [t.params for t in trials if not t.ok]
        proposal = propose(
            self.space,
            trial,
            self.n_init,
            self.seed,
            self.surrogate() if ready else None,
            self.space.to_unit(self.space.designs(avoid)),
            next((dict(q.params) for q in self.queue() if q.trial is None), None),
            self.maximize,
            self._feasible,
        )
        seed = derive_seed(self.seed, trial)
        self._storage.add_trial(trial, proposal, seed)
        self._dispatched.add(trial)
        return self._request(TrialRecord(trial, proposal.params, seed, proposal.origin, None), 1, deadline)

    def _request(self, record: TrialRecord, attempt: int, deadline: float | None) -> EvalRequest:
        return EvalRequest(
            trial=record.trial,
            attempt=attempt,
            params=record.params,
            seed=record.seed,
            workdir=self.workdir / f"{record.trial:04d}",
            deadline=deadline,
        )

    def tell(self, trial: int, result: EvalResult) -> None:
        """Commit the result of a trial. Telling the same again does nothing.

        Raises:
            StudyError: There is no such trial, or it already has another result.
        """
        self._storage.finish(trial, result)
        self._dispatched.discard(trial)

    def run(
        self,
        callback: Callback,
        until: int = 30,
        progress: Callable[[TrialRecord], None] | None = None,
        deadline: float | None = None,
    ) -> list[TrialRecord]:
        """Ask, evaluate and tell, one trial after the other, until `until` trials are finished.

        Args:
            callback: Evaluates a design. What it raises is recorded as a `crash` of that trial, except
                OSError and MemoryError: those are the machine's, pass through, and leave the trial open.
            until: Total number of finished trials, failed and earlier ones included.
            progress: Called with each trial as it finishes.
            deadline: Unix time (s) to pass on to the evaluations.

        Returns:
            The trial table.

        Raises:
            StudyError: More than half of the trials fail, at least 5; those are kept, see `retry_failed`.
            TypeError: The callback returned something else than an `EvalResult`; its trial stays open.
        """
        while sum(t.result is not None for t in self.trials()) < until:
            (request,) = self.ask(deadline=deadline)
            result = _evaluate(callback, request)
            self.tell(request.trial, result)
            trials = self.trials()
            if progress is not None:
                progress(trials[request.trial])
            if not result.ok:
                self._brake(trials, result)
        return self.trials()

    def _brake(self, trials: Sequence[TrialRecord], last: EvalResult) -> None:
        finished = [t for t in trials if t.result is not None]
        failures = sum(not t.ok for t in finished)
        if failures >= _BRAKE_FAILURES and 2 * failures > len(finished):
            raise StudyError(
                f"{failures} of {len(finished)} trials of {self.path} failed; the last ({last.status}): "
                f"{last.message}\n"
                "All are on record: repair the evaluation, then retry_failed() and run() again"
            )

    def retry_failed(self) -> int:
        """Make all failed trials and confirmation runs unfinished again; return how many there were.

        For failures whose cause lay outside the design and is repaired. They keep design and seed.
        """
        return self._storage.reopen_failed()

    # --- what to try first ----------------------------------------------------------------------------

    def enqueue(self, points: Sequence[Mapping[str, float]]) -> None:
        """Queue designs to be tried before any further proposal of the study.

        A design that ever was in the queue is left out, so a resumed script may queue the same again.

        Raises:
            ValueError: A design is incomplete, out of bounds or infeasible; then none is queued.
        """
        checked = [self.space.check(p) for p in points]
        self._check_feasible(self.space, checked)
        self._storage.enqueue(checked)

    def add_screening(self, points: Sequence[Mapping[str, float]], values: Sequence[float]) -> None:
        """Store cheap scores of designs. They never reach the surrogate; see `enqueue_screened`.

        Args:
            points: n designs; the newest score of a design counts.
            values: Their n scores, in the direction of the objective.

        Raises:
            ValueError: A design is invalid, a score is not finite, or their numbers differ.
        """
        if len(points) != len(values):
            raise ValueError(f"{len(points)} designs, but {len(values)} screening scores")
        if not all(math.isfinite(v) for v in values):
            raise ValueError("screening scores must be finite; leave failed designs out")
        self._storage.add_screening([self.space.check(p) for p in points], values)

    def enqueue_screened(self, n: int, separation: float = 0.1) -> list[dict[str, float]]:
        """Queue the n best screened designs that are not close to one another or to the nominal one.

        Args:
            n: How many at most.
            separation: Least distance (largest difference of any coordinate) in the unit cube.

        Returns:
            The queued designs, the best first.
        """
        sign = -1.0 if self.maximize else 1.0
        records = sorted(self.screening(), key=lambda r: sign * r.value)
        points = self.space.to_unit(self.space.designs(r.params for r in records))
        kept = [self.space.to_unit(self.space.designs([self.space.nominal]))[0]]
        chosen: list[dict[str, float]] = []
        for record, point in zip(records, points, strict=True):
            if len(chosen) == n:
                break
            if np.abs(np.array(kept) - point).max(axis=1).min() >= separation:
                kept.append(point)
                chosen.append(dict(record.params))
        self.enqueue(chosen)
        return chosen

    def _check_feasible(self, space: BoxSpace, points: Sequence[Mapping[str, float]]) -> None:
        if self._feasible is None or not points:
            return
        mask = self._feasible(space.designs(points))
        bad = [dict(p) for p, good in zip(points, mask, strict=True) if not good]
        if bad:
            raise ValueError(f"infeasible by the study's own predicate: {bad}")

    # --- confirm --------------------------------------------------------------------------------------

    def confirm(
        self,
        callback: Callback,
        top_k: int = 2,
        repeats: int = 3,
        level: float = 0.95,
        progress: Callable[[ConfirmationRecord], None] | None = None,
    ) -> Confirmation:
        """Evaluate the nominal design and the best others again, on fresh seeds that all share.

        The others are the `top_k` designs with the best posterior mean that differ from the nominal one.
        Runs are durable: a killed confirmation goes on, more repeats add to those done.

        Args:
            callback: Evaluates a design, as in `run`; its work folder is `confirm` in the trial's own.
            top_k: How many designs to confirm. Each costs `repeats` evaluations and widens the intervals.
            repeats: Fresh seeds per design.
            level: Confidence level of the intervals.
            progress: Called with each run as it finishes.

        Returns:
            Gains over the nominal design with intervals (see `codesign_bo.confirm.analyse`).

        Raises:
            StudyError: No trial has a score yet.
        """
        records = {t.trial: t for t in self.trials()}
        chosen = [NOMINAL_TRIAL]
        for estimate in self.ranking():
            if len(chosen) <= top_k and all(estimate.params != records[t].params for t in chosen):
                chosen.append(estimate.trial)
        done = {(c.trial, c.repeat) for c in self.confirmations() if c.result is not None}
        for repeat in range(repeats):
            seed = derive_seed(self.seed, repeat, 2)
            for trial in (t for t in chosen if (t, repeat) not in done):
                attempt = self._storage.add_confirmation(trial, repeat, seed)
                folder = self.workdir / f"{trial:04d}" / "confirm" / f"{repeat:02d}"
                request = EvalRequest(trial, attempt, records[trial].params, seed, workdir=folder)
                result = _evaluate(callback, request)
                self._storage.finish_confirmation(trial, repeat, result)
                if progress is not None:
                    progress(ConfirmationRecord(trial, repeat, seed, result, attempt))
        return self.confirmation(level)


def _evaluate(callback: Callback, request: EvalRequest) -> EvalResult:
    request.workdir.mkdir(parents=True, exist_ok=True)
    try:
        result = callback(request)
    except (OSError, MemoryError):
        raise  # a full disk is not the design's fault: the evaluation stays open
    except Exception as error:
        logger.warning("trial %d: the evaluation raised %r", request.trial, error)
        return EvalResult.failure("crash", traceback.format_exc()[-2000:])
    if not isinstance(result, EvalResult):
        raise TypeError(f"the callback returned {type(result).__name__}; it must return an EvalResult")
    return result
