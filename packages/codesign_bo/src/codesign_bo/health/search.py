"""Can the search go on, does it fail, and has it found anything?"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence

from codesign_bo.confirm import NOMINAL_TRIAL
from codesign_bo.errors import StudyError
from codesign_bo.failures import failure_cluster
from codesign_bo.health.check import Check, listed
from codesign_bo.recommend import posterior_gain
from codesign_bo.space import Array, Categorical, Continuous, Value, sobol_points
from codesign_bo.view import StudyView

_MANY_FAILURES, _SOME_FAILURES = 0.5, 0.2
_EDGE = 0.01


def candidates(view: StudyView) -> Check:
    """Can candidates be generated?"""
    name = "candidates"
    try:
        sobol_points(view.space, 1, view.seed % 2**31)
    except StudyError as error:
        return Check(name, "error", f"No further design can be proposed: {error}.", "Widen the space in a new study.")
    if all(not isinstance(p, Continuous) for p in view.space.free):
        count = math.prod(p.count for p in view.space.free if not isinstance(p, Continuous))
        tried = len({tuple(t.params.values()) for t in view.trials()})
        if tried >= count:
            return Check(
                name,
                "info",
                f"All {count} designs of the space have been tried; further trials repeat them on other seeds.",
                "Stop here and confirm the best ones, or widen the space in a new study.",
            )
    guesses = [t.trial for t in view.trials() if t.basis is not None and t.basis.fit == "prior"]
    if guesses:
        return Check(
            name,
            "warning",
            f"The surrogate could not be fitted for trials {_numbers(guesses)}; they were chosen by its prior.",
            "Look for scores that differ by many orders of magnitude, and score on a logarithmic scale if there are.",
        )
    return Check(name, "ok", "Candidates can be generated.")


def failures(view: StudyView) -> Check:
    """How many trials fail, of what, and where?"""
    name = "failures"
    finished = [t for t in view.trials() if t.result is not None]
    failed = [t for t in finished if t.failed]
    if not finished:
        return Check(name, "ok", "No trial has finished yet.")
    if not failed:
        return Check(name, "ok", f"None of {len(finished)} trials failed.")
    kinds = Counter(t.status for t in failed)
    share = len(failed) / len(finished)
    words = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    sentence = f"{len(failed)} of {len(finished)} trials failed ({share:.0%}: {words})."
    cluster = failure_cluster(view)
    if cluster is not None:
        sentence += f" The {cluster.sentence()}."
    severity = "error" if share > _MANY_FAILURES else "warning" if share > _SOME_FAILURES or cluster else "info"
    ways = [_FAILURE_WAYS[kind] for kind, _ in kinds.most_common() if kind in _FAILURE_WAYS]
    if cluster is not None:
        ways.insert(0, "rule that part out with bounds, a linear constraint or a `feasible` predicate in a new study")
    ways.append("repaired the cause? `codesign-bo resume --retry-failed` tries them again")
    return Check(name, severity, sentence, _sentence("; ".join(ways)))


_FAILURE_WAYS = {
    "crash": "read the message and `stderr.txt` in the trial's folder",
    "timeout": "raise the executor's `timeout`, or make evaluations cheaper",
    "lost": "look at the machines: these evaluations vanished, which says nothing about their designs",
    "diverged": "guard the training against numbers that are not finite (smaller steps, clipped gradients)",
}


def improvement(view: StudyView) -> Check:
    """Is any design better than the nominal one, or at least different?"""
    name = "improvement over nominal"
    trials = view.trials()
    scored = [t for t in trials if t.ok]
    if not scored:
        return Check(name, "info", "No trial has a score yet, so there is no best design.")
    if not trials[0].ok:
        state = "has no score" if trials[0].result is None else f"failed ({trials[0].status})"
        return Check(
            name,
            "warning",
            f"The nominal design {state}, so gains over it are the surrogate's guess.",
            "Evaluate it (`retry_failed`), or choose a nominal design that can be evaluated in a new study.",
        )
    if len(scored) < 2:
        return Check(name, "info", "Only one design has a score, so there is nothing to compare.")
    found = view.recommend()
    if found.trial != NOMINAL_TRIAL and found.low > 0.0:
        gain = (
            f"Trial {found.trial} is better than the nominal design: gain {found.gain:.4g} "
            f"[{found.low:.4g}, {found.high:.4g}] at {found.level:.0%}, by {found.source}."
        )
        if found.source == "confirmation":
            return Check(name, "ok", gain)
        return Check(name, "info", gain + " It has not been measured on fresh seeds.", "Run `confirm()`.")
    more = "Evaluate more designs, widen the space, or average over more samples per evaluation."
    if found.source == "confirmation":
        return Check(name, "warning", "No confirmed design is better than the nominal one beyond noise.", more)
    if not _any_differs(view, found.level):
        return Check(name, "warning", "No design differs from the nominal beyond noise.", more)
    if found.trial == NOMINAL_TRIAL:
        return Check(name, "warning", "No design is expected to be better than the nominal one.", more)
    return Check(
        name,
        "warning",
        f"No design is better than the nominal one beyond noise: the best, trial {found.trial}, gains "
        f"{found.gain:.4g} [{found.low:.4g}, {found.high:.4g}] at {found.level:.0%}.",
        more,
    )


def _any_differs(view: StudyView, level: float) -> bool:
    """Return whether the surrogate believes that any evaluated design differs from the nominal one."""
    nominal = view.space.nominal
    others = [e.params for e in view.ranking() if dict(e.params) != nominal]
    base, *points = _unit(view, [nominal, *others])
    gains = (posterior_gain(view.surrogate(), point, base, view.maximize, level) for point in points)
    return any(low > 0.0 or high < 0.0 for _, low, high, _ in gains)


def bounds(view: StudyView) -> Check:
    """Does the best design lie at the edge of the space?"""
    name = "bounds"
    if sum(t.ok for t in view.trials()) < 2:
        return Check(name, "ok", "There is no best design yet that could lie at a bound.")
    params = view.recommend().params
    point = _unit(view, [params])[0]
    edges: list[str] = []
    for p, u in zip(view.space.free, point, strict=True):
        if isinstance(p, Categorical):
            continue
        close = _EDGE if isinstance(p, Continuous) else 0.5 / p.count + 1e-9
        if u <= close or u >= 1.0 - close:
            side, bound = ("lower", p.low) if u <= close else ("upper", p.high)
            edges.append(f"the {side} bound of {p.name} ({bound:g})")
    if not edges:
        return Check(name, "ok", "The recommended design lies inside the bounds of the space.")
    return Check(
        name,
        "info",
        f"The recommended design lies at {listed(edges)}; better ones may lie beyond.",
        "If values beyond are possible, start a study of `space.with_bounds(...)` and give it this one by "
        "`add_history`.",
    )


def _unit(view: StudyView, params: Sequence[Mapping[str, Value]]) -> Array:
    return view.space.to_unit(view.space.designs(params))


def _numbers(trials: Sequence[int]) -> str:
    """Return numbers in words, runs of them as `3-7`."""
    runs: list[str] = []
    for _, group in itertools.groupby(enumerate(trials), key=lambda item: item[1] - item[0]):
        run = [trial for _, trial in group]
        runs.append(f"{run[0]}" if len(run) == 1 else f"{run[0]}-{run[-1]}")
    return ", ".join(runs)


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."
