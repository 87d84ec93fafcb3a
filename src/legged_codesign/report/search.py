"""What the search found: codesign_bo's pictures and health checks, and what each body gives and costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import codesign_bo
import numpy as np
from codesign_bo import StudyError, StudyView
from codesign_bo.acquisition.pareto import non_dominated
from codesign_bo.health import Check, health
from codesign_bo.plots import PICTURES, Labels, NothingToShowError
from codesign_bo.plots.pareto import Front
from codesign_bo.plots.sensitivity import Importance
from codesign_bo.plots.style import headline
from codesign_bo.records import TrialRecord
from codesign_bo.sensitivity import sensitivity
from locorl.interfaces import Array
from matplotlib.axes import Axes

from legged_codesign.config import Objective
from legged_codesign.report.page import Picture

_OBJECTIVE = {
    "return": "return",
    "energy": "negated energy in J",
    "cost-of-transport": "negated cost of transport",
}

GAIN_AND_COST = ("return", "energy")
"""What the front weighs against each other, by the names of a trial's extras; more of the first is better."""


@dataclass(frozen=True)
class Search:
    """A study in pictures and words.

    Attributes:
        pictures: by the names of `codesign_bo.plots.PICTURES`.
        checks: health checks, the most severe first.
    """

    pictures: Mapping[str, Picture]
    checks: Sequence[Check]


def search(study: Path, objective: Objective) -> Search:
    """Draw a study; a picture that it has no data for is replaced by the reason.

    Args:
        study: the file; it may be missing.
        objective: what its scores are.
    """
    if not study.is_file():
        return Search(dict.fromkeys(PICTURES, Picture("", "the search has not begun")), ())
    labels = Labels(_OBJECTIVE[objective], {"energy": "J"})
    with codesign_bo.open_study(study) as view:
        try:
            effects = sensitivity(view)
        except StudyError:
            effects = None
        pictures: dict[str, Picture] = {}
        for name, take in PICTURES.items():
            try:
                known = name == "sensitivity" and effects is not None
                picture = Importance.sorted(effects) if known and effects else take(view)
            except NothingToShowError as reason:
                pictures[name] = Picture("", str(reason))
                continue
            made = picture.figure(labels)
            if name == "convergence":
                _fit_to_scores(made.axes[0], _scores(view))
            pictures[name] = Picture.of(made, picture.sentence(labels))
        if not view.objectives:
            pictures["pareto"] = front(view.trials())
        return Search(pictures, health(view, effects))


def front(trials: Sequence[TrialRecord]) -> Picture:
    """Return against energy of every body on which all robots came through, and those that no other beats in both.

    A robot that falls early spends little: bodies that fell would pass for frugal ones.
    """
    gain, cost = GAIN_AND_COST
    kept = [
        (t.trial, t.result.extras[gain], t.result.extras[cost])
        for t in trials
        if t.ok and t.result is not None and {gain, cost} <= set(t.result.extras)
        if all(t.result.extras.get(name, t.result.n) == t.result.n for name in ("survived", "succeeded"))
    ]
    if not kept:
        return Picture("", "no front: on no body did all robots come through")
    values = np.array([row[1:] for row in kept], dtype=float)
    drawn = Front(
        names=("", cost),
        maximize=(True, False),
        trials=np.array([row[0] for row in kept]),
        values=values,
        errors=np.full_like(values, np.nan),
        efficient=non_dominated(values * (1.0, -1.0)),
    )
    labels = Labels(gain, {cost: "J"})
    made = drawn.figure(labels)
    headline(made, "Numbers: trials on the front")
    failed = sum(t.ok for t in trials) - len(kept)
    left_out = f" Left out: {failed} on which a robot fell or got stuck." if failed else ""
    return Picture.of(made, drawn.sentence(labels) + left_out)


def _scores(view: StudyView) -> Array:
    return np.array([t.result.mean for t in view.trials() if t.ok and t.result is not None])


def _fit_to_scores(ax: Axes, values: Array) -> None:
    """Let the scores fill the picture: not the first wide band, nor a body that cannot walk, capped far off."""
    ordinary = values[np.abs(values) < 3 * np.median(np.abs(values))] if len(values) else values
    if len(ordinary) > 1 and np.ptp(ordinary) > 0:
        margin = 0.25 * np.ptp(ordinary)
        ax.set_ylim(ordinary.min() - margin, ordinary.max() + margin)
