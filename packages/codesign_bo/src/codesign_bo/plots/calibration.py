"""Calibration: each score predicted from all the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from codesign_bo.models.surrogate import LeaveOneOut
from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.style import BLUE, GREEN, INK, MUTED, PLAIN, VERMILLION, Z95, Labels, figure, label
from codesign_bo.view import StudyView


@dataclass(frozen=True)
class Calibration:
    """Leave-one-out predictions.

    Attributes:
        left: The predictions of n scores.
        names: Their trials (n,), in words; those of other studies have a star.
    """

    left: LeaveOneOut
    names: tuple[str, ...]

    @classmethod
    def of(cls, view: StudyView) -> Calibration:
        """Take it from a study.

        Raises:
            NothingToShowError: Fewer than 3 scores.
        """
        data = view.observations()
        if len(data.y) < 3:
            raise NothingToShowError("fewer than 3 trials have a score")
        names = (f"{t}*" if other else f"{t}" for t, other in zip(data.trial, data.imported, strict=True))
        return cls(view.leave_one_out(), tuple(names))

    def figure(self, labels: Labels) -> Figure:
        """Draw observed over predicted, and the standardised errors trial by trial."""
        made, (left, right) = figure(9.6, 4.5, 1, 2)
        y, mean, std, z = self.left.y, self.left.mean, self.left.std, self.left.z
        outside = np.abs(z) > Z95
        middle = float(np.mean(y))
        left.axline((middle, middle), slope=1.0, color=MUTED, linewidth=1.0, linestyle=":")
        right.axhspan(-Z95, Z95, color=GREEN, alpha=0.10, linewidth=0)
        right.axhline(0.0, color=MUTED, linewidth=1.0, linestyle=":")
        at = np.arange(len(y))
        for mask, colour, marker in ((~outside, BLUE, "o"), (outside, VERMILLION, "D")):
            left.errorbar(
                mean[mask], y[mask], xerr=Z95 * std[mask], fmt=marker, color=colour, markersize=5, elinewidth=0.8,
                alpha=0.85,
            )  # fmt: skip
            right.plot(at[mask], z[mask], marker, color=colour, markersize=5.5)
        for i in np.flatnonzero(outside):
            for ax, spot in ((left, (mean[i], y[i])), (right, (at[i], z[i]))):
                ax.annotate(self.names[i], spot, (6, 5), textcoords="offset points", fontsize=9, color=VERMILLION)
        left.margins(0.05, 0.08)
        label(
            left, f"{labels.objective}, predicted from the other trials", f"{labels.objective}, measured",
            f"r² = {self.left.r2:.2f}; bars: 95 % of the prediction",
        )  # fmt: skip
        every = max(1, -(-len(y) // 12))
        right.set_xticks(at[::every], self.names[::every])
        largest = max(3.2, 1.15 * float(np.max(np.abs(z))))
        right.set_ylim(-largest, largest)
        label(right, "trial", "(measured − predicted) / standard deviation", f"{self._inside} in the 95 % band")
        right.yaxis.label.set_color(INK)
        return made

    @property
    def _inside(self) -> str:
        return f"{round(self.left.coverage * len(self.left.y))} of {len(self.left.y)}"

    def sentence(self, labels: Labels) -> str:
        """Say how well the surrogate predicts, and whether its intervals hold."""
        r2 = self.left.r2
        how = "well" if r2 > 0.6 else "somewhat" if r2 > 0.2 else "hardly better than the mean of all scores"
        odd = [name for name, z in zip(self.names, self.left.z, strict=True) if abs(z) > Z95]
        tail = f"; outside: trials {', '.join(odd)}" if odd else ""
        return (
            f"From the other trials, the surrogate predicts a score {how} (r² = {r2:.2f}); {self._inside} scores lie "
            f"in their 95 % interval{tail}."
        )


def plot_calibration(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw leave-one-out predictions against what was measured.

    Raises:
        NothingToShowError: Fewer than 3 scores.
    """
    return Calibration.of(view).figure(labels)
