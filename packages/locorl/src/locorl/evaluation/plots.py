"""Pictures of evaluations and comparisons; they need matplotlib, which the extra `play` brings."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from locorl.evaluation.compare import Curve, mean_curve
from locorl.evaluation.evaluate import Evaluation
from locorl.evaluation.obstacles import ObstacleBin, success_by_obstacle
from locorl.evaluation.statistics import Estimate
from locorl.interfaces import Array

INK, MUTED, ACCENT, FAILED = "#1d2430", "#6b7480", "#0b7a75", "#1f4fd8"
LINES = ("#0b7a75", "#c8553d", "#3b5b92", "#b58900", "#8e4585", "#6b7480")
_GOOD_TO_BAD = LinearSegmentedColormap.from_list("error", ("#f3f1e4", "#f3d08c", "#e1904f", "#b4412f", "#641220"))


def save(figure: Figure, path: Path) -> None:
    """Write a PNG; a failure leaves what was there.

    Raises:
        ValueError: `path` does not end in .png.
        FileNotFoundError: its folder does not exist.
    """
    check_path(path)
    temporary = path.with_name(f".{path.name}.part")
    try:
        figure.savefig(temporary, format="png", dpi=120)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def check_path(path: Path) -> None:
    """Refuse a place for a picture before the work for it is done; raises as `save` does."""
    if path.suffix.lower() != ".png":
        raise ValueError(f"{path}: a picture is a .png file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")


@dataclass(frozen=True)
class _Plane:
    """Two coordinates of each body, (B,) each, and their names."""

    x: Array
    y: Array
    x_name: str
    y_name: str


def planes(designs: Array, names: Sequence[str]) -> list[_Plane]:
    """The planes in which bodies (B, d) with d > 1 are drawn.

    The four leg parameters become length against length (mean of thigh and shank, front against hind legs) and
    proportion against proportion (thigh minus shank): two pictures that hold all four numbers. Other parameters are
    drawn pair by pair.
    """
    if tuple(names) == ("front_thigh", "front_shank", "hind_thigh", "hind_shank"):
        thighs, shanks = designs[:, ::2], designs[:, 1::2]
        length, share = (thighs + shanks) / 2, thighs - shanks
        return [
            _Plane(
                length[:, 0], length[:, 1], "front leg: mean of thigh and shank", "hind leg: mean of thigh and shank"
            ),
            _Plane(share[:, 0], share[:, 1], "front leg: thigh minus shank", "hind leg: thigh minus shank"),
        ]
    columns = [(values, name.replace("_", " ")) for values, name in zip(designs.T, names, strict=True)]
    return [_Plane(x, y, x_name, y_name) for (x, x_name), (y, y_name) in itertools.combinations(columns, 2)]


def bodies_figure(result: Evaluation, names: Sequence[str]) -> Figure:
    """How each body did over the design space, and on a course success by obstacle size.

    The colour is the tracking error, and crosses mark bodies that fell; on a course it is the share of the body's
    robots that did not come through.

    Args:
        result: the evaluation.
        names: of the d design parameters.
    """
    failed = np.mean(~result.through, axis=1)
    if result.course is None:
        value, meaning = result.tracking_error.mean(axis=1), "tracking error, m/s"
        top = max(float(np.quantile(value, 0.95)), 1e-3)
    else:
        value, meaning, top = failed, "share of robots that did not come through", 1.0
    if len(names) == 1:
        views = [_Plane(result.designs[:, 0], value, names[0].replace("_", " "), meaning)]
    else:
        views = planes(result.designs, names)
    count = len(views) + (result.course is not None)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure((4.9 * columns + 0.9, 4.6 * rows), layout="constrained", facecolor="white")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    norm = Normalize(0.0, top)
    for ax, view in zip(axes, views, strict=False):
        _draw_bodies(ax, view, value, failed if result.course is None else np.zeros_like(failed), norm)
    for ax in axes[count:]:
        ax.set_axis_off()
    used = list(axes[: len(views)])
    extend = "max" if value.max() > top else "neither"
    bar = figure.colorbar(ScalarMappable(norm, _GOOD_TO_BAD), ax=used, shrink=0.75, pad=0.02, extend=extend)
    bar.set_label(meaning, color=MUTED, fontsize=9.5)
    bar.ax.tick_params(colors=MUTED, labelsize=8.5)
    bar.outline.set_visible(False)
    robots = result.command.size
    each = "" if robots == len(value) else f", {robots} robots"
    done = int(result.through.sum())
    word = f"{robots - done or 'none'} fell (×)" if result.course is None else f"{done} came through"
    figure.suptitle(f"{len(value)} bodies{each}: {word}", x=0.01, ha="left", color=INK, fontsize=11.5)
    if result.course is not None:
        _draw_success(axes[len(views)], success_by_obstacle(result))
    return figure


def _draw_bodies(ax: Axes, view: _Plane, value: Array, failed: Array, norm: Normalize) -> None:
    """Bodies as dots; those of a grid, which lie on one another, as tiles with their mean."""
    _plain(ax)
    place, at = np.unique(np.round(np.stack((view.x, view.y)), 6), axis=1, return_inverse=True)
    if place.shape[1] <= len(value) / 2:
        _draw_tiles(ax, place, at.ravel(), value, failed, norm)
    else:
        order = np.argsort(value)  # the worst on top
        x, y = view.x[order], view.y[order]
        ax.scatter(x, y, c=value[order], cmap=_GOOD_TO_BAD, norm=norm, s=62, edgecolor="#40484f", linewidth=0.5)
        x, y = view.x[failed > 0], view.y[failed > 0]
        ax.scatter(x, y, marker="x", s=95, color=FAILED, linewidth=1.8, zorder=3)
    ax.set_xlabel(view.x_name, color=MUTED, fontsize=9.5)
    ax.set_ylabel(view.y_name, color=MUTED, fontsize=9.5)


def _draw_tiles(ax: Axes, place: Array, at: np.ndarray, value: Array, failed: Array, norm: Normalize) -> None:
    """Means over the bodies `at` each of the k places (2, k), and how many of them failed."""
    bodies = np.bincount(at)
    mean, lost = np.bincount(at, weights=value) / bodies, np.bincount(at, weights=failed > 0)
    across, up = (min(np.diff(np.unique(line)), default=0.2) * 0.92 for line in place)
    for x, y, colour, gone, count in zip(*place, mean, lost, bodies, strict=True):
        low = (x - across / 2, y - up / 2)
        ax.add_patch(Rectangle(low, across, up, facecolor=_GOOD_TO_BAD(norm(colour)), edgecolor="none"))
        note = f"{colour:.2f}" + (f"\n× {gone:.0f} of {count}" if gone else "")
        ink = "white" if norm(colour) > 0.6 else INK
        ax.text(x, y, note, ha="center", va="center", fontsize=8.5, color=ink)
    ax.grid(visible=False)
    ax.set_xticks(np.unique(place[0]))
    ax.set_yticks(np.unique(place[1]))
    ax.set_xlim(place[0].min() - across * 0.6, place[0].max() + across * 0.6)
    ax.set_ylim(place[1].min() - up * 0.6, place[1].max() + up * 0.6)


def _draw_success(ax: Axes, bins: Sequence[ObstacleBin]) -> None:
    """Share of successes on each kind of course against obstacle size, with 95 % intervals."""
    _plain(ax)
    by_kind = itertools.groupby(bins, key=lambda each: each.kind)
    for (kind, group), colour in zip(by_kind, itertools.cycle(LINES), strict=False):
        own = list(group)
        middle, rate = [(each.low + each.high) / 2 for each in own], np.array([each.rate for each in own])
        low, high = np.array([each.interval for each in own]).T
        name = f"{kind.replace('_', ' ')}, {sum(each.robots for each in own)} robots"
        around = np.stack((rate - low, high - rate)).clip(min=0.0)
        ax.errorbar(middle, rate, around, color=colour, fmt="o-", markersize=4, capsize=3, label=name)
    ax.set_ylim(-0.04, 1.04)
    ax.set_xlim(min(each.low for each in bins), max(each.high for each in bins))
    ax.legend(frameon=False, fontsize=8.5, labelcolor=INK, loc="lower left")
    ax.set_xlabel("obstacle size, in hip heights of the robot's own body", color=MUTED, fontsize=9.5)
    ax.set_ylabel("share that reached the last waypoint", color=MUTED, fontsize=9.5)
    ax.set_title("success by obstacle size, 95 % intervals", color=INK, fontsize=10.5, loc="left")


def curves_figure(groups: Mapping[str, Sequence[Curve]], samples: float, metric: str) -> Figure:
    """Learning curves: mean over the runs of each group, band of one standard deviation, up to `samples` steps."""
    figure = Figure((7.2, 4.4), layout="constrained", facecolor="white")
    ax = figure.subplots()
    _plain(ax)
    for (name, curves), colour in zip(groups.items(), itertools.cycle(LINES), strict=False):
        grid, mean, deviation = mean_curve(curves, samples)
        x = grid / 1e6
        runs = f"{len(curves)} run{'s' if len(curves) > 1 else ''}"
        ax.plot(x, mean, color=colour, linewidth=1.8, label=f"{name} ({runs})")
        if len(curves) > 1:
            ax.fill_between(x, mean - deviation, mean + deviation, color=colour, alpha=0.18, linewidth=0)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("environment steps, millions", color=MUTED, fontsize=9.5)
    ax.set_ylabel(metric.replace("_", " "), color=MUTED, fontsize=9.5)
    ax.set_title("mean over runs, band: one standard deviation", color=INK, fontsize=10.5, loc="left")
    ax.legend(frameon=False, fontsize=9, labelcolor=INK)
    return figure


def finetune_figure(curve: Sequence[Mapping[str, float]], judged: Mapping[int, Estimate], chosen: int) -> Figure:
    """How a fine-tune went: reward while training, and returns of the evaluations in between with standard errors.

    Args:
        curve: metrics of each iteration.
        judged: iteration -> return.
        chosen: iteration of the policy that was kept.
    """
    figure = Figure((7.2, 4.4 if not judged else 6.4), layout="constrained", facecolor="white")
    axes = figure.subplots(2 if judged else 1, 1, sharex=True, squeeze=False).ravel()
    for ax in axes:
        _plain(ax)
    axes[0].plot([row["iteration"] for row in curve], [row["reward"] for row in curve], color=ACCENT, marker=".")
    axes[0].set_ylabel("reward while training, 1/s", color=MUTED, fontsize=9.5)
    if judged:
        steps, values = list(judged), list(judged.values())
        errors = [value.sem for value in values]
        axes[1].errorbar(steps, [value.mean for value in values], errors, color=LINES[2], fmt="o-", capsize=3)
        mean = judged[chosen].mean
        axes[1].scatter([chosen], [mean], s=130, facecolor="none", edgecolor=FAILED, linewidth=1.6, zorder=3)
        axes[1].annotate("kept", (chosen, mean), (9, 9), textcoords="offset points", color=FAILED)
        axes[1].margins(x=0.08, y=0.18)
        axes[1].set_ylabel("return (eq. 9), ± standard error", color=MUTED, fontsize=9.5)
    axes[-1].set_xlabel("iteration", color=MUTED, fontsize=9.5)
    return figure


def _plain(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(colors=MUTED, labelsize=9)
    ax.grid(color="#e7eaee", linewidth=0.8)
    ax.set_axisbelow(True)
    for spine in ax.spines.values():
        spine.set_color("#c9ced6")
