"""All pairs of parameters: posterior means below the diagonal, standard deviations above."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.planes import (
    FINE,
    Marks,
    Plane,
    colour_bar,
    colour_scale,
    draw_field,
    draw_marks,
    marks_of,
    most_influential,
    plane_of,
    transposed,
)
from codesign_bo.plots.style import (
    INK,
    MEAN_MAP,
    PLAIN,
    SPREAD_MAP,
    Labels,
    figure,
    headline,
    label,
    parameter_ticks,
)
from codesign_bo.space import AnyParameter
from codesign_bo.view import StudyView

_MOST = 5


@dataclass(frozen=True)
class Pairs:
    """All pairs of parameters, or of the five that matter most.

    Attributes:
        planes: Fine grids by (column, row) of the picture, column below row.
        axes: Which free parameters these are.
        parameters: The parameters.
        marks: Designs to be marked.
        left_out: Names of the parameters that have no place.
    """

    planes: Mapping[tuple[int, int], Plane]
    axes: tuple[int, ...]
    parameters: tuple[AnyParameter, ...]
    marks: Marks
    left_out: tuple[str, ...]

    @classmethod
    def of(cls, view: StudyView) -> Pairs:
        """Take them from a study.

        Raises:
            NothingToShowError: Fewer than three free parameters (`Landscape` shows two), or fewer than two scores.
        """
        marks, _ = marks_of(view)
        if view.space.dim < 3:
            raise NothingToShowError("the space has two free parameters, and the landscape shows both")
        axes = tuple(sorted(most_influential(view, _MOST)))
        planes = {
            (i, j): plane_of(view, marks.here, axes[i], axes[j], FINE)
            for j in range(len(axes))
            for i in range(j)
        }  # fmt: skip
        left_out = tuple(n for axis, n in enumerate(view.space.free_names) if axis not in axes)
        return cls(planes, axes, tuple(view.space.free[a] for a in axes), marks, left_out)

    def figure(self, labels: Labels) -> Figure:
        """Draw the mean below the diagonal and the standard deviation above it."""
        n = len(self.parameters)
        made, axes = figure(2.1 * n + 1.4, 2.05 * n + 0.7, n, n)
        mean = colour_scale(np.concatenate([p.mean[p.allowed] for p in self.planes.values()]))
        spread = colour_scale(np.concatenate([p.std[p.allowed] for p in self.planes.values()]), 0.0)
        for row in range(n):
            for column in range(n):
                ax = axes[row * n + column]
                i, j = sorted((row, column))
                if row == column:
                    ax.set_axis_off()
                    name = ax.text(
                        0.5, 0.5, labels(self.parameters[row].name).replace("_", "_\n"), transform=ax.transAxes,
                        ha="center", va="center", fontsize=10.5, color=INK, parse_math=False,
                    )  # fmt: skip
                    name.set_in_layout(False)
                    continue
                plane = self.planes[i, j] if row > column else transposed(self.planes[i, j])
                below = row > column
                draw_field(
                    ax, plane, plane.mean if below else plane.std, mean if below else spread,
                    MEAN_MAP if below else SPREAD_MAP,
                )  # fmt: skip
                draw_marks(ax, self.marks, self.axes[column], self.axes[row], small=True)
                parameter_ticks(ax, plane.x, n=3)
                parameter_ticks(ax, plane.y, "y", n=3)
                last = n - 1 if column < n - 1 else n - 2
                first = 0 if row > 0 else 1
                label(
                    ax,
                    labels(plane.x.name) if row == last else "",
                    labels(plane.y.name) if column == first else "",
                )
                ax.tick_params(labelbottom=row == last, labelleft=column == first, labelsize=8.5)
        colour_bar(made, axes, spread, SPREAD_MAP, "its standard deviation (above)")
        colour_bar(made, axes, mean, MEAN_MAP, f"posterior mean of {labels.objective} (below the diagonal)")
        left_out = f"; left out as less influential: {', '.join(self.left_out)}" if self.left_out else ""
        headline(made, f"★ recommended, ◇ nominal, ○ tried, × failed{left_out}")
        return made

    def sentence(self, labels: Labels) -> str:
        """Say which pair changes the objective most."""
        top = max(self.planes.values(), key=lambda p: float(np.ptp(p.mean[p.allowed])) if p.allowed.any() else 0.0)
        return (
            f"Of all pairs, {top.x.name} and {top.y.name} change the posterior mean most, by "
            f"{float(np.ptp(top.mean[top.allowed])):.3g}, the others being held at the recommended design; "
            "dark areas above the diagonal are still unknown."
        )


def plot_pairs(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw the posterior mean and its standard deviation over all pairs of parameters, at most five of them.

    Raises:
        NothingToShowError: Fewer than three free parameters, or fewer than two scores.
    """
    return Pairs.of(view).figure(labels)
