"""What a study is told beside the results of its own trials: designs to try, cheap scores, past studies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from codesign_bo.errors import StudyError
from codesign_bo.history import Imported, translate
from codesign_bo.records import ScreeningRecord
from codesign_bo.space import BoxSpace, Feasible, Value
from codesign_bo.storage import Storage
from codesign_bo.view import StudyView, open_study


class Suggestions(StudyView):
    """The part of a `Study` that takes suggestions.

    Args:
        storage: An open storage with a header.
        feasible: Predicate over designs (n, d) in natural units; only feasible ones are queued.
    """

    def __init__(self, storage: Storage, feasible: Feasible | None) -> None:
        super().__init__(storage)
        self._feasible = feasible

    def enqueue(self, points: Sequence[Mapping[str, Value]]) -> None:
        """Queue designs to be tried before any further proposal of the study.

        A design that ever was in the queue is left out, so a resumed script may queue the same again.

        Raises:
            ValueError: A design is incomplete, out of bounds or infeasible; then none is queued.
        """
        checked = [self.space.check(p) for p in points]
        check_feasible(self.space, checked, self._feasible)
        self._storage.enqueue(checked)

    def add_screening(
        self,
        points: Sequence[Mapping[str, Value]],
        values: Sequence[float],
        sems: Sequence[float | None] | None = None,
    ) -> None:
        """Store cheap scores of designs, at fidelity 0. They help to choose what to try (`enqueue_screened`).

        Args:
            points: n designs; the newest score of a design counts.
            values: Their n scores, in the direction of the objective.
            sems: Their n standard errors, None where unknown.

        Raises:
            ValueError: A design is invalid, a score is not finite, or their numbers differ.
        """
        if len(points) != len(values):
            raise ValueError(f"{len(points)} designs, but {len(values)} screening scores")
        if not all(math.isfinite(v) for v in values):
            raise ValueError("screening scores must be finite; leave failed designs out")
        known = [None] * len(points) if sems is None else sems
        if len(known) != len(points):
            raise ValueError(f"{len(points)} designs, but {len(known)} standard errors")
        rows = zip(points, values, known, strict=True)
        self._storage.add_screening([ScreeningRecord(self.space.check(p), float(v), sem) for p, v, sem in rows])

    def enqueue_screened(self, n: int, separation: float = 0.1) -> list[dict[str, Value]]:
        """Queue the n best screened designs that are not close to one another or to the nominal one.

        Args:
            n: How many at most.
            separation: Least distance: the largest difference of any feature (see `BoxSpace.features`), which is
                a share of the range for a number, and 0.7 for two choices of a categorical parameter.

        Returns:
            The queued designs, the best first.
        """
        sign = -1.0 if self.maximize else 1.0
        records = sorted(self.screening(), key=lambda r: sign * r.value)
        designs = self.space.designs([self.space.nominal, *(r.params for r in records)])
        nominal, *points = self.space.features(self.space.to_unit(designs))
        kept = [nominal]
        chosen: list[dict[str, Value]] = []
        for record, point in zip(records, points, strict=True):
            if len(chosen) == n:
                break
            if np.abs(np.array(kept) - point).max(axis=1).min() >= separation:
                kept.append(point)
                chosen.append(dict(record.params))
        self.enqueue(chosen)
        return chosen

    def add_history(self, other: StudyView | Path | str) -> Imported:
        """Let the surrogate learn from the finished trials of another study, which count for no trial here.

        Parameters are matched by name (see `codesign_bo.history.translate`). The results become part of
        this study's own file, so that the same file still gives the same next design, and adding the same
        study again only adds what is new. They count towards `n_init`, and are never recommended. The
        surrogate takes them at face value: a bias between the studies is not modelled, so import only what
        was measured in the same way.

        Args:
            other: The other study, or its file.

        Raises:
            StudyError: It is this study, has the opposite direction or no parameter in common, or none of
                its trials has a place in this study's space.
        """
        if not isinstance(other, StudyView):
            with open_study(other) as view:
                return self.add_history(view)
        if other.identity == self.identity:
            raise StudyError(f"{other.path} is this very study; its trials are known already")
        records, left_out = translate(self.space, self.maximize, other)
        if left_out and not records:
            trial, reason = next(iter(left_out.items()))
            raise StudyError(f"no trial of {other.path} has a place in this study; trial {trial}: {reason}")
        return Imported(self._storage.add_history(records), left_out)


def check_feasible(space: BoxSpace, points: Sequence[Mapping[str, Value]], feasible: Feasible | None) -> None:
    """Refuse infeasible designs.

    Raises:
        ValueError: Some are infeasible.
    """
    if feasible is None or not points:
        return
    mask = feasible(space.designs(points))
    bad = [dict(p) for p, good in zip(points, mask, strict=True) if not good]
    if bad:
        raise ValueError(f"infeasible by the study's own predicate: {bad}")
