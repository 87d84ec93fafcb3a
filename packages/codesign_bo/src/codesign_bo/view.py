"""What a study has found so far, without changing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from codesign_bo.confirm import Confirmation, analyse
from codesign_bo.errors import StudyError
from codesign_bo.interfaces import EvalResult
from codesign_bo.proposal import derive_seed
from codesign_bo.records import ConfirmationRecord, QueuedRecord, ScreeningRecord, TrialRecord
from codesign_bo.space import Array, BoxSpace
from codesign_bo.storage import Storage
from codesign_bo.surrogate import LeaveOneOut, Surrogate, fit_surrogate, leave_one_out, slices


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
    params: Mapping[str, float]
    mean: float
    std: float
    result: EvalResult


@dataclass(frozen=True)
class Slice:
    """The posterior along one parameter, the others held at the best design.

    Attributes:
        values: Values (n,) of the parameter, from its lower to its upper bound.
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
        self._fitted: tuple[list[TrialRecord], Surrogate] | None = None
        self.path = storage.path
        self.space = BoxSpace.from_signature(header.space)
        self.seed = header.seed
        self.n_init = header.n_init
        self.maximize = header.maximize

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; a writer frees its lock."""
        self._storage.close()

    def trials(self) -> list[TrialRecord]:
        """Return the trial table, by number."""
        return self._storage.trials()

    def queue(self) -> list[QueuedRecord]:
        """Return the user's queue, first come first."""
        return self._storage.queue()

    def screening(self) -> list[ScreeningRecord]:
        """Return the screening table."""
        return self._storage.screening()

    def confirmations(self) -> list[ConfirmationRecord]:
        """Return the confirmation runs, by trial and repeat."""
        return self._storage.confirmations()

    def confirmation(self, level: float = 0.95) -> Confirmation:
        """Return what the confirmation runs so far say (see `codesign_bo.confirm.analyse`)."""
        params = {t.trial: t.params for t in self.trials()}
        return analyse(self.confirmations(), params, self.maximize, level)

    def surrogate(self) -> Surrogate:
        """Return the surrogate of all trials that have a score.

        Raises:
            StudyError: There is none yet.
        """
        scored = [t for t in self.trials() if t.ok]
        if not scored:
            raise StudyError(f"no trial of {self.path} has a score yet")
        if self._fitted is None or self._fitted[0] != scored:
            results = [t.result for t in scored if t.result is not None]
            surrogate = fit_surrogate(
                self.space.to_unit(self.space.designs(t.params for t in scored)),
                np.array([r.mean for r in results]),
                np.array([np.nan if r.sem is None else r.sem for r in results]),
                derive_seed(self.seed, 0, 3),
            )
            self._fitted = (scored, surrogate)
        return self._fitted[1]

    def ranking(self) -> list[Estimate]:
        """Return all designs with a score, the best posterior mean first.

        Raises:
            StudyError: There is none yet.
        """
        surrogate = self.surrogate()
        mean, std = surrogate.predict(surrogate.x)
        estimates = [
            Estimate(t.trial, t.params, float(m), float(s), t.result)
            for t, m, s in zip([t for t in self.trials() if t.ok], mean, std, strict=True)
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

    def slices(self, n: int = 41) -> dict[str, Slice]:
        """Return the posterior on lines through the best design, by free parameter.

        Args:
            n: Number of points on each line.
        """
        best = self.space.to_unit(self.space.designs([self.best().params]))[0]
        positions, mean, std = slices(self.surrogate(), best, n)
        free = [p for p in self.space.parameters if not p.fixed]
        return {p.name: Slice(p.low + positions * (p.high - p.low), mean[i], std[i]) for i, p in enumerate(free)}

    def leave_one_out(self) -> LeaveOneOut:
        """Return how well the surrogate predicts each trial from the others."""
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
