"""What a study has found so far, without changing it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from codesign_bo.confirm import Confirmation, analyse
from codesign_bo.data import Observations, Viability, figure, tells_viability
from codesign_bo.errors import StudyError
from codesign_bo.interfaces import EvalResult
from codesign_bo.records import (
    AttemptRecord,
    ConfirmationRecord,
    HistoryRecord,
    QueuedRecord,
    ScoreRecord,
    ScreeningRecord,
    TrialRecord,
)
from codesign_bo.space import Array, BoxSpace, Value
from codesign_bo.stopping import Savings
from codesign_bo.storage import Storage

# Models are imported where they are used: torch takes seconds and 300 MB, and a script that opens a study is imported
# again by the process of each of its evaluations.
if TYPE_CHECKING:
    from codesign_bo.acquisition.pareto import ParetoFront
    from codesign_bo.acquisition.proposal import Belief
    from codesign_bo.fits import Fit, Fits
    from codesign_bo.models.fidelity import Verdict
    from codesign_bo.models.surrogate import LeaveOneOut, Surrogate
    from codesign_bo.models.viability import ViabilityModel
    from codesign_bo.recommend import Recommendation


@dataclass(frozen=True)
class Estimate:
    """What the surrogate believes about an evaluated design.

    Attributes:
        trial: Its trial.
        params: The design.
        mean: Posterior mean of the objective there.
        std: Posterior standard deviation of the objective there.
        result: What was measured.
    """

    trial: int
    params: Mapping[str, Value]
    mean: float
    std: float
    result: EvalResult


@dataclass(frozen=True)
class Slice:
    """The posterior along one parameter, the others held at the best design.

    Attributes:
        values: Values (n,) of the parameter, from its lower to its upper bound; of a categorical one, the
            index of its choice.
        mean: Posterior mean (n,) of the objective.
        std: Posterior standard deviation (n,).
    """

    values: Array
    mean: Array
    std: Array


class StudyView:
    """Reads a study; `open_study` makes one for a file that another process may be writing.

    Args:
        storage: An open storage with a header.
    """

    def __init__(self, storage: Storage) -> None:
        header = storage.header()
        if header is None:
            raise StudyError(f"{storage.path} holds no study yet: it was interrupted while being created")
        self._storage = storage
        self._fits: Fits | None = None
        self.path = storage.path
        self.space = BoxSpace.from_signature(header.space)
        self.seed = header.seed
        self.n_init = header.n_init
        self.maximize = header.maximize
        self.objectives = dict(header.objectives)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; a writer frees its lock."""
        self._storage.close()

    # --- tables ---------------------------------------------------------------------------------------

    @property
    def identity(self) -> str:
        """What tells this study from all others; copies of it share it."""
        return self._storage.identity

    @property
    def predicate(self) -> str | None:
        """Name of the feasibility predicate that the study was last opened with, or None."""
        return self._storage.predicate()

    def trials(self) -> list[TrialRecord]:
        """Return the trial table, by number."""
        return self._storage.trials()

    def attempts(self) -> list[AttemptRecord]:
        """Return every dispatch of every evaluation, with what was told of it, counted or not."""
        return self._storage.attempts()

    def queue(self) -> list[QueuedRecord]:
        """Return the user's queue, first come first."""
        return self._storage.queue()

    def screening(self) -> list[ScreeningRecord]:
        """Return the screening table."""
        return self._storage.screening()

    def history(self) -> list[HistoryRecord]:
        """Return what was imported from other studies, in the order it came."""
        return self._storage.history()

    def confirmations(self) -> list[ConfirmationRecord]:
        """Return the confirmation runs, by trial and repeat."""
        return self._storage.confirmations()

    def confirmation(self, level: float = 0.95) -> Confirmation:
        """Return what the confirmation runs so far say (see `codesign_bo.confirm.analyse`)."""
        params = {t.trial: t.params for t in self.trials()}
        return analyse(self.confirmations(), params, self.maximize, level)

    # --- data for models ------------------------------------------------------------------------------

    def observations(self, objective: str | None = None) -> Observations:
        """Return all scores in full, imported ones included.

        Args:
            objective: A further objective of the study by name; None for the main one. Imported results
                that lack it are left out.

        Raises:
            ValueError: The study has no such objective.
        """
        if objective is not None and objective not in self.objectives:
            raise ValueError(f"{self.path} has no objective {objective!r}; it has {list(self.objectives)}")
        own = [(t.trial, t.params, t.result) for t in self.trials() if t.ok and t.result is not None]
        imported = [
            (h.trial, h.params, h.result)
            for h in self.history()
            if h.result.ok and (objective is None or objective in h.result.extras)
        ]
        rows = own + imported
        figures = np.array([figure(result, objective) for _, _, result in rows]).reshape(-1, 2)
        return Observations(
            self._unit(params for _, params, _ in rows),
            figures[:, 0],
            figures[:, 1],
            np.arange(len(rows)) >= len(own),
            np.array([trial for trial, _, _ in rows], dtype=np.int64),
        )

    def viability(self) -> Viability:
        """Return which designs could be evaluated at all, imported ones included."""
        rows = [(t.params, t.result) for t in self.trials() if t.result is not None]
        rows += [(h.params, h.result) for h in self.history()]
        rows = [(params, result) for params, result in rows if tells_viability(result)]
        return Viability(
            self._unit(params for params, _ in rows), np.array([not r.failed for _, r in rows], dtype=bool)
        )

    def scores(self) -> list[ScoreRecord]:
        """Return all scores at lower fidelities: screening, and what came up on the way of each trial."""
        screened = [ScoreRecord(s.params, 0.0, s.value, s.sem, None) for s in self.screening()]
        return screened + [
            ScoreRecord(t.params, score.fidelity, score.mean, score.sem, t.trial)
            for t in self.trials()
            if t.result is not None
            for score in t.result.scores
        ]

    def savings(self) -> Savings:
        """Return what stopping hopeless evaluations saved."""
        results = [t.result for t in self.trials() if t.result is not None]
        stopped = [r for r in results if r.status == "stopped"]
        saved = sum(1.0 - r.scores[-1].fidelity for r in stopped)
        return Savings(len(stopped), sum(not r.failed for r in results), saved)

    def _unit(self, params: Iterable[Mapping[str, Value]]) -> Array:
        return self.space.to_unit(self.space.designs(params))

    # --- what the surrogate says ----------------------------------------------------------------------

    def surrogate(self, objective: str | None = None) -> Surrogate:
        """Return the surrogate of all scores in full, imported ones included.

        That of the main objective also learns from scores at lower fidelities, if `fidelity_verdicts` favours it.

        Args:
            objective: A further objective of the study by name; None for the main one.

        Raises:
            StudyError: There is no score yet.
            ValueError: The study has no such objective.
        """
        return self._fit(objective).surrogate

    def fidelity_verdicts(self) -> list[Verdict]:
        """Return whether scores at lower fidelities help to predict the objective (see `codesign_bo.models.fidelity`).

        Raises:
            StudyError: There is no score yet.
        """
        return list(self._fit(None).verdicts)

    def viability_model(self) -> ViabilityModel | None:
        """Return a model of the probability that a design can be evaluated; None as long as none has failed."""
        from codesign_bo.models.viability import fit_viability

        return fit_viability(self.space, self.viability())

    def belief(self) -> Belief:
        """Return what the next proposal is based on.

        Raises:
            StudyError: There is no score yet.
        """
        from codesign_bo.acquisition.functions import Objective
        from codesign_bo.acquisition.proposal import Belief

        main = Objective(self.surrogate(), self.maximize)
        further = [Objective(self.surrogate(name), way == "maximize") for name, way in self.objectives.items()]
        return Belief((main, *further), self.viability_model())

    def fit_seconds(self) -> float:
        """Return how long it took to fit the present surrogates."""
        return 0.0 if self._fits is None else self._fits.seconds

    def pareto(self) -> ParetoFront:
        """Return the study's own designs that no other beats in all objectives, by posterior means.

        Raises:
            StudyError: No trial has a score yet.
        """
        from codesign_bo.acquisition.pareto import pareto_front

        scored = [t for t in self.trials() if t.ok]
        names = [None, *self.objectives]
        predictions = [self.surrogate(name).predict(self._unit(t.params for t in scored)) for name in names]
        mean, std = (np.column_stack(columns) for columns in zip(*predictions, strict=True))
        ways = [self.maximize, *(way == "maximize" for way in self.objectives.values())]
        return pareto_front(["mean", *self.objectives], [t.trial for t in scored], mean, std, ways)

    def _fit(self, objective: str | None) -> Fit:
        data = self.observations(objective)
        if not len(data.y):
            raise StudyError(f"no trial of {self.path} has a score yet")
        if self._fits is None:
            from codesign_bo.fits import Fits

            self._fits = Fits(self.space, self.seed)
        return self._fits.of(objective, data, self.scores() if objective is None else [])

    def ranking(self) -> list[Estimate]:
        """Return the study's own designs that have a score in full, the best posterior mean first.

        Raises:
            StudyError: There is none yet.
        """
        scored = [t for t in self.trials() if t.ok]
        if not scored:
            raise StudyError(f"no trial of {self.path} has a score yet")
        mean, std = self.surrogate().predict(self._unit(t.params for t in scored))
        estimates = [
            Estimate(t.trial, t.params, float(m), float(s), t.result)
            for t, m, s in zip(scored, mean, std, strict=True)
            if t.result is not None
        ]
        sign = -1.0 if self.maximize else 1.0
        return sorted(estimates, key=lambda e: (sign * e.mean, e.trial))

    def best(self) -> Estimate:
        """Return the evaluated design with the best posterior mean (not the luckiest observation).

        Raises:
            StudyError: No trial has a score yet.
        """
        return self.ranking()[0]

    def recommend(self, level: float = 0.95) -> Recommendation:
        """Return the design to take, and its gain over the nominal one.

        Once designs are confirmed, on at least 2 seeds, the confirmation runs decide; before, the surrogate does.

        Args:
            level: Level of the interval of the gain.

        Raises:
            StudyError: No trial has a score yet.
        """
        from codesign_bo.recommend import by_confirmation, by_posterior

        confirmed = self.confirmation(level).best
        if confirmed is not None and confirmed.repeats > 1:
            return by_confirmation(confirmed, self.space.nominal, level)
        estimate = self.best()
        points = self._unit([estimate.params, self.space.nominal])
        return by_posterior(estimate, self.space.nominal, self.surrogate(), points, self.maximize, level)

    def slices(self, n: int = 41) -> dict[str, Slice]:
        """Return the posterior on lines through the best design, by free parameter.

        Args:
            n: Number of points on each line, spread evenly over the edge of the unit cube.
        """
        from codesign_bo.models.surrogate import slices

        best = self._unit([self.best().params])[0]
        positions, mean, std = slices(self.surrogate(), best, n)
        return {p.name: Slice(p.from_unit(positions), mean[i], std[i]) for i, p in enumerate(self.space.free)}

    def leave_one_out(self) -> LeaveOneOut:
        """Return how well the surrogate predicts each trial from the others."""
        from codesign_bo.models.surrogate import leave_one_out

        return leave_one_out(self.surrogate())


def open_study(path: Path | str) -> StudyView:
    """Open a study for reading, also while another process runs it.

    Raises:
        StudyError: There is no readable study at `path`.
    """
    storage = Storage(Path(path), read_only=True)
    try:
        return StudyView(storage)
    except BaseException:
        storage.close()
        raise
