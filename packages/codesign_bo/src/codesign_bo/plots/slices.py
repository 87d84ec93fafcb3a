"""Slices: the posterior along each parameter, the others held at the recommended design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from codesign_bo.plots.picture import NothingToShowError, unit_points
from codesign_bo.plots.style import (
    BLUE,
    FRAME,
    INK,
    MUTED,
    PLAIN,
    VERMILLION,
    Z95,
    Labels,
    figure,
    headline,
    label,
    legend,
    levels,
    parameter_ticks,
    show_design,
)
from codesign_bo.space import AnyParameter, Array, Continuous, Value
from codesign_bo.view import StudyView

_POINTS = 101
_MOST_LEVELS = 25


@dataclass(frozen=True)
class Line:
    """The posterior along one parameter.

    Attributes:
        parameter: The parameter.
        at: Unit coordinates (n,).
        mean: Posterior mean (n,).
        std: Posterior standard deviation (n,).
        allowed: Whether the linear constraints allow the design there (n,).
        here: Unit coordinate of the design that the line goes through.
        nominal: Unit coordinate of the nominal design.
        tried: Unit coordinates (m,) of all scored trials, which need not lie on this line.
        scores: Their scores (m,).
        failed: Unit coordinates of the trials that failed.
    """

    parameter: AnyParameter
    at: Array
    mean: Array
    std: Array
    allowed: npt.NDArray[np.bool_]
    here: float
    nominal: float
    tried: Array
    scores: Array
    failed: Array


@dataclass(frozen=True)
class Slices:
    """Lines through the recommended design, one for each free parameter.

    Attributes:
        lines: The lines, in the space's order.
        trial: Trial of the design.
        params: The design.
    """

    lines: tuple[Line, ...]
    trial: int
    params: Mapping[str, Value]

    @classmethod
    def of(cls, view: StudyView) -> Slices:
        """Take them from a study.

        Raises:
            NothingToShowError: No trial has a score.
        """
        trials = view.trials()
        if not any(t.ok for t in trials):
            raise NothingToShowError("no trial has a score yet")
        found = view.recommend()
        space = view.space
        own = [t for t in trials if t.ok and t.result is not None]
        here, nominal = unit_points(view, [found.params, space.nominal])
        tried = unit_points(view, [t.params for t in own])
        scores = np.array([t.result.mean for t in own if t.result is not None])
        failed = unit_points(view, [t.params for t in trials if t.failed])
        lines: list[Line] = []
        for axis, parameter in enumerate(space.free):
            at = levels(parameter, _POINTS if isinstance(parameter, Continuous) else _MOST_LEVELS)
            points = np.tile(here, (len(at), 1))
            points[:, axis] = at
            mean, std = view.surrogate().predict(points)
            allowed = space.satisfied(space.from_unit(points))
            columns = tried[:, axis], scores, failed[:, axis]
            lines.append(Line(parameter, at, mean, std, allowed, here[axis], nominal[axis], *columns))
        return cls(tuple(lines), found.trial, dict(found.params))

    def figure(self, labels: Labels) -> Figure:
        """Draw one panel for each parameter, all with the same objective axis."""
        columns = min(len(self.lines), 3 if len(self.lines) != 4 else 2)
        rows = -(-len(self.lines) // columns)
        made, axes = figure(max(3.1 * columns + 0.5, 5.4), 2.7 * rows + 0.9, rows, columns)
        for ax, line in zip(axes, self.lines, strict=False):
            _draw(ax, line)
            label(ax, labels(line.parameter.name))
        for ax in axes[:: max(columns, 1)]:
            label(ax, ax.get_xlabel(), labels.objective)
        for ax in axes[len(self.lines) :]:
            ax.set_axis_off()
        low = min(float(np.min(line.mean - Z95 * line.std)) for line in self.lines)
        high = max(float(np.max(line.mean + Z95 * line.std)) for line in self.lines)
        low, high = min(low, float(self.lines[0].scores.min())), max(high, float(self.lines[0].scores.max()))
        margin = 0.07 * (high - low) or 1.0
        for ax in axes[: len(self.lines)]:
            ax.set_ylim(low - margin, high + margin)
        headline(made, f"Lines through trial {self.trial}: {show_design(self.params)}")
        failed = any(len(line.failed) for line in self.lines)
        cut = any(not line.allowed.all() for line in self.lines)
        legend(made, _LEGEND + [_FAILED] * failed + [_CUT] * cut, columns + 1)
        return made

    def sentence(self, labels: Labels) -> str:
        """Say which parameter moves the posterior mean most along its line."""
        spans = [float(np.ptp(line.mean[line.allowed])) if line.allowed.any() else 0.0 for line in self.lines]
        top = int(np.argmax(spans))
        line = self.lines[top]
        if not spans[top] > 0.0:
            return f"Around {show_design(self.params)}, the posterior mean does not change with any parameter so far."
        return (
            f"Around the recommended design ({show_design(self.params)}), {line.parameter.name} moves the posterior "
            f"mean most: by {spans[top]:.3g}, where the interval is ± {Z95 * float(np.median(line.std)):.2g} wide "
            "at the median."
        )


def plot_slices(view: StudyView, labels: Labels = PLAIN) -> Figure:
    """Draw the posterior along each free parameter, through the recommended design.

    Raises:
        NothingToShowError: No trial has a score.
    """
    return Slices.of(view).figure(labels)


_LEGEND: list[Artist] = [
    Line2D([], [], color=BLUE, linewidth=2.0, label="posterior mean"),
    Patch(facecolor=BLUE, alpha=0.17, label="95 % interval"),
    Line2D([], [], color=VERMILLION, linewidth=1.3, label="recommended"),
    Line2D([], [], color=INK, linewidth=1.1, linestyle=":", label="nominal"),
    Line2D([], [], marker="o", color=MUTED, markerfacecolor="none", markersize=4, linestyle="", label="all scores"),
]
_FAILED = Line2D([], [], marker="x", color=VERMILLION, markeredgewidth=1.6, linestyle="", label="failed")
_CUT = Patch(facecolor="white", edgecolor=FRAME, hatch="///", linewidth=0.0, label="ruled out by constraints (hollow)")


def _draw(ax: Axes, line: Line) -> None:
    low, high = line.mean - Z95 * line.std, line.mean + Z95 * line.std
    if isinstance(line.parameter, Continuous):
        ax.fill_between(line.at, low, high, color=BLUE, alpha=0.17, linewidth=0)
        ax.plot(line.at, line.mean, color=BLUE, linewidth=2.0)
        if not line.allowed.all():
            ax.fill_between(
                line.at, 0.0, 1.0, where=(~line.allowed).tolist(), transform=ax.get_xaxis_transform(),
                facecolor="white", edgecolor=FRAME, hatch="///", linewidth=0.0, alpha=0.85, zorder=3,
            )  # fmt: skip
    else:
        for allowed, fill in ((line.allowed, BLUE), (~line.allowed, "white")):
            ax.errorbar(
                line.at[allowed], line.mean[allowed], Z95 * line.std[allowed], fmt="s", color=BLUE,
                markerfacecolor=fill, markersize=6, elinewidth=2.0, capsize=4,
            )  # fmt: skip
    ax.plot(line.tried, line.scores, "o", markerfacecolor="none", markeredgecolor=MUTED, markersize=3.6, alpha=0.75)
    if len(line.failed):  # what is not clipped takes part in the layout; an empty line would do so at (0, 0)
        ax.plot(
            line.failed, np.full(len(line.failed), 0.035), "x", color=VERMILLION, markersize=5.5, markeredgewidth=1.6,
            transform=ax.get_xaxis_transform(), clip_on=False, zorder=4,
        )  # fmt: skip
    ax.axvline(line.here, color=VERMILLION, linewidth=1.3)
    ax.axvline(line.nominal, color=INK, linewidth=1.1, linestyle=":")
    ax.set_xlim(-0.02, 1.02)
    parameter_ticks(ax, line.parameter)
