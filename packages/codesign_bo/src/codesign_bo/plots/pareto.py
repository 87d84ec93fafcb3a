"""Pareto front: measured results that no other beats in all objectives."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from codesign_bo.acquisition.pareto import non_dominated
from codesign_bo.confirm import NOMINAL_TRIAL
from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.style import BLUE, INK, MUTED, ORANGE, PLAIN, Z95, Labels, figure, headline, label, legend
from codesign_bo.space import Array
from codesign_bo.view import StudyView


@dataclass(frozen=True)
class Front:
    """Results in several objectives; the study's own trials only.

    Attributes:
        names: Of the m objectives; the main one is called `""`.
        maximize: Whether higher is better (m).
        trials: Numbers (n,) of the trials.
        values: Results (n, m).
        errors: Their standard errors (n, m), NaN where unknown.
        efficient: Which results are on the front (n,).
    """

    names: tuple[str, ...]
    maximize: tuple[bool, ...]
    trials: npt.NDArray[np.int64]
    values: Array
    errors: Array
    efficient: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, view: StudyView) -> Front:
        """Take it from a study.

        Raises:
            NothingToShowError: The study has one objective, or no score.
        """
        if not view.objectives:
            raise NothingToShowError("the study has one objective")
        data = [view.observations(name) for name in (None, *view.objectives)]
        parts = [d.y[~d.imported] for d in data], [d.sem[~d.imported] for d in data]
        values, errors = (np.column_stack(part) for part in parts)
        if not len(values):
            raise NothingToShowError("no trial has a score yet")
        maximize = (view.maximize, *(way == "maximize" for way in view.objectives.values()))
        trials = data[0].trial[~data[0].imported]
        return cls(
            ("", *view.objectives), maximize, trials, values, errors, non_dominated(np.where(maximize, values, -values))
        )

    def figure(self, labels: Labels) -> Figure:
        """Draw every further objective over the main one."""
        panels = len(self.names) - 1
        made, axes = figure(max(5.2 * panels, 7.2), 5.0, 1, panels)
        main = f"{labels.objective} ({_way(self.maximize[0])})"
        nominal = self.trials == NOMINAL_TRIAL
        for i, ax in enumerate(axes, start=1):
            x, y = self.values[:, 0], self.values[:, i]
            bars = Z95 * np.nan_to_num(self.errors)
            for mask, colour, fill, words in (
                (~self.efficient, MUTED, "white", "beaten by another"),
                (self.efficient, BLUE, BLUE, "on the front"),
            ):
                ax.errorbar(
                    x[mask], y[mask], bars[mask, i], bars[mask, 0], fmt="o", color=colour, markerfacecolor=fill,
                    markersize=6, elinewidth=0.8, label=words,
                )  # fmt: skip
            if panels == 1:
                across, up = _staircase(self.values[self.efficient], self.maximize)
                ax.plot(across, up, color=BLUE, linewidth=1.4, zorder=1)
            ax.plot(
                x[nominal], y[nominal], "D", markersize=11, markerfacecolor="none", markeredgecolor=ORANGE,
                markeredgewidth=2.0, label="nominal design",
            )  # fmt: skip
            for j in np.flatnonzero(self.efficient):
                ax.annotate(
                    str(self.trials[j]), (x[j], y[j]), (6, 6), textcoords="offset points", fontsize=9, color=INK
                )
            ax.margins(0.1)
            label(ax, main, f"{labels(self.names[i])} ({_way(self.maximize[i])})")
        legend(made, axes[0].get_legend_handles_labels()[0])
        if panels > 1:
            headline(made, "On the front: beaten by none in all objectives at once. Numbers: trials")
        else:
            headline(made, "Numbers: trials on the front; bars: 95 % intervals of the standard errors")
        return made

    def sentence(self, labels: Labels) -> str:
        """Say how large the front is, and whether the nominal design is on it."""
        count = int(self.efficient.sum())
        on = self.efficient[self.trials == NOMINAL_TRIAL]
        nominal = "" if not len(on) else f"; the nominal design is {'on it' if on[0] else 'beaten'}"
        return (
            f"{count} of {len(self.values)} results {'is' if count == 1 else 'are'} beaten by no other in all "
            f"objectives (trials {', '.join(map(str, self.trials[self.efficient]))}){nominal}; "
            "single scores are noisy, so neighbours on the front may change places."
        )


def plot_pareto(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw measured results in several objectives, and which of them no other beats.

    Raises:
        NothingToShowError: The study has one objective, or no score.
    """
    return Front.of(view).figure(labels)


def _way(maximize: bool) -> str:
    return "higher is better" if maximize else "lower is better"


def _staircase(front: Array, maximize: Sequence[bool]) -> tuple[Array, Array]:
    """Return the border of what the front (k, 2) beats, as a line of right angles."""
    corners = front[np.argsort(front[:, 0], kind="stable")]
    # Between two results the border runs at the worse value of each objective.
    across, up = [corners[0, 0]], [corners[0, 1]]
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        across += [x0 if maximize[0] else x1, x1]
        up += [y1 if maximize[0] else y0, y1]
    return np.array(across), np.array(up)
