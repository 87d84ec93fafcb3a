"""Bodies in their stance, drawn to scale from the side with their dimensions; needs no OpenGL."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike

from morphgen.factory import BodyFactory
from morphgen.skeleton import Array
from morphgen.stance.kinematics import forward_kinematics

MAX_COLUMNS = 3
_INK, _DIM, _FLOOR, _WARN = "#1d2430", "#5b6675", "#c9ced6", "#b3261e"
_MM = 1000.0
_WIDTH, _TITLE = 5.6, 0.7  # inches a picture, and for its title


def draw_bodies(
    factory: BodyFactory,
    designs: ArrayLike,
    labels: Sequence[str] | None = None,
    *,
    max_columns: int = MAX_COLUMNS,
) -> Figure:
    """Draw bodies side by side at one scale, each in its stance, seen from the right (forward is right).

    Args:
        factory: makes the bodies.
        designs: (n, d) designs, or one (d,).
        labels: n titles; None for numbers.
        max_columns: pictures in a row.

    Returns:
        A matplotlib figure, not registered with pyplot; `figure.savefig(path)` writes it.
    """
    checked = factory.space.validated(designs)
    titles = [f"body {i}" for i in range(len(checked))] if labels is None else list(labels)
    if len(titles) != len(checked):
        raise ValueError(f"{len(checked)} designs need as many labels, got {len(titles)}")
    columns = min(len(checked), max_columns)
    rows = math.ceil(len(checked) / columns)
    x_limits, y_limits = _view(factory, checked)
    height = _WIDTH * (y_limits[1] - y_limits[0]) / (x_limits[1] - x_limits[0]) + _TITLE
    figure = Figure((_WIDTH * columns, height * rows), dpi=150, facecolor="white", layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
        ax.set(aspect="equal", xlim=x_limits, ylim=y_limits)
    for ax, design, title in zip(axes, checked, titles, strict=False):
        _draw_body(ax, factory, design, title)
    return figure


def _draw_body(ax: Axes, factory: BodyFactory, design: Array, title: str) -> None:
    body, stance = factory.skeleton(design[None]), factory.stance(design[None])
    z = float(stance.base_height[0])
    ax.axhspan(-0.012, 0, color=_FLOOR, lw=0, zorder=0)
    _draw_links(ax, factory, design)
    joint = forward_kinematics(body, stance.joints).joint[0][:, :, [0, 2]] + (0, z)
    length = body.segment_length[0]
    for leg, pair in ((1, "front"), (3, "hind")):
        _, thigh, knee, foot = joint[leg]
        for pivot in (thigh, knee):
            ax.add_patch(Circle(tuple(pivot), 0.009, fc="white", ec=_INK, lw=1.0, zorder=6))
        for part, (start, end) in enumerate(((thigh, knee), (knee, foot))):
            name = f"{pair}_{('thigh', 'shank')[part]}"
            scale = design[factory.space.names.index(name)]
            text = f"{length[leg, part] * _MM:.0f} mm\n×{scale:.2f}"
            # the shank's dimension goes to the inside of the knee, where it stays above the floor
            _dimension(ax, start, end, (0.055, -0.045)[part], text)
    hip, hind = joint[1, 1], joint[3, 1]
    top = z + 0.13
    _dimension(ax, np.array([hind[0], top]), np.array([hip[0], top]), 0.0, f"{(hip[0] - hind[0]) * _MM:.0f} mm")
    side = max(hip[0], joint[1, 3, 0]) + 0.12
    height = f"{stance.hip_height[0] * _MM:.0f} mm"
    _dimension(ax, np.array([side, hip[1]]), np.array([side, 0.0]), 0.0, height, label_right=True)
    ax.plot([hip[0] + 0.05, side + 0.01], [hip[1], hip[1]], color=_DIM, lw=0.6, ls=(0, (4, 3)), zorder=1)
    ax.set_title(title, color=_INK, fontsize=14, fontweight="bold", pad=10)
    note = f"{body.total_mass[0]:.2f} kg"
    feasible = bool(stance.feasible[0])
    if not feasible:
        note += ", no sound level stance"
    ax.text(0, -0.05, note, ha="center", va="top", fontsize=10.5, color=_INK if feasible else _WARN)


def _draw_links(ax: Axes, factory: BodyFactory, design: Array) -> None:
    """Outlines of all collision geoms of the compiled body, far ones first."""
    batch = factory.batch(design[None])
    model = factory.spec(design).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = batch.stance_qpos[0]
    mujoco.mj_kinematics(model, data)
    tint = {factory.layout.base: 0.82} | dict.fromkeys(factory.layout.links[1::3], 0.6)
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] != 0]
    for geom in sorted(geoms, key=lambda g: -data.geom_xpos[g, 1]):
        points = _surface(model.geom_type[geom], model.geom_size[geom])
        if points is None:
            continue
        placed = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        # dimensions lie over trunk and hips, so these are drawn in a light shade
        white = tint.get(model.body(model.geom_bodyid[geom]).name, 0.0)
        color = tuple(white + (1 - white) * model.geom_rgba[geom][:3])
        outline = _convex_hull(placed[:, [0, 2]])
        ax.add_patch(Polygon(outline, closed=True, fc=color, ec=_INK, lw=0.9, joinstyle="round", zorder=3))


def _surface(kind: int, size: Array) -> Array | None:
    """Points whose convex hull is the primitive, in its own frame; None for other geoms."""
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    corners = np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3)
    ball = np.concatenate([ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]]) * size[0]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return corners * size
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return ball
    ends = np.array([[0, 0, 1], [0, 0, -1]])[:, None] * size[1]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return (ring * size[0] + ends).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return (ball + ends).reshape(-1, 3)
    return None


def _convex_hull(points: Array) -> Array:
    """Corners of the convex hull of plane points (n, 2), counter-clockwise (Andrew's monotone chain)."""

    def chain(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
        hull: list[tuple[float, float]] = []
        for x, y in ordered:
            while len(hull) > 1 and (hull[-1][0] - hull[-2][0]) * (y - hull[-2][1]) <= (hull[-1][1] - hull[-2][1]) * (
                x - hull[-2][0]
            ):
                hull.pop()
            hull.append((x, y))
        return hull[:-1]

    ordered = sorted({(float(x), float(y)) for x, y in points})
    return np.array(chain(ordered) + chain(ordered[::-1]))


def _dimension(ax: Axes, start: Array, end: Array, offset: float, text: str, *, label_right: bool = False) -> None:
    """An arrow between two points, moved aside by an offset (to the right of start -> end), with its text."""
    along = (end - start) / np.linalg.norm(end - start)
    aside = np.array([along[1], -along[0]])
    a, b = start + offset * aside, end + offset * aside
    if offset:
        for point, moved in ((start, a), (end, b)):
            ax.plot(*zip(point, moved + 0.15 * (moved - point), strict=True), color=_DIM, lw=0.5, zorder=1)
    arrow = {"arrowstyle": "<|-|>", "color": _DIM, "lw": 0.9, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    ax.annotate("", xy=tuple(b), xytext=tuple(a), arrowprops=arrow, zorder=7)
    middle = (a + b) / 2
    if label_right:
        (x, y), anchor = middle + np.array([0.012, 0]), ("left", "center")
    elif offset:
        away = np.sign(offset) * aside
        (x, y) = middle + 0.012 * away
        anchor = ("right" if away[0] < 0 else "left", "bottom" if away[1] > 0 else "top")
    else:
        (x, y), anchor = middle + np.array([0, 0.01]), ("center", "bottom")
    paper = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75}
    text_at = ax.text(x, y, text, ha=anchor[0], va=anchor[1], fontsize=9, color=_INK, linespacing=1.25)
    text_at.set(bbox=paper, zorder=8)


def _view(factory: BodyFactory, designs: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of x and z that show every one of the designs with its dimensions [m]."""
    bodies, stance = factory.skeleton(designs), factory.stance(designs)
    joints = forward_kinematics(bodies, stance.joints).joint
    half = max(-joints[..., 0].min() + 0.2, joints[..., 0].max() + 0.22)
    return (-half, half), (-0.1, float(stance.base_height.max()) + 0.17)
