"""Two parameters at a time: the posterior over a plane through the recommended design, and how planes are drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from codesign_bo.plots.picture import NothingToShowError, unit_points
from codesign_bo.plots.style import FRAME, INK, MUTED, VERMILLION, levels
from codesign_bo.sensitivity import posterior_indices
from codesign_bo.space import AnyParameter, Array, Value
from codesign_bo.view import StudyView

FINE = 41
"""Points along each edge of a fine plane."""


@dataclass(frozen=True)
class Plane:
    """The posterior over two parameters, the others held.

    Attributes:
        x: Parameter across.
        y: Parameter upwards.
        across: Unit coordinates (n,) of the columns.
        upwards: Unit coordinates (m,) of the rows.
        mean: Posterior mean (m, n).
        std: Posterior standard deviation (m, n).
        allowed: Whether the linear constraints allow the design (m, n).
    """

    x: AnyParameter
    y: AnyParameter
    across: Array
    upwards: Array
    mean: Array
    std: Array
    allowed: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Marks:
    """Designs to be marked, as unit coordinates.

    Attributes:
        here: Recommended design (dim,).
        nominal: Nominal design (dim,).
        tried: Designs with a score (n, dim).
        failed: Designs that failed (k, dim).
    """

    here: Array
    nominal: Array
    tried: Array
    failed: Array


def marks_of(view: StudyView) -> tuple[Marks, Mapping[str, Value]]:
    """Return the designs to be marked, and the recommended design."""
    if view.space.dim < 2:
        raise NothingToShowError("the space has only one free parameter; the slice shows it")
    trials = view.trials()
    if sum(t.ok for t in trials) < 2:
        raise NothingToShowError("fewer than 2 trials have a score")
    found = view.recommend()
    here, nominal = unit_points(view, [found.params, view.space.nominal])
    tried = unit_points(view, [t.params for t in trials if t.ok])
    failed = unit_points(view, [t.params for t in trials if t.failed])
    return Marks(here, nominal, tried, failed), dict(found.params)


def most_influential(view: StudyView, n: int) -> list[int]:
    """Return which n free parameters have the highest total Sobol indices, the highest first."""
    _, total = posterior_indices(view, view.surrogate())
    return np.argsort(-total, kind="stable")[:n].tolist()


def plane_of(view: StudyView, here: Array, x: int, y: int, n: int) -> Plane:
    """Return the posterior at n levels of each of two free parameters, the others as in the point `here` (dim,)."""
    free = view.space.free
    across, upwards = levels(free[x], n), levels(free[y], n)
    points = np.tile(here, (len(upwards), len(across), 1))
    points[:, :, x] = across[None, :]
    points[:, :, y] = upwards[:, None]
    flat = points.reshape(-1, view.space.dim)
    parts = [view.surrogate().predict(block) for block in np.array_split(flat, -(-len(flat) // 512))]
    mean, std = (np.concatenate(each).reshape(points.shape[:2]) for each in zip(*parts, strict=True))
    allowed = view.space.satisfied(view.space.from_unit(flat)).reshape(points.shape[:2])
    return Plane(free[x], free[y], across, upwards, mean, std, allowed)


def transposed(p: Plane) -> Plane:
    """Return a plane with its axes swapped."""
    return Plane(p.y, p.x, p.upwards, p.across, p.mean.T, p.std.T, p.allowed.T)


def colour_scale(values: Array, low: float | None = None) -> Normalize:
    """Return the colour scale of some values, never of zero width."""
    if not values.size:
        return Normalize(0.0, 1.0)
    least, most = float(values.min()) if low is None else low, float(values.max())
    if most - least > 1e-9 * max(1.0, abs(most)):
        return Normalize(least, most)
    return Normalize(least - (0.5 if low is None else 0.0), least + 0.5)


def draw_field(ax: Axes, plane: Plane, values: Array, norm: Normalize, colours: str) -> None:
    """Draw values over the unit square; what the linear constraints rule out is hatched."""
    ax.grid(visible=False)
    ax.add_patch(
        Rectangle((0, 0), 1, 1, transform=ax.transAxes, facecolor="white", edgecolor=FRAME, hatch="///", zorder=0)
    )
    shown = np.ma.masked_array(values, mask=~plane.allowed)
    edges = [_edges(p, at) for p, at in ((plane.x, plane.across), (plane.y, plane.upwards))]
    ax.pcolormesh(*edges, shown, cmap=colours, norm=norm, rasterized=True)
    ax.set_xlim(0.0, 1.0)
    ax.set_ylim(0.0, 1.0)


def _edges(parameter: AnyParameter, at: Array) -> Array:
    """Return the borders of cells around unit coordinates: halfway, and the bounds of the unit interval."""
    between = (at[1:] + at[:-1]) / 2.0
    return np.concatenate([[0.0], between, [1.0]])


def draw_marks(ax: Axes, marks: Marks, x: int, y: int, small: bool = False) -> None:
    """Mark designs: a star is recommended, a diamond nominal, rings were tried, crosses failed."""
    size = 3.2 if small else 5.0
    ring = {"markerfacecolor": "white", "markeredgecolor": INK, "clip_on": False}
    cross = {"color": VERMILLION, "markeredgewidth": 1.8, "clip_on": False}
    star = {"markerfacecolor": VERMILLION, "markeredgecolor": "white", "markeredgewidth": 0.8, "clip_on": False}
    ax.plot(marks.tried[:, x], marks.tried[:, y], "o", markersize=size, markeredgewidth=0.7, **ring)
    if len(marks.failed):  # what is not clipped takes part in the layout; an empty line would do so at (0, 0)
        ax.plot(marks.failed[:, x], marks.failed[:, y], "x", markersize=size + 2, **cross)
    ax.plot(*marks.nominal[[x, y]], "D", markersize=size + 2, markeredgewidth=1.2, **ring)
    ax.plot(*marks.here[[x, y]], "*", markersize=size + 8, **star)


def colour_bar(made: Figure, axes: Axes | list[Axes], norm: Normalize, colours: str, words: str) -> None:
    """Draw the scale of some colours beside axes."""
    bar = made.colorbar(ScalarMappable(norm, colours), ax=axes, pad=0.02, shrink=0.85, aspect=28)
    bar.set_label(words, color=INK, fontsize=9.5, parse_math=False)
    bar.ax.tick_params(colors=MUTED, labelsize=8.5)
    bar.outline.set_visible(False)
