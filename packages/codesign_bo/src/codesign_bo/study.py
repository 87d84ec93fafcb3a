"""The search: ask for designs, tell their scores, recommend the best and confirm it."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from pathlib import Path

from codesign_bo.confirm import NOMINAL_TRIAL, Confirmation
from codesign_bo.errors import StudyError
from codesign_bo.executors.interfaces import Executor
from codesign_bo.header import Direction, Header
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult
from codesign_bo.records import ConfirmationRecord, Told, TrialRecord
from codesign_bo.retries import RETRIES
from codesign_bo.running.dispatch import Dispatcher, Evaluation
from codesign_bo.running.progress import Tally
from codesign_bo.running.session import coordinate, listener
from codesign_bo.running.work import ConfirmationRuns, Search
from codesign_bo.seeds import derive_seed
from codesign_bo.space import BoxSpace, Feasible
from codesign_bo.stopping import MedianStopping
from codesign_bo.storage import SEARCH, Storage
from codesign_bo.suggestions import Suggestions, check_feasible
from codesign_bo.view import open_study

logger = logging.getLogger(__name__)


class Study(Suggestions):
    """A durable Bayesian optimisation; opening the same file again goes on where it stopped.

    Trial 0 is the nominal design, then come queued designs, then Sobol points up to trial `n_init`, then
    the maxima of noisy expected improvement. What is proposed depends only on the settings and on the
    results told so far, so a killed and resumed study has the same trial table as an uninterrupted one.

    Args:
        space: What is searched.
        storage: Path of the SQLite file.
        seed: Seed of everything random in the study; trial seeds derive from it.
        maximize: Whether higher means are better.
        n_init: Trials before the surrogate takes over; by default twice the number of free parameters.
            Imported results count towards it (see `add_history`).
        feasible: Predicate over designs (n, d) in natural units; only feasible ones are proposed.
        workdir: Folder in which each evaluation gets its own; by default `trials` beside the file.
        objectives: Further objectives, such as `{"energy": "minimize"}`: names of `EvalResult.extras` that
            each result must then have.
        retries: Further attempts after an evaluation was lost (see `codesign_bo.retries`).
        allow_network: Whether the file may lie on a network file system.

    Raises:
        StudyError: The file is damaged, in use, not writable, on a network file system, or belongs to a
            study with other settings.
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
        objectives: Mapping[str, Direction] | None = None,
        retries: int = RETRIES,
        allow_network: bool = False,
    ) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        n_init = 2 * space.dim if n_init is None else n_init
        if n_init < 1:
            raise ValueError(f"n_init is {n_init}; it must be >= 1")
        if retries < 0:
            raise ValueError(f"retries is {retries}; it must be >= 0")
        check_feasible(space, [space.nominal], feasible)
        header = Header(space.signature(), seed, n_init, maximize, objectives or {})
        opened = Storage(Path(storage), allow_network=allow_network)
        try:
            opened.bind(header)
            if feasible is not None:
                opened.set_predicate(_name(feasible))
            elif opened.predicate() is not None:
                logger.warning("%s had the predicate %s; now designs go unchecked", storage, opened.predicate())
            super().__init__(opened, feasible)
        except BaseException:
            opened.close()
            raise
        self.workdir = self.path.parent / "trials" if workdir is None else Path(workdir)
        self._dispatcher = Dispatcher(opened, self.workdir, self.objectives, retries)

    @classmethod
    def resume(
        cls,
        storage: Path | str,
        feasible: Feasible | None = None,
        workdir: Path | str | None = None,
        retries: int = RETRIES,
        allow_network: bool = False,
    ) -> Study:
        """Open an existing study with the space and settings it was made with.

        Args:
            storage: Path of the SQLite file.
            feasible: The predicate it was made with: functions are not stored.
            workdir: The folder for evaluations it was made with, if not `trials` beside the file.
            retries: Further attempts after an evaluation was lost.
            allow_network: Whether the file may lie on a network file system.

        Raises:
            StudyError: There is no study, or it had a predicate and none is given.
        """
        with open_study(storage) as view:
            if view.predicate is not None and feasible is None:
                raise StudyError(
                    f"{storage} was made with the feasibility predicate {view.predicate}; without it infeasible "
                    "designs would be proposed. Give it again"
                )
            space, settings = view.space, (view.seed, view.maximize, view.n_init)
            objectives = view.objectives
        return cls(space, storage, *settings, feasible, workdir, objectives, retries, allow_network)

    # --- ask and tell ---------------------------------------------------------------------------------

    def ask(
        self, n: int = 1, deadline: float | None = None, stopping: MedianStopping | None = None
    ) -> list[EvalRequest]:
        """Return n evaluations to do, committed before they are returned.

        Trials left unfinished by an earlier coordinator, or to be tried again, come first, with the same
        design and seed.

        Args:
            n: How many.
            deadline: Unix time (s) to pass on to the evaluations, None for none.
            stopping: Rule that lets evaluations find out that they are hopeless (see `EvalRequest.stop`).

        Raises:
            ValueError: The deadline is not finite.
        """
        if deadline is not None and not math.isfinite(deadline):
            raise ValueError(f"deadline is {deadline}; give a Unix time in seconds, or None for no deadline")
        return [self._ask_one(deadline, stopping) for _ in range(n)]

    def _ask_one(self, deadline: float | None, stopping: MedianStopping | None) -> EvalRequest:
        trials = self.trials()
        thresholds = None
        if stopping is not None:
            curves = [t.result.curve for t in trials if t.result is not None and not t.failed]
            thresholds = stopping.thresholds(curves, self.maximize)
        for t in trials:
            evaluation = (t.trial, SEARCH)
            if t.result is None and evaluation not in self._dispatcher.held:
                return self._dispatcher.again(evaluation, t.params, t.seed, t.fidelity, deadline, thresholds)
        from codesign_bo.next_trial import next_proposal  # see `codesign_bo.view`

        trial = len(trials)
        proposal = next_proposal(self, trials, self._feasible)
        return self._dispatcher.propose(trial, proposal, derive_seed(self.seed, trial), deadline, thresholds)

    def tell(self, trial: int, result: EvalResult, token: str | None = None) -> Told:
        """Commit the result of a trial. Telling the same again does nothing.

        Args:
            trial: The trial.
            result: Its outcome; numbers that are not finite make it `diverged`.
            token: `EvalRequest.token`, which tells attempts apart; by default that of the latest.

        Returns:
            Whether the result counted, is worth another attempt, is a repetition, or came late, after
            another attempt had finished the trial (see `codesign_bo.records.Told`).

        Raises:
            StudyError: There is no such trial or token, or it already has another result.
            ValueError: The result lacks a further objective of the study.
        """
        return self._dispatcher.tell((trial, SEARCH), result, token)

    def give_up(self, trial: int, token: str, message: str = "given up") -> Told:
        """Commit that an attempt counts as `lost`; should its result come late, it can still be told.

        Returns:
            `"retry"` if the trial comes back with the next ask, `"counted"` if it has been lost too often.

        Raises:
            StudyError: There is no such trial or token, or the attempt has a result.
        """
        return self._dispatcher.give_up((trial, SEARCH), token, message)

    def finished(self) -> int:
        """Return the number of finished trials, failed and stopped ones included."""
        return self._storage.finished()

    def retry_failed(self) -> int:
        """Make all failed trials and confirmation runs unfinished again; return how many there were.

        For failures whose cause lay outside the design and is repaired. They keep design and seed.
        """
        return self._storage.reopen_failed()

    # --- run and confirm ------------------------------------------------------------------------------

    def run(
        self,
        callback: Callback,
        until: int = 30,
        executor: Executor | None = None,
        progress: Callable[[TrialRecord], None] | bool | None = None,
        deadline: float | None = None,
        stopping: MedianStopping | None = None,
        patience: float | None = None,
    ) -> list[TrialRecord]:
        """Ask, evaluate and tell until `until` trials are finished.

        Give `executor=LocalExecutor(...)` where evaluations may hang, crash or take much memory: then each has
        a fresh process that can be limited and killed. Without one they run in this process.

        Interrupt it at any time: what is in flight is cancelled, left open, and comes first in the next run.

        Args:
            callback: Evaluates a design. What it raises is recorded as a `crash` of that trial. In this
                process, OSError and MemoryError are the machine's: they pass through and leave the trial open.
            until: Total number of finished trials, failed and earlier ones included.
            executor: Runs as many evaluations at once as it has slots (see `codesign_bo.executors`); without
                one they run in this process, one after the other.
            progress: Called with each trial as it finishes; or True: a live table in a terminal and plain
                lines elsewhere, None: the table in a terminal only, False: nothing.
            deadline: Unix time (s) to pass on to the evaluations; what is not finished then is cancelled and
                left open. Nothing else depends on the machine's clock.
            stopping: Rule that stops hopeless evaluations, if the callback asks for it; None for none.
            patience: Seconds from its submission after which an evaluation that was not heard of is given up
                as lost, for executors that set no limit of their own.

        Returns:
            The trial table.

        Raises:
            StudyError: More than half of the trials fail, at least 5; those are kept, see `retry_failed`.
            ExecutorError: The executor can run nothing any more; what was in flight stays open.
            TypeError: The callback returned something else than an `EvalResult`; its trial stays open.
        """
        called, show = listener(progress)
        work = Search(self, self._dispatcher, until, deadline, stopping, called)
        tally = Tally(self.finished(), until, self._best, sum(t.failed for t in self.trials()))
        coordinate(work, callback, executor, tally, show, patience, deadline)
        return self.trials()

    def confirm(
        self,
        callback: Callback,
        top_k: int = 2,
        repeats: int = 3,
        level: float = 0.95,
        progress: Callable[[ConfirmationRecord], None] | bool | None = None,
        executor: Executor | None = None,
        patience: float | None = None,
    ) -> Confirmation:
        """Evaluate the nominal design and the best others again, on fresh seeds that all share.

        The others are the `top_k` designs with the best posterior mean that differ from the nominal one.
        Runs are durable: a killed confirmation goes on, more repeats add to those done.

        Args:
            callback: Evaluates a design, as in `run`; its work folder is `confirm` in the trial's own.
            top_k: How many designs to confirm. Each costs `repeats` evaluations and widens the intervals.
            repeats: Fresh seeds per design.
            level: Confidence level of the intervals.
            progress: Called with each run as it finishes, or a flag as in `run`.
            executor: As in `run`.
            patience: As in `run`.

        Returns:
            Gains over the nominal design with intervals (see `codesign_bo.confirm.analyse`).

        Raises:
            StudyError: No trial has a score yet.
            ValueError: `top_k` or `repeats` is not positive.
        """
        if top_k < 1 or repeats < 1:
            raise ValueError(f"top_k is {top_k} and repeats is {repeats}; both must be >= 1")
        params = {t.trial: t.params for t in self.trials()}
        chosen = [NOMINAL_TRIAL]
        for estimate in self.ranking():
            if len(chosen) <= top_k and all(estimate.params != params[t] for t in chosen):
                chosen.append(estimate.trial)
        done = {(c.trial, c.repeat) for c in self.confirmations() if c.result is not None}
        planned = [(trial, repeat) for repeat in range(repeats) for trial in chosen]
        plan: dict[Evaluation, int] = {e: derive_seed(self.seed, e[1], 2) for e in planned if e not in done}
        called, show = listener(progress)
        work = ConfirmationRuns(self._dispatcher, plan, params, called)
        tally = Tally(len(planned) - len(plan), len(planned), lambda: "")
        coordinate(work, callback, executor, tally, show, patience)
        return self.confirmation(level)

    def _best(self) -> str:
        if not any(t.ok for t in self.trials()):
            return ""
        best = self.best()
        return f"best so far: trial {best.trial}, {best.mean:.4g} ± {best.std:.2g}"


def _name(predicate: Feasible) -> str:
    named = predicate if hasattr(predicate, "__qualname__") else type(predicate)
    return f"{named.__module__}:{named.__qualname__}"
