"""Best against nominal on fresh seeds: picture, table, and whether the search could tell bodies apart at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from codesign_bo.confirm import Gain
from codesign_bo.records import ConfirmationRecord
from deploy.page.style import BEST, INK, NOMINAL, figure, label
from matplotlib.figure import Figure

from legged_codesign.config import Objective
from legged_codesign.objective import UNITS, physical
from legged_codesign.report.data import RunData


def confirmation(
    runs: Sequence[ConfirmationRecord], gains: Sequence[Gain], params: Mapping[int, str], objective: Objective
) -> Figure:
    """Scores of the confirmed bodies on each fresh seed, one line per seed, and the gain with its interval."""
    made, (left, right) = figure(9.2, 3.2, columns=2)
    bodies = [0, *(gain.trial for gain in gains)]
    for repeat in sorted({run.repeat for run in runs}):
        row = {run.trial: run.result.mean for run in runs if run.repeat == repeat and run.result and run.result.ok}
        points = [(x, physical(row[body], objective)) for x, body in enumerate(bodies) if body in row]
        if points:
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


def confirmed_rows(data: RunData, objective: Objective) -> list[dict[str, Any]]:
    """Means over the fresh seeds for the nominal body and each confirmed one."""
    rows = []
    gains = {gain.trial: gain for gain in data.gains}
    for body in (0, *gains):
        results = [r.result for r in data.confirmations if r.trial == body and r.result is not None and r.result.ok]
        names = {name for result in results for name in result.extras}
        extras = {name: float(np.mean([r.extras.get(name, np.nan) for r in results])) for name in names}
        rows.append(
            {
                "trial": body,
                "name": "nominal" if body == 0 else f"body {body}",
                "params": data.trials[body].params,
                "score": physical(float(np.mean([r.mean for r in results])), objective) if results else None,
                "gain": gains.get(body),
                "robots": sum(r.n for r in results),
                **{name: sum(r.extras.get(name, np.nan) for r in results) for name in ("survived", "succeeded")},
                "extras": extras,
            }
        )
    return rows


def separability(data: RunData) -> str:
    """Could the search tell bodies apart beyond its noise? In words; empty without repeated evaluations."""
    scored = [t.result for t in data.trials if t.ok and t.result is not None]
    repeated = [
        [r.result.mean for r in data.confirmations if r.trial == body and r.result and r.result.ok]
        for body in sorted({r.trial for r in data.confirmations})
    ]
    within = [np.var(scores, ddof=1) for scores in repeated if len(scores) > 1]
    if len(scored) < 2 or not within:
        return ""
    spread = float(np.std([result.mean for result in scored]))
    noise = float(np.sqrt(np.mean(within)))
    if noise == 0.0:
        return f"The scores of the bodies spread by {spread:.4g}; one body's score did not vary between seeds at all."
    times = spread / noise
    verdict = "could" if times > 2 else "could hardly"
    return (
        f"The search {verdict} tell bodies apart: their scores spread by {spread:.4f} (standard deviation), "
        f"{times:.1f} times the {noise:.4f} by which one body's score varies between fine-tuning seeds."
    )
