"""Does the surrogate know anything, and does it know how well?"""

from __future__ import annotations

from collections.abc import Sequence

from scipy import stats

from codesign_bo.health.check import Check, listed
from codesign_bo.sensitivity import Effect, any_effect, sensitivity
from codesign_bo.view import StudyView

MIN_PREDICTED = 8
"""Scores below which predictions are not judged."""

_LOW_R2 = 0.1
_CHANCE = 0.01


def parameter_effects(view: StudyView, effects: Sequence[Effect] | None = None) -> Check:
    """Do the parameters have effects that the data can tell from noise?"""
    name = "parameter effects"
    scores = len(view.observations().y)
    if scores < max(3, view.space.dim + 1):
        return Check(name, "info", f"Too few scores ({scores}) to tell the effects of {view.space.dim} parameters.")
    effects = sensitivity(view) if effects is None else effects
    unknown = [e.name for e in effects if not e.identifiable]
    if not unknown:
        return Check(name, "ok", "The data tell the effect of every parameter from noise.")
    if len(unknown) < len(effects):
        return Check(
            name,
            "info",
            f"The data cannot tell whether {listed(unknown)} {'matters' if len(unknown) == 1 else 'matter'}.",
            "Take the recommended values of these with a grain of salt; more trials, or fixing them at nominal "
            "(`space.fix`) in a new study, decides.",
        )
    if any_effect(view):
        return Check(
            name,
            "info",
            "The parameters matter together, but the data cannot tell the effect of any one of them.",
            "Evaluate more designs before reading anything into single parameters.",
        )
    return Check(
        name,
        "warning",
        "No parameter has an effect that the data can tell from noise.",
        "Average over more samples per evaluation, evaluate more designs, or widen the space.",
    )


def predictability(view: StudyView) -> Check:
    """Does the surrogate predict scores it has not seen, and does it know how well?"""
    name = "predictability"
    scores = len(view.observations().y)
    if scores < MIN_PREDICTED:
        return Check(name, "info", f"Too few scores ({scores}) to judge predictions; {MIN_PREDICTED} are enough.")
    left = view.leave_one_out()
    n = len(left.y)
    inside = round(left.coverage * n)
    found = f"leave-one-out r² is {left.r2:.2f}, and {inside} of {n} scores lie in their 95 % interval"
    if stats.binom.cdf(inside, n, 0.95) < _CHANCE:
        return Check(
            name,
            "warning",
            f"The surrogate is too sure of itself: {found}.",
            "Trust confirmation runs more than its intervals; look for outliers and jumps in the calibration figure.",
        )
    if left.r2 < _LOW_R2:
        return Check(
            name,
            "warning",
            f"The surrogate predicts hardly better than the mean of all scores: {found}.",
            "The search is close to random so far: reduce noise, evaluate more designs, or drop parameters.",
        )
    return Check(name, "ok", f"The surrogate predicts scores it has not seen: {found}.")
