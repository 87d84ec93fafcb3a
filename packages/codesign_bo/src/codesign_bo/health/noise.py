"""Do standard errors tell the truth, and do repeated evaluations show it?"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from codesign_bo.health.check import Check
from codesign_bo.health.model import MIN_PREDICTED
from codesign_bo.interfaces import EvalResult
from codesign_bo.view import StudyView

_CHANCE = 0.01
_NOISE_FACTOR = 3.0
_NOISE_SHARE = 0.2  # of the spread of all scores: less may come from the prior of the noise alone


def standard_errors(view: StudyView) -> Check:
    """Are standard errors reported, and do they tell the truth?"""
    name = "standard errors"
    results = [t.result for t in view.trials() if t.ok and t.result is not None]
    if not results:
        return Check(name, "ok", "No trial has a score yet.")
    known = np.array([r.sem for r in results if r.sem is not None], dtype=float)
    missing = len(results) - len(known)
    if missing:
        return Check(
            name,
            "warning" if len(known) else "info",
            f"{missing} of {len(results)} scores have no standard error; "
            + ("those count as exact but for the learnt noise." if len(known) else "the noise is learnt instead."),
            "Report `sem` of every score, such as the standard deviation over episodes divided by √n.",
        )
    typical = float(np.median(known))
    said = f"far more than the reported standard errors say (±{typical:.2g} at the median)."
    way_out = (
        "They leave something out, such as the seed of the training; the surrogate allows for it, "
        "but compare designs by `confirm()` only."
    )
    spread = _excess(view)
    if spread is not None:
        return Check(name, "warning", f"Repeated evaluations of a design vary by ±{spread:.2g}, {said}", way_out)
    if len(results) < MIN_PREDICTED:
        return Check(name, "ok", "All scores have standard errors.")
    surrogate = view.surrogate()
    extra = surrogate.extra_noise
    if extra > max(_NOISE_FACTOR * typical, _NOISE_SHARE * surrogate.scale):
        return Check(name, "warning", f"Scores vary by ±{extra:.2g} from evaluation to evaluation, {said}", way_out)
    return Check(name, "ok", "Reported standard errors and the noise that is found agree.")


def _excess(view: StudyView) -> float | None:
    """Return the spread of repeated evaluations if it is far more than chance and their standard errors give."""
    groups = [results for results in _evaluations(view).values() if len(results) > 1]
    if not groups or any(not r.sem for results in groups for r in results):
        return None
    freedom = sum(len(results) - 1 for results in groups)
    scores = [np.array([r.mean for r in results]) for results in groups]
    squares = sum(float(np.sum((y - y.mean()) ** 2)) for y in scores)
    known = float(np.median([r.sem for results in groups for r in results if r.sem]))
    excess = squares > freedom * (_NOISE_FACTOR * known) ** 2 and stats.chi2.sf(squares / known**2, freedom) < _CHANCE
    return math.sqrt(squares / freedom) if excess else None


def _evaluations(view: StudyView) -> dict[tuple[object, ...], list[EvalResult]]:
    """Return all scores of each design, those of confirmation runs too."""
    trials = view.trials()
    told = [(t.params, t.result) for t in trials if t.ok]
    told += [(trials[c.trial].params, c.result) for c in view.confirmations()]
    found: dict[tuple[object, ...], list[EvalResult]] = {}
    for params, result in told:
        if result is not None and result.ok:
            found.setdefault(tuple(params.values()), []).append(result)
    return found


def repeats(view: StudyView) -> Check:
    """Has any design been evaluated on several seeds, and did that make a difference?"""
    name = "repeats"
    by_design = {design: [r.mean for r in results] for design, results in _evaluations(view).items()}
    repeated = [scores for scores in by_design.values() if len(scores) > 1]
    if not by_design:
        return Check(name, "ok", "No trial has a score yet.")
    if not repeated:
        return Check(
            name,
            "info",
            "No design has been evaluated on more than one seed.",
            "`confirm()` repeats the best and the nominal design on fresh seeds.",
        )
    same = [scores for scores in repeated if len(set(scores)) == 1]
    if len(same) == len(repeated):
        if all(r.sem == 0.0 for results in _evaluations(view).values() for r in results):
            return Check(name, "ok", "Repeated evaluations agree exactly, as their standard errors of 0 say.")
        return Check(
            name,
            "warning",
            "Evaluations of the same design on different seeds gave exactly the same score.",
            "Draw all randomness of the evaluation from `request.seed`; otherwise confirmation proves nothing.",
        )
    return Check(name, "ok", f"{len(repeated)} designs have been evaluated on more than one seed.")
