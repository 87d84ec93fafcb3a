"""Bodies in their stance, drawn to scale from the side with their dimensions; needs no OpenGL."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike

from morphgen.factory import BodyFactory
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.stance import Stance
from morphgen.views.scene import body_scene
from morphgen.views.shading import RIGHT_SIDE, Surface, shade, surface_of

MAX_COLUMNS = 3
_INK, _DIM, _FLOOR, _WARN = "#1d2430", "#5b6675", "#c9ced6", "#b3261e"
_MM = 1000.0
_WIDTH, _TITLE = 5.6, 0.7  # inches a picture, and for its title
_PIXELS, _PALE = 1120, 0.2  # of a shaded picture: its width, and how much white keeps dimensions legible on it
_REACH = 0.33  # how far a Go2 reaches from its centre, to which the distances of dimensions are tuned [m]


def draw_bodies(
    factory: BodyFactory,
    designs: ArrayLike,
    labels: Sequence[str] | None = None,
    *,
    max_columns: int = MAX_COLUMNS,
) -> Figure:
    """Draw bodies side by side at one scale, each in its stance, seen from the right (forward is right).

    A robot with visual meshes is shown shaded, one of primitives by their outlines. Lengths are those of the right
    legs, with their scales.

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
    bodies = [_Body.of(factory, design) for design in checked]
    unit = max(float(np.abs(body.joints[..., 0]).max()) for body in bodies) / _REACH
    x_limits, y_limits = _view(bodies, unit)
    height = _WIDTH * (y_limits[1] - y_limits[0]) / (x_limits[1] - x_limits[0]) + _TITLE
    figure = Figure((_WIDTH * columns, height * rows), dpi=150, facecolor="white", layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
        ax.set(aspect="equal", xlim=x_limits, ylim=y_limits)
    for ax, body, title in zip(axes, bodies, titles, strict=False):
        _draw_body(ax, factory, body, title, unit)
    return figure


@dataclass(frozen=True)
class _Body:
    """One body to draw.

    Attributes:
        design: (d,).
        skeleton: of the body (n = 1).
        stance: of the body (n = 1).
        joints: (4, 4, 2) hip, thigh, knee and foot centre in the picture [m].
        surface: None for a robot without visual meshes.
    """

    design: Array
    skeleton: Skeleton
    stance: Stance
    joints: Array
    surface: Surface | None

    @classmethod
    def of(cls, factory: BodyFactory, design: Array) -> _Body:
        skeleton, stance = factory.skeleton(design[None]), factory.stance(design[None])
        joints = forward_kinematics(skeleton, stance.joints).joint[0][:, :, [0, 2]] + (0, stance.base_height[0])
        meshes = any(shape.mesh is not None for shape in factory.robot.tree.shapes if not shape.collision)
        surface = surface_of(body_scene(factory, design)) if meshes else None
        return cls(design, skeleton, stance, joints, surface)


def _draw_body(ax: Axes, factory: BodyFactory, body: _Body, title: str, unit: float) -> None:
    stance = body.stance
    ax.axhspan(-0.012 * unit, 0, color=_FLOOR, lw=0, zorder=0)
    if body.surface is None:
        _draw_links(ax, factory, body.design)
    else:
        _draw_surface(ax, body.surface)
    length = body.skeleton.segment_length[0]
    scales = factory.space.morphology(body.design[None]).length[0]
    aside = (0.055, -0.045) if body.surface is None else (0.065, -0.06)
    for leg in (1, 3):
        _, thigh, knee, foot = body.joints[leg]
        for pivot in (thigh, knee):
            ax.add_patch(Circle(tuple(pivot), 0.009 * unit, fc="white", ec=_INK, lw=1.0, zorder=6))
        for part, (start, end) in enumerate(((thigh, knee), (knee, foot))):
            text = f"{length[leg, part] * _MM:.0f} mm\n×{scales[leg, part + 1]:.2f}"
            # the shank's dimension goes to the front of the leg, out of the thigh's way
            _dimension(ax, start, end, aside[part] * unit, text, unit, along=(0.5, 0.4)[part])
    hip, hind = body.joints[1, 1], body.joints[3, 1]
    top = _top(body, unit) + 0.02 * unit
    _dimension(ax, np.array([hind[0], top]), np.array([hip[0], top]), 0.0, f"{(hip[0] - hind[0]) * _MM:.0f} mm", unit)
    side = _side(body, unit) + 0.04 * unit
    height = f"{stance.hip_height[0] * _MM:.0f} mm"
    _dimension(ax, np.array([side, hip[1]]), np.array([side, 0.0]), 0.0, height, unit, label_right=True)
    line = {"color": _DIM, "lw": 0.6, "ls": (0, (4, 3)), "zorder": 1}
    ax.plot([hip[0] + 0.05 * unit, side + 0.01 * unit], [hip[1], hip[1]], **line)
    ax.set_title(title, color=_INK, fontsize=14, fontweight="bold", pad=10)
    note = f"{body.skeleton.total_mass[0]:.2f} kg"
    feasible = bool(stance.feasible[0])
    if not feasible:
        note += ", no sound level stance"
    ax.text(0, -0.05 * unit, note, ha="center", va="top", fontsize=10.5, color=_INK if feasible else _WARN)


def _draw_surface(ax: Axes, surface: Surface) -> None:
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    image = shade(surface, RIGHT_SIDE, np.array([left, bottom]), np.array([right, top]), _PIXELS)
    image[..., :3] = _PALE + (1 - _PALE) * image[..., :3]
    ax.imshow(image, extent=(left, right, bottom, top), zorder=3, interpolation="antialiased")


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


def _dimension(
    ax: Axes,
    start: Array,
    end: Array,
    offset: float,
    text: str,
    unit: float,
    *,
    along: float = 0.5,
    label_right: bool = False,
) -> None:
    """An arrow between two points, moved to the right of start -> end by an offset, its text a share `along` it."""
    direction = (end - start) / np.linalg.norm(end - start)
    aside = np.array([direction[1], -direction[0]])
    a, b = start + offset * aside, end + offset * aside
    if offset:
        for point, moved in ((start, a), (end, b)):
            ax.plot(*zip(point, moved + 0.15 * (moved - point), strict=True), color=_DIM, lw=0.5, zorder=1)
    arrow = {"arrowstyle": "<|-|>", "color": _DIM, "lw": 0.9, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    ax.annotate("", xy=tuple(b), xytext=tuple(a), arrowprops=arrow, zorder=7)
    middle = a + along * (b - a)
    if label_right:
        (x, y), anchor = middle + np.array([0.012 * unit, 0]), ("left", "center")
    elif offset:
        away = np.sign(offset) * aside
        (x, y) = middle + 0.012 * unit * away
        anchor = ("right" if away[0] < 0 else "left", "bottom" if away[1] > 0 else "top")
    else:
        (x, y), anchor = middle + np.array([0, 0.01 * unit]), ("center", "bottom")
    paper = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75}
    text_at = ax.text(x, y, text, ha=anchor[0], va=anchor[1], fontsize=9, color=_INK, linespacing=1.25)
    text_at.set(bbox=paper, zorder=8)


def _top(body: _Body, unit: float) -> float:
    """Height above everything that is drawn in the middle [m]."""
    top = float(body.stance.base_height[0]) + 0.11 * unit
    return top if body.surface is None else max(top, float(body.surface.triangles[..., 2].max()))


def _side(body: _Body, unit: float) -> float:
    """How far forward the drawing reaches [m]."""
    side = float(body.joints[..., 0].max()) + 0.08 * unit
    return side if body.surface is None else max(side, float(body.surface.triangles[..., 0].max()))


def _view(bodies: Sequence[_Body], unit: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of x and z that show every one of the bodies with its dimensions [m]."""
    back = [float(body.joints[..., 0].min()) - 0.12 * unit for body in bodies]
    back += [float(body.surface.triangles[..., 0].min()) for body in bodies if body.surface is not None]
    half = max(-min(back) + 0.08 * unit, max(_side(body, unit) for body in bodies) + 0.14 * unit)
    return (-half, half), (-0.1 * unit, max(_top(body, unit) for body in bodies) + 0.06 * unit)
