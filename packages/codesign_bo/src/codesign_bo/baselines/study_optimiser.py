"""A study of this package as an optimiser, so that it runs in the same loop as the others."""

from __future__ import annotations

import math
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path

from codesign_bo.baselines.base import check_score
from codesign_bo.baselines.interfaces import Params
from codesign_bo.interfaces import EvalResult
from codesign_bo.space import BoxSpace, Value
from codesign_bo.study import Study


class StudyOptimiser:
    """`codesign_bo.Study` with its defaults, in a temporary file that goes when the optimiser does.

    Failures are `infeasible`. It recommends what `Study.best` does.
    """

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        folder = tempfile.TemporaryDirectory(prefix="codesign-bo-")
        try:
            self._study = Study(space, Path(folder.name) / "study.sqlite", seed, maximize)
        except BaseException:
            folder.cleanup()
            raise
        weakref.finalize(self, _remove, self._study, folder)
        self._out: dict[tuple[Value, ...], list[int]] = {}

    def ask(self) -> Params:
        """Return the next design to evaluate (see `Optimiser.ask`)."""
        (request,) = self._study.ask()
        params: Params = {**request.params}
        self._out.setdefault(tuple(params.values()), []).append(request.trial)
        return params

    def tell(self, params: Mapping[str, Value], mean: float, sem: float | None = None) -> None:
        """Take the score of a design (see `Optimiser.tell`)."""
        check_score(mean, sem)
        trials = self._out.get(tuple(params[name] for name in self._study.space.names))
        if not trials:
            raise ValueError(f"design {dict(params)} is not out: it was not asked for, or is told already")
        failure = EvalResult.failure("infeasible", "the evaluation has no score")
        self._study.tell(trials.pop(0), failure if math.isnan(mean) else EvalResult(mean, sem))

    def recommend(self) -> Params:
        """Return the evaluated design with the best posterior mean (see `Optimiser.recommend`)."""
        if not any(trial.ok for trial in self._study.trials()):
            raise LookupError("nothing to recommend: no design has a score yet")
        return {**self._study.best().params}


def _remove(study: Study, folder: tempfile.TemporaryDirectory[str]) -> None:
    study.close()
    folder.cleanup()
