"""One look for all figures: light, plain, and legible with any colour vision."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.container import Container
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, LogLocator, MaxNLocator, NullFormatter, NullLocator

from codesign_bo.records import AttemptStatus
from codesign_bo.space import AnyParameter, Array, Categorical, Continuous, Integer

INK, MUTED, GRID, FRAME = "#1d2430", "#59616d", "#e7eaee", "#c9ced6"
BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9"
"""From the palette of Okabe and Ito (2008), which people with any colour vision can tell apart."""

MEAN_MAP, SPREAD_MAP = "viridis", "Greys"

Z95 = 1.959964


@dataclass(frozen=True)
class Look:
    """How an outcome is drawn.

    Attributes:
        colour: Of bars and marks.
        marker: Of points; every kind of failure has its own.
        hatch: Of bars.
    """

    colour: str
    marker: str = "x"
    hatch: str = ""


OUTCOMES: dict[AttemptStatus, Look] = {
    "ok": Look(GREEN, "o"),
    "stopped": Look(SKY, "v"),
    "infeasible": Look(PURPLE, "x"),
    "crash": Look(VERMILLION, "X"),
    "timeout": Look(ORANGE, "s"),
    "diverged": Look("#f0e442", "D"),
    "lost": Look("#3b4250", "*"),
    "running": Look(BLUE, "o", "///"),
    "interrupted": Look("#c4c9d1", "o"),
    "superseded": Look("#9aa2ae", "o", "..."),
}
"""Look of each state of an attempt."""


@dataclass(frozen=True)
class Labels:
    """What the axes say.

    Attributes:
        objective: Name of the objective, with its unit if it has one.
        units: Units of parameters and further objectives, by name.
    """

    objective: str = "objective"
    units: Mapping[str, str] = field(default_factory=dict)

    def __call__(self, name: str) -> str:
        """Return a name with its unit."""
        unit = self.units.get(name, "")
        return f"{name} ({unit})" if unit else name


PLAIN = Labels()
"""No units, and the objective is called objective."""


def figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure of `width` x `height` inches with plain axes, row by row; pyplot does not know it."""
    made = Figure((width, height), dpi=110, layout="constrained", facecolor="white")
    axes = list(made.subplots(rows, columns, squeeze=False).ravel())
    for ax in axes:
        plain(ax)
    return made, axes


def plain(ax: Axes) -> None:
    """Take away what carries no information."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(colors=MUTED, labelsize=9)
    ax.grid(color=GRID, linewidth=0.8)
    ax.set_axisbelow(True)
    for spine in ax.spines.values():
        spine.set_color(FRAME)


def label(ax: Axes, x: str = "", y: str = "", title: str = "") -> None:
    """Name the axes; names are shown as they are, dollar signs too."""
    ax.set_xlabel(x, color=INK, fontsize=9.5, parse_math=False)
    ax.set_ylabel(y, color=INK, fontsize=9.5, parse_math=False)
    if title:
        ax.set_title(title, color=INK, fontsize=10.5, loc="left", parse_math=False)


def headline(made: Figure, text: str) -> None:
    """Write some words above all axes, in as many lines as they need."""
    lines = textwrap.wrap(text, max(int(12.0 * made.get_figwidth()), 30))
    made.suptitle("\n".join(lines), x=0.01, ha="left", color=INK, fontsize=11, parse_math=False)


Handle = Artist | Container
"""What a legend takes."""


def legend(made: Figure, handles: Sequence[Handle], columns: int = 3) -> None:
    """Draw a legend below all axes, where it hides nothing; the labels are those of the handles."""
    if handles:
        drawn = made.legend(
            handles=cast(list[Artist], list(handles)),
            loc="outside lower left",
            ncols=columns,
            frameon=False,
            fontsize=9,
            labelcolor=INK,
        )
        for text in drawn.get_texts():
            text.set_parse_math(False)


def integer_axis(ax: Axes) -> None:
    """Put the ticks of the x axis at whole numbers."""
    ax.xaxis.set_major_locator(MaxNLocator("auto", integer=True, min_n_ticks=1))


# --- axes of parameters ---------------------------------------------------------------------------------


def levels(parameter: AnyParameter, n: int) -> Array:
    """Return unit coordinates (m,) of levels of a parameter: n from bound to bound, or all if it has fewer."""
    if isinstance(parameter, Continuous):
        return np.linspace(0.0, 1.0, n)
    chosen = np.arange(parameter.count)
    if isinstance(parameter, Integer) and parameter.count > n:
        chosen = np.unique(np.round(np.linspace(0, parameter.count - 1, n)).astype(int))
    return (chosen + 0.5) / parameter.count


def value_text(parameter: AnyParameter, unit: float) -> str:
    """Return the value at a unit coordinate in words."""
    value = parameter.decode(float(parameter.from_unit(np.array([unit]))[0]))
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 14 else f"{text[:13]}…"


def parameter_ticks(ax: Axes, parameter: AnyParameter, axis: str = "x", n: int = 5) -> None:
    """Label an axis that runs over the unit coordinate of a parameter with its values."""
    at = _nice(parameter, n) if isinstance(parameter, Continuous) else levels(parameter, n)
    target = ax.xaxis if axis == "x" else ax.yaxis
    target.set_major_locator(FixedLocator(at.tolist()))
    target.set_major_formatter(FixedFormatter([value_text(parameter, u) for u in at]))
    target.set_minor_locator(NullLocator())
    target.set_minor_formatter(NullFormatter())
    for text in target.get_ticklabels():
        text.set_parse_math(False)
    longest = max((len(value_text(parameter, u)) for u in at), default=0)
    if isinstance(parameter, Categorical) and axis == "x" and longest * len(at) > 30:
        ax.tick_params(axis="x", labelrotation=30)


def _nice(parameter: Continuous, n: int) -> Array:
    """Return unit coordinates of round values within the bounds, about n."""
    locator = LogLocator(numticks=n) if parameter.log else MaxNLocator(n - 1, steps=[1, 2, 2.5, 5, 10])
    margin = 1e-9 * (parameter.high - parameter.low)
    values = np.asarray(locator.tick_values(parameter.low, parameter.high))
    inside = values[(values >= parameter.low - margin) & (values <= parameter.high + margin)]
    return parameter.to_unit(inside) if len(inside) > 1 else levels(parameter, 3)


def show_design(params: Mapping[str, object]) -> str:
    """Return a design in few words."""
    words = (f"{n} = {v:.3g}" if isinstance(v, float) else f"{n} = {v}" for n, v in params.items())
    return ", ".join(word.replace(" ", "\N{NO-BREAK SPACE}") for word in words)
