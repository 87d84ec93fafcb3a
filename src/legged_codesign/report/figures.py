"""The figures of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from codesign_bo.confirm import Gain
from codesign_bo.records import ConfirmationRecord, TrialRecord
from codesign_bo.view import Slice
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from legged_codesign.config import Objective
from legged_codesign.objective import UNITS, physical
from legged_codesign.report.motion import Motion
from legged_codesign.report.style import ACCENT, BEST, FILL, INK, MUTED, NOMINAL, figure, label

_ORIGIN = {"nominal": ("s", NOMINAL), "queued": ("^", ACCENT), "sobol": ("D", MUTED), "surrogate": ("o", BEST)}
_ORIGIN_NAME = {"nominal": "nominal", "queued": "from screening", "sobol": "Sobol", "surrogate": "Gaussian process"}


def search_history(trials: Sequence[TrialRecord], objective: Objective) -> Figure:
    """Score of every trial with twice its standard error, and the best so far."""
    made, (ax,) = figure(7.4, 3.4)
    scored = [t for t in trials if t.ok and t.result is not None]
    numbers = [t.trial for t in scored]
    values = np.array([physical(t.result.mean, objective) for t in scored if t.result])
    sems = np.array([2 * (t.result.sem or 0.0) for t in scored if t.result])
    for origin, (marker, colour) in _ORIGIN.items():
        rows = [i for i, t in enumerate(scored) if t.origin == origin]
        if rows:
            ax.errorbar(
                np.array(numbers)[rows],
                values[rows],
                yerr=sems[rows],
                fmt=marker,
                color=colour,
                markersize=7,
                capsize=3,
                label=_ORIGIN_NAME[origin],
            )
    best = np.maximum.accumulate(values) if objective == "return" else np.minimum.accumulate(values)
    ax.step(numbers, best, where="post", color=INK, linewidth=1.2, label="best so far")
    _fit_to_walkers(ax, values)
    label(ax, "trial", UNITS[objective])
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    made.legend(frameon=False, fontsize=8.5, ncols=5, loc="outside upper left")
    return made


def _fit_to_walkers(ax: object, values: np.ndarray) -> None:
    """A body that cannot walk is capped far off; let it not flatten the others."""
    ordinary = values[np.abs(values) < 3 * np.median(np.abs(values))]
    if len(ordinary) > 1 and len(ordinary) < len(values):
        margin = 0.15 * (ordinary.max() - ordinary.min() + 1e-9)
        ax.set_ylim(ordinary.min() - margin, ordinary.max() + margin)  # pyright: ignore[reportAttributeAccessIssue]


def confirmation(
    runs: Sequence[ConfirmationRecord], gains: Sequence[Gain], params: Mapping[int, str], objective: Objective
) -> Figure:
    """Scores of the confirmed bodies on each fresh seed, one line per seed, and the gain with its interval."""
    made, (left, right) = figure(9.2, 3.2, columns=2)
    bodies = [0, *(gain.trial for gain in gains)]
    for repeat in sorted({run.repeat for run in runs}):
        row = {run.trial: run.result.mean for run in runs if run.repeat == repeat and run.result and run.result.ok}
        points = [(x, physical(row[body], objective)) for x, body in enumerate(bodies) if body in row]
        left.plot(*zip(*points, strict=True), "o-", color=NOMINAL, linewidth=1, markersize=5)
    for x, body in enumerate(bodies):
        scores = [run.result.mean for run in runs if run.trial == body and run.result and run.result.ok]
        left.plot(x, physical(float(np.mean(scores)), objective), "_", color=BEST if x else INK, markersize=26, mew=3)
    left.set_xticks(range(len(bodies)), [params[body] for body in bodies], fontsize=8)
    left.set_xlim(-0.5, len(bodies) - 0.5)
    label(left, "", UNITS[objective], "each fresh seed (lines), mean (bars)")
    for y, gain in enumerate(reversed(gains)):
        middle, low, high = (100 * value for value in gain.relative)
        right.errorbar(
            middle, y, xerr=[[middle - low], [high - middle]], fmt="o", color=BEST, capsize=4, linewidth=2, markersize=7
        )
        right.annotate(f"{middle:+.1f} %", (middle, y), (0, 9), textcoords="offset points", ha="center", fontsize=9)
    right.axvline(0.0, color=INK, linewidth=1)
    right.set_yticks(range(len(gains)), [params[gain.trial] for gain in reversed(gains)], fontsize=8)
    right.set_ylim(-0.6, len(gains) - 0.4)
    label(right, "gain over the nominal body, %", "", "95 % intervals")
    return made


def fine_tuning(trials: Sequence[TrialRecord], objective: Objective) -> Figure:
    """What fine-tuning changed: learning curves, and zero-step score against fine-tuned score."""
    made, (left, right) = figure(9.2, 3.2, columns=2)
    scored = [t for t in trials if t.ok and t.result is not None]
    for t in scored:
        if t.result is None or not t.result.curve:
            continue
        steps, rewards = zip(*t.result.curve, strict=True)
        nominal = t.trial == 0
        left.plot(
            np.array(steps) / 1000,
            rewards,
            color=INK if nominal else BEST,
            alpha=1.0 if nominal else 0.35,
            linewidth=2 if nominal else 1,
            label="nominal" if nominal else None,
        )
    label(left, "thousand environment steps", "reward per second", "fine-tuning of each body")
    left.legend(frameon=False, fontsize=8.5)
    pairs = np.array(
        [
            [physical(t.result.extras[name], objective) for name in ("score_generalist", "score_fine_tuned")]
            for t in scored
            if t.result
        ]
    )
    right.plot(pairs[:, 0], pairs[:, 1], "o", color=BEST, markersize=6)
    span = [pairs.min(), pairs.max()]
    right.plot(span, span, color=INK, linewidth=1)
    label(right, "generalist, zero-step", "fine-tuned", UNITS[objective])
    return made


def pretraining(rows: Sequence[Mapping[str, float]]) -> Figure:
    """Reward and tracking error over the pre-training."""
    made, (left, right) = figure(9.2, 2.8, columns=2)
    samples = [row["samples"] / 1e6 for row in rows]
    left.plot(samples, [row["reward"] for row in rows], color=BEST)
    label(left, "million environment steps", "reward per second")
    right.plot(samples, [row["tracking_error"] for row in rows], color=ACCENT)
    right.set_ylim(bottom=0)
    label(right, "million environment steps", "tracking error, m/s (noise on)")
    return made


def landscape(slices: Mapping[str, Slice], best: Mapping[str, float], objective: Objective) -> Figure:
    """Posterior of the Gaussian process along each parameter, the others at the best body."""
    made, axes = figure(2.5 * max(2, len(slices)), 2.8, columns=len(slices))
    low = min(float((s.mean - 2 * s.std).min()) for s in slices.values())
    high = max(float((s.mean + 2 * s.std).max()) for s in slices.values())
    for ax, (name, cut) in zip(axes, slices.items(), strict=True):
        mean, band = np.array([physical(float(m), objective) for m in cut.mean]), 2 * cut.std
        ax.fill_between(cut.values, mean - band, mean + band, color=FILL)
        ax.plot(cut.values, mean, color=BEST)
        ax.axvline(best[name], color=ACCENT, linewidth=1.2)
        ax.set_ylim(*sorted((physical(low, objective), physical(high, objective))))
        label(ax, name.replace("_", " "), UNITS[objective] if ax is axes[0] else "")
    return made


def screening(rows: Sequence[Mapping[str, object]], objective: Objective) -> Figure:
    """Zero-shot scores of the screened bodies, sorted, with the nominal one marked."""
    made, (ax,) = figure(7.4, 2.6)
    scores = np.array([physical(float(row["score"]), objective) for row in rows])  # pyright: ignore[reportArgumentType]
    order = np.argsort(scores if objective != "return" else -scores)
    ax.bar(range(len(rows)), scores[order], color=[INK if i == 0 else FILL for i in order], width=1.0)
    rank = int(np.flatnonzero(order == 0)[0])
    ax.annotate("nominal", (rank, scores[0]), (0, 10), textcoords="offset points", ha="center", fontsize=8.5)
    ax.grid(axis="x", visible=False)
    label(ax, "bodies, best first", UNITS[objective])
    return made


def joint_power(motion: Motion) -> Figure:
    """Instantaneous power of the hip, thigh and knee joints, and the running sum of the positive part (Fig. 9)."""
    made, (top, bottom) = figure(9.2, 4.6, rows=2)
    positive = np.maximum(motion.power, 0.0)
    groups = {"abduction": positive[:, 0::3], "thigh": positive[:, 1::3], "knee": positive[:, 2::3]}
    window = slice(0, int(np.searchsorted(motion.time, motion.time[0] + 6.0)))
    top.stackplot(
        motion.time[window],
        [group.sum(axis=1)[window] for group in groups.values()],
        labels=list(groups),
        colors=[NOMINAL, BEST, ACCENT],
        linewidth=0,
    )
    made.legend(frameon=False, fontsize=8.5, ncols=3, loc="outside upper left")
    label(top, "time, s (first 6 s)", "positive power, W")
    step = float(np.median(np.diff(motion.time)))
    bottom.plot(motion.time, np.cumsum(positive.sum(axis=1)) * step, color=INK)
    label(bottom, "time, s", "energy, J")
    return made
