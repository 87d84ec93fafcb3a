"""The surrogates of a study, fitted once for each state of its data."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codesign_bo.data import Observations
from codesign_bo.models.fidelity import Verdict, fit_with_scores
from codesign_bo.models.surrogate import Surrogate
from codesign_bo.records import ScoreRecord
from codesign_bo.seeds import derive_seed
from codesign_bo.space import BoxSpace


@dataclass(frozen=True)
class Fit:
    """A surrogate, and what it was fitted to.

    Attributes:
        data: Scores in full.
        scores: Scores at lower fidelities.
        surrogate: The surrogate.
        verdicts: Whether each lower fidelity helps (see `codesign_bo.models.fidelity`).
        seconds: How long the fit took.
    """

    data: Observations
    scores: Sequence[ScoreRecord]
    surrogate: Surrogate
    verdicts: Sequence[Verdict]
    seconds: float


class Fits:
    """Keeps the newest fit of each objective.

    Args:
        space: The space.
        seed: Seed of the study; the same data then gives the same fit.
    """

    def __init__(self, space: BoxSpace, seed: int) -> None:
        self._space, self._seed = space, derive_seed(seed, 0, 3)
        self._newest: dict[str | None, Fit] = {}

    @property
    def seconds(self) -> float:
        """How long the newest fits took together."""
        return sum(fit.seconds for fit in self._newest.values())

    def of(self, objective: str | None, data: Observations, scores: Sequence[ScoreRecord]) -> Fit:
        """Return the fit of an objective (None: the main one) to these data, made anew only if they changed."""
        found = self._newest.get(objective)
        if found is None or not _same(found.data, data) or found.scores != scores:
            started = time.monotonic()
            surrogate, verdicts = fit_with_scores(data.x, data.y, data.sem, self._seed, self._space, scores)
            found = self._newest[objective] = Fit(data, scores, surrogate, verdicts, time.monotonic() - started)
        return found


def _same(a: Observations, b: Observations) -> bool:
    return all(np.array_equal(getattr(a, k), getattr(b, k), equal_nan=True) for k in ("x", "y", "sem"))
