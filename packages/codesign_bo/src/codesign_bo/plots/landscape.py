"""The landscape over the two parameters that matter most, in blocks as in Fig. 8 of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

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
)
from codesign_bo.plots.style import (
    FRAME,
    INK,
    MEAN_MAP,
    PLAIN,
    SPREAD_MAP,
    VERMILLION,
    Labels,
    figure,
    headline,
    label,
    parameter_ticks,
    show_design,
    value_text,
)
from codesign_bo.space import Array, Value
from codesign_bo.view import StudyView

_BLOCKS = 5


@dataclass(frozen=True)
class Landscape:
    """The two parameters that matter most.

    Attributes:
        blocks: Five levels of each, from bound to bound, or all if there are fewer.
        fine: A fine grid.
        axes: Which free parameters these are.
        marks: Designs to be marked.
        params: The recommended design, at which the others are held.
    """

    blocks: Plane
    fine: Plane
    axes: tuple[int, int]
    marks: Marks
    params: Mapping[str, Value]

    @classmethod
    def of(cls, view: StudyView, names: tuple[str, str] | None = None) -> Landscape:
        """Take it from a study.

        Args:
            view: The study.
            names: The parameters across and upwards; by default those with the highest total Sobol indices, in the
                space's order.

        Raises:
            NothingToShowError: Fewer than two free parameters, or fewer than two scores.
            ValueError: A name is that of no free parameter.
        """
        marks, params = marks_of(view)
        free = view.space.free_names
        if names is None:
            x, y = sorted(most_influential(view, 2))
        else:
            unknown = [n for n in names if n not in free]
            if unknown or names[0] == names[1]:
                raise ValueError(f"{list(names)} are no two different free parameters; choose from {free}")
            x, y = (free.index(n) for n in names)
        plane = [plane_of(view, marks.here, x, y, n) for n in (_BLOCKS, FINE)]
        return cls(plane[0], plane[1], (x, y), marks, params)

    def figure(self, labels: Labels) -> Figure:
        """Draw the blocks with their values, and beside them how uncertain the posterior is."""
        made, (left, right) = figure(10.2, 4.9, 1, 2)
        plane, (x, y) = self.blocks, self.axes
        norm = colour_scale(plane.mean[plane.allowed])
        _draw_blocks(left, plane, norm)
        colour_bar(made, left, norm, MEAN_MAP, labels.objective)
        for design, style, words in ((self.marks.here, "-", "recommended"), (self.marks.nominal, ":", "nominal")):
            column, row = _nearest(plane.across, design[x]), _nearest(plane.upwards, design[y])
            left.add_patch(
                Rectangle(
                    (column - 0.46, row - 0.46), 0.92, 0.92, fill=False, edgecolor=VERMILLION, linewidth=2.4,
                    linestyle=style, label=words,
                )
            )  # fmt: skip
        label(left, labels(plane.x.name), labels(plane.y.name), "posterior mean ± standard deviation")
        spread = colour_scale(self.fine.std[self.fine.allowed], 0.0)
        draw_field(right, self.fine, self.fine.std, spread, SPREAD_MAP)
        colour_bar(made, right, spread, SPREAD_MAP, f"standard deviation of {labels.objective}")
        draw_marks(right, self.marks, x, y)
        parameter_ticks(right, plane.x)
        parameter_ticks(right, plane.y, "y")
        label(right, labels(plane.x.name), labels(plane.y.name), "uncertainty; ○ tried, × failed")
        others = {n: v for n, v in self.params.items() if n not in (plane.x.name, plane.y.name)}
        held = f"; others held at {show_design(others)}" if 0 < len(others) <= 6 else ""
        headline(made, f"Framed: nearest to the recommended (solid) and the nominal design (dotted){held}")
        return made

    def sentence(self, labels: Labels) -> str:
        """Say where the best block is, and whether it stands out of the uncertainty."""
        p = self.blocks
        mean = np.where(p.allowed, p.mean, np.nan)
        spread, typical = float(np.nanmax(mean) - np.nanmin(mean)), float(np.median(p.std[p.allowed]))
        clear = "more than" if spread > 4.0 * typical else "hardly more than" if spread > 2.0 * typical else "within"
        return (
            f"Over {p.x.name} and {p.y.name} the posterior mean ranges from {np.nanmin(mean):.3g} to "
            f"{np.nanmax(mean):.3g}, {clear} what its uncertainty (± {typical:.2g} at the median) allows."
        )


def plot_landscape(view: StudyView, names: tuple[str, str] | None = None, labels: Labels = PLAIN) -> Figure:
    """Draw the posterior over two parameters in blocks (paper, Fig. 8), and its uncertainty (see `Landscape.of`).

    Raises:
        NothingToShowError: Fewer than two free parameters, or fewer than two scores.
        ValueError: A name is that of no free parameter.
    """
    return Landscape.of(view, names).figure(labels)


def _draw_blocks(ax: Axes, plane: Plane, norm: Normalize) -> None:
    """Draw one square for each design of the grid, with mean and standard deviation in it; the rest is hatched."""
    shown = np.ma.masked_array(plane.mean, mask=~plane.allowed)
    ax.set_facecolor("white")
    ax.grid(visible=False)
    ax.add_patch(
        Rectangle((0, 0), 1, 1, transform=ax.transAxes, facecolor="white", edgecolor=FRAME, hatch="///", zorder=0)
    )
    ax.pcolormesh(
        np.arange(len(plane.across) + 1) - 0.5, np.arange(len(plane.upwards) + 1) - 0.5, shown, cmap=MEAN_MAP,
        norm=norm, edgecolors="white", linewidth=1.2,
    )  # fmt: skip
    digits = _digits(plane.std[plane.allowed])
    for row in range(len(plane.upwards)):
        for column in range(len(plane.across)):
            if plane.allowed[row, column]:
                mean, std = plane.mean[row, column], plane.std[row, column]
                ink = INK if norm(mean) > 0.62 else "white"
                for up, size, words in ((0.1, 10, f"{mean:.{digits}f}"), (-0.22, 8, f"± {std:.{digits}f}")):
                    words = words.replace("-", "−")
                    written = ax.text(column, row + up, words, ha="center", va="center", fontsize=size, color=ink)
                    written.set_in_layout(False)
    ax.set_xlim(-0.5, len(plane.across) - 0.5)
    ax.set_ylim(-0.5, len(plane.upwards) - 0.5)
    ax.set_xticks(range(len(plane.across)), [value_text(plane.x, u) for u in plane.across])
    ax.set_yticks(range(len(plane.upwards)), [value_text(plane.y, u) for u in plane.upwards])
    for text in (*ax.get_xticklabels(), *ax.get_yticklabels()):
        text.set_parse_math(False)


def _digits(spread: Array) -> int:
    """Return how many decimals show two figures of the typical standard deviation."""
    typical = float(np.median(spread)) if spread.size else 1.0
    return int(np.clip(1 - np.floor(np.log10(typical)), 0, 5)) if typical > 0 else 2


def _nearest(levels_: Array, value: float) -> int:
    return int(np.argmin(np.abs(levels_ - value)))
