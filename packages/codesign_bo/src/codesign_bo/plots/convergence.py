"""Convergence: the best observed and the best recommended score, trial by trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from codesign_bo.data import Observations
from codesign_bo.interfaces import Status
from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    OUTCOMES,
    PLAIN,
    Z95,
    Handle,
    Labels,
    figure,
    integer_axis,
    label,
    legend,
)
from codesign_bo.sensitivity import refit
from codesign_bo.space import Array
from codesign_bo.view import StudyView

Numbers = npt.NDArray[np.int64]

_FITS = 32


@dataclass(frozen=True)
class Convergence:
    """How the search went; n trials have a score in full.

    Attributes:
        trials: Their numbers (n,).
        scores: What was measured (n,).
        errors: Standard errors (n,), NaN where unknown.
        best_observed: Best score up to each of them (n,).
        at: Numbers (k,) of the trials after which the surrogate was asked for the best design, at most 32.
        recommended: Posterior mean (k,) then, of the design that had the best one.
        spread: Posterior standard deviation (k,) then.
        designs: Trial (k,) of that design.
        others: Trials without a score in full that are finished, with their outcome.
        n_init: From this trial on the surrogate proposes.
        maximize: Whether higher is better.
    """

    trials: Numbers
    scores: Array
    errors: Array
    best_observed: Array
    at: Numbers
    recommended: Array
    spread: Array
    designs: Numbers
    others: tuple[tuple[int, Status], ...]
    n_init: int
    maximize: bool

    @classmethod
    def of(cls, view: StudyView) -> Convergence:
        """Take it from a study; the surrogate is fitted once for each point of the recommended curve.

        Raises:
            NothingToShowError: No trial is finished.
        """
        data = view.observations()
        own = ~data.imported
        trials, scores = data.trial[own], data.y[own]
        others: tuple[tuple[int, Status], ...] = tuple(
            (t.trial, t.result.status) for t in view.trials() if t.result is not None and t.trial not in set(trials)
        )
        if not len(trials) and not others:
            raise NothingToShowError("no trial is finished yet")
        running = np.maximum.accumulate if view.maximize else np.minimum.accumulate
        at = trials[np.unique(np.linspace(0, len(trials) - 1, min(len(trials), _FITS)).astype(int))]
        then = np.array([_recommended(view, data, trial) for trial in at]).reshape(-1, 3)
        return cls(
            trials,
            scores,
            data.sem[own],
            running(scores),
            at,
            then[:, 0],
            then[:, 1],
            then[:, 2].astype(np.int64),
            others,
            view.n_init,
            view.maximize,
        )

    def figure(self, labels: Labels) -> Figure:
        """Draw scores, the two curves, and what failed along the lower edge."""
        made, (ax,) = figure(8.4, 4.8)
        last = max([*self.trials.tolist(), *(trial for trial, _ in self.others)])
        handles = self._draw_scores(ax, last + 0.5) if len(self.trials) else []
        kinds: dict[Status, None] = dict.fromkeys(status for _, status in self.others)
        for status in kinds:
            look = OUTCOMES[status]
            numbers = [trial for trial, other in self.others if other == status]
            handles += ax.plot(
                numbers, np.full(len(numbers), 0.03), look.marker, transform=ax.get_xaxis_transform(),
                color=look.colour, markeredgecolor=look.colour if look.marker == "x" else INK,
                markeredgewidth=2.0 if look.marker == "x" else 0.6, markersize=7.5, zorder=4, clip_on=False,
                label=status,
            )  # fmt: skip
        ax.set_xlim(-0.6, last + 0.6)
        if 0 < self.n_init <= last:
            ax.axvline(self.n_init - 0.5, color=MUTED, linewidth=0.9, linestyle=":")
            ax.annotate(
                "surrogate proposes", (self.n_init - 0.5, 1.0), (4, 2), xycoords=("data", "axes fraction"),
                textcoords="offset points", color=MUTED, fontsize=8.5, va="bottom",
            )  # fmt: skip
        if len(self.trials):
            ax.margins(y=0.12)
        else:
            ax.set_yticks([])
            ax.text(0.5, 0.5, "no trial has a score", transform=ax.transAxes, ha="center", color=MUTED, fontsize=11)
        integer_axis(ax)
        label(ax, "trial", f"{labels.objective} ({'higher' if self.maximize else 'lower'} is better)")
        legend(made, handles, 2)
        return made

    def _draw_scores(self, ax: Axes, end: float) -> list[Handle]:
        """Draw scores and both curves up to `end`; return what belongs into the legend."""
        scores = ax.errorbar(
            self.trials, self.scores, Z95 * np.nan_to_num(self.errors), fmt="o", color=MUTED, markersize=4.5,
            markerfacecolor="white", elinewidth=0.9, zorder=3, label="score, 95 % interval of its standard error",
        )  # fmt: skip
        observed = ax.step(
            [*self.trials, end], [*self.best_observed, self.best_observed[-1]], where="post", color=ORANGE,
            linewidth=1.5, linestyle=(0, (5, 2)), label="best score so far (lucky noise included)",
        )  # fmt: skip
        at = np.append(self.at, end)
        mean, spread = (np.append(v, v[-1]) for v in (self.recommended, self.spread))
        band = ax.fill_between(
            at, mean - Z95 * spread, mean + Z95 * spread, color=BLUE, alpha=0.17, linewidth=0,
            label="95 % interval of the recommended",
        )  # fmt: skip
        curve = ax.plot(at, mean, color=BLUE, linewidth=2.2, label="recommended so far: best posterior mean")
        return [scores, *observed, *curve, band]

    def sentence(self, labels: Labels) -> str:
        """Say what is recommended now, and since when."""
        failed = len(self.others)
        tail = f" {failed} of {failed + len(self.trials)} trials have no score in full." if failed else ""
        if not len(self.trials):
            return f"No trial has a score.{tail}"
        since = (
            int(self.at[np.flatnonzero(self.designs != self.designs[-1])[-1] + 1]) if self._changed else int(self.at[0])
        )
        return (
            f"Trial {self.designs[-1]} is recommended, since trial {since}: posterior mean "
            f"{self.recommended[-1]:.4g} ± {Z95 * self.spread[-1]:.2g} (95 %); "
            f"the best single score, {self.best_observed[-1]:.4g}, contains lucky noise.{tail}"
        )

    @property
    def _changed(self) -> bool:
        return bool(np.any(self.designs != self.designs[-1]))


def plot_convergence(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw the best observed and the best recommended score by trial, with intervals; failures are marked.

    Raises:
        NothingToShowError: No trial is finished.
    """
    return Convergence.of(view).figure(labels)


def _recommended(view: StudyView, data: Observations, trial: int) -> tuple[float, float, int]:
    """Return mean, standard deviation and trial of the best own design, knowing the trials up to `trial`."""
    known = data.imported | (data.trial <= trial)
    scores = [s for s in view.scores() if s.trial is None or s.trial <= trial]
    surrogate = refit(view, data.x[known], data.y[known], data.sem[known], scores)
    own = known & ~data.imported
    mean, std = surrogate.predict(data.x[own])
    best = int(np.argmax(mean if view.maximize else -mean))
    return float(mean[best]), float(std[best]), int(data.trial[own][best])
