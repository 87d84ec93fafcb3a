"""The screened bodies under the generalist: who scores how, and who falls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from deploy.page.style import ACCENT, BEST, FILL, INK, figure, label
from matplotlib.figure import Figure

from legged_codesign.config import Objective
from legged_codesign.objective import UNITS, physical

WORST = 12
"""Failing bodies that the table lists."""


def scores(rows: Sequence[Mapping[str, Any]], objective: Objective) -> Figure:
    """Zero-step scores of the screened bodies, sorted, with the nominal one marked."""
    made, (ax,) = figure(9.2, 2.6)
    values = np.array([physical(float(row["score"]), objective) for row in rows])
    order = np.argsort(values if objective != "return" else -values)
    ax.bar(range(len(rows)), values[order], color=[INK if i == 0 else FILL for i in order], width=1.0)
    rank = int(np.flatnonzero(order == 0)[0])
    ax.annotate("nominal", (rank, values[0]), (0, 10), textcoords="offset points", ha="center", fontsize=8.5)
    ax.grid(axis="x", visible=False)
    ax.margins(y=0.2)
    label(ax, "bodies, best first", UNITS[objective])
    return made


def told(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the screening kept more than scores."""
    return bool(rows) and all("through" in row and "tracking_error" in row for row in rows)


def failing(rows: Sequence[Mapping[str, Any]], robots: int) -> list[tuple[int, Mapping[str, Any]]]:
    """Number and row of the bodies on which a robot fell or did not come through, the worst first."""
    failed = [(i, row) for i, row in enumerate(rows) if row["through"] < robots]
    return sorted(failed, key=lambda pair: (pair[1]["through"], -pair[1]["tracking_error"]))


def failures(rows: Sequence[Mapping[str, Any]], robots: int) -> Figure:
    """Tracking error of every screened body over each parameter that varies; bodies that failed are crossed."""
    varied = [name for name in rows[0]["params"] if len({row["params"][name] for row in rows}) > 1]
    columns = min(max(len(varied), 1), 4)
    lines = max(-(-len(varied) // columns), 1)
    made, axes = figure(9.2, 2.8 * lines, rows=lines, columns=columns)
    errors = np.array([float(row["tracking_error"]) for row in rows])
    failed = np.array([row["through"] < robots for row in rows])
    for index, (ax, name) in enumerate(zip(axes, varied, strict=False)):
        values = np.array([float(row["params"][name]) for row in rows])
        ax.plot(values[~failed], errors[~failed], "o", color=BEST, markersize=4, label="all robots came through")
        ax.plot(values[failed], errors[failed], "x", color=ACCENT, markersize=6, mew=1.6, label="a robot failed")
        ax.plot(values[:1], errors[:1], "s", color=INK, markersize=7, fillstyle="none", label="nominal")
        ax.set_ylim(bottom=0.0, top=1.08 * max(float(errors.max()), 1e-3))
        label(ax, name.replace("_", " "), "tracking error, m/s" if index % columns == 0 else "")
    for ax in axes[len(varied) :]:
        ax.set_axis_off()
    made.legend(*axes[0].get_legend_handles_labels(), frameon=False, fontsize=8.5, ncols=3, loc="outside upper left")
    return made


def in_words(rows: Sequence[Mapping[str, Any]], robots: int) -> str:
    """On how many bodies the generalist fails, and how it tracks on the others."""
    failed = len(failing(rows, robots))
    through = [float(row["tracking_error"]) for row in rows if row["through"] == robots]
    count = "no body" if not failed else f"{failed} of {len(rows)} bodies"
    words = f"Under the generalist, without fine-tuning, a robot of {robots} fell or got stuck on {count}"
    if not through:
        return words + "."
    return (
        f"{words}; on {'the others' if failed else 'them'} the mean tracking error is {np.mean(through):.3f} m/s, at "
        f"most {np.max(through):.3f} m/s. A body that fails here may walk once it is fine-tuned to; the search takes "
        "these scores as hints only."
    )
