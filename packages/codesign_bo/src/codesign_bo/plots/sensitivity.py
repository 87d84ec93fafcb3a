"""Sensitivity: how much each parameter matters, and whether the data can tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, NullLocator

from codesign_bo.errors import StudyError
from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.style import BLUE, INK, MUTED, PLAIN, SKY, Labels, figure, label, legend
from codesign_bo.sensitivity import Effect, sensitivity
from codesign_bo.view import StudyView

_THIN = 0.36


@dataclass(frozen=True)
class Importance:
    """Effects of the free parameters, the one with the highest total index first."""

    effects: tuple[Effect, ...]

    @classmethod
    def of(cls, view: StudyView) -> Importance:
        """Take it from a study.

        Raises:
            NothingToShowError: Fewer than 3 scores.
        """
        try:
            return cls.sorted(sensitivity(view))
        except StudyError as error:
            raise NothingToShowError("fewer than 3 trials have a score") from error

    @classmethod
    def sorted(cls, effects: list[Effect]) -> Importance:
        """Take effects that are known already."""
        return cls(tuple(sorted(effects, key=lambda e: (-e.total, e.name))))

    def figure(self, labels: Labels) -> Figure:
        """Draw the Sobol indices as bars, and beside them the length scales."""
        made, (left, right) = figure(9.2, 0.55 * len(self.effects) + 1.9, 1, 2)
        rows = np.arange(len(self.effects))
        total, first = [e.total for e in self.effects], [e.first for e in self.effects]
        together = left.barh(rows - _THIN / 2, total, _THIN, color=SKY, label="with all others (total order)")
        alone = left.barh(rows + _THIN / 2, first, _THIN, color=BLUE, label="alone (first order)")
        for row, effect in enumerate(self.effects):
            if not effect.identifiable:
                left.text(
                    max(effect.total, effect.first) + 0.02, row, "not identifiable", va="center", fontsize=9,
                    color=MUTED, style="italic",
                )  # fmt: skip
        left.set_yticks(rows, [labels(e.name) for e in self.effects])
        for text in left.get_yticklabels():
            text.set_parse_math(False)
        left.tick_params(axis="y", labelcolor=INK, labelsize=9.5)
        left.set_xlim(0.0, 1.25 if any(not e.identifiable for e in self.effects) else 1.05)
        left.set_xticks(np.linspace(0.0, 1.0, 6))
        label(left, "share of the variance of the posterior mean")
        scales = [e.lengthscale for e in self.effects]
        for row, effect in zip(rows, self.effects, strict=True):
            right.plot(
                effect.lengthscale, row, "o", color=BLUE, markersize=8,
                markerfacecolor=BLUE if effect.identifiable else "white",
            )  # fmt: skip
        right.axvline(1.0, color=MUTED, linewidth=1.0, linestyle=":")
        right.annotate(
            "width of the space", (1.0, 1.0), (3, 3), xycoords=("data", "axes fraction"), color=MUTED, fontsize=8.5,
            textcoords="offset points",
        )  # fmt: skip
        right.set_xscale("log")
        right.set_xlim(min(0.08, *scales) / 1.5, max(12.0, *scales) * 1.5)
        right.xaxis.set_major_formatter(LogFormatterSciNotation() if max(scales) > 1e3 else "{x:g}")
        right.xaxis.set_minor_locator(NullLocator())
        right.set_yticks(rows, [""] * len(rows))
        for ax in (left, right):
            ax.set_ylim(len(rows) - 0.45, -0.55)
            ax.grid(visible=False, axis="y")
        label(right, "length scale (hollow: not identifiable)")
        legend(made, [alone, together], 2)
        return made

    def sentence(self, labels: Labels) -> str:
        """Say which parameters matter."""
        known = [e for e in self.effects if e.identifiable]
        unknown = [e.name for e in self.effects if not e.identifiable]
        words = ", ".join(f"{e.name} ({e.total:.0%})" for e in known)
        told = f"The data tell these effects from noise, the largest first: {words}. " if known else ""
        rest = (
            f"Not identifiable, since the scores are explained as well without it: {', '.join(unknown)}."
            if unknown
            else "No parameter could be left out."
        )
        return told + rest


def plot_sensitivity(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw Sobol indices and length scales, with what the data cannot tell.

    Raises:
        NothingToShowError: Fewer than 3 scores.
    """
    return Importance.of(view).figure(labels)
