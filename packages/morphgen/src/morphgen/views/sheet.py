"""A contact sheet: small pictures of many bodies at one scale."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from morphgen.factory import BodyFactory
from morphgen.skeleton import Array
from morphgen.views.scene import body_scene
from morphgen.views.shading import THREE_QUARTER, Camera, bounds_of, shade, surface_of

MAX_COLUMNS = 8
_INK, _SOFT, _WARN, _PAPER = "#1d2430", "#5b6675", "#b3261e", "#fbeceb"
_WIDTH, _CAPTION, _HEADING = 2.1, 0.5, 0.4  # inches: a picture, its caption, the line on top
_PIXELS = 420  # width of the first body
_MARGIN = 0.03  # for soft shadows, as a share of the width
_FADE = 0.55  # white over a body that cannot stand
_MOST_VALUES = 4  # in a caption


def contact_sheet(
    factory: BodyFactory,
    designs: ArrayLike,
    captions: Sequence[str] | None = None,
    *,
    camera: Camera = THREE_QUARTER,
    max_columns: int = MAX_COLUMNS,
) -> Figure:
    """Draw many bodies in their stance, all at one scale; those without a sound stance are faded and say so.

    Args:
        factory: makes the bodies.
        designs: (n, d) designs, or one (d,).
        captions: n short texts; None for up to four design values, mass and hip height.
        camera: from where; `RIGHT_SIDE` shows the proportions of the legs best.
        max_columns: pictures in a row.

    Returns:
        A matplotlib figure, not registered with pyplot; `figure.savefig(path)` writes it.

    Raises:
        MorphologyError: a design is out of bounds.
    """
    checked = factory.space.validated(designs)
    texts = _captions(factory, checked) if captions is None else list(captions)
    if len(texts) != len(checked):
        raise ValueError(f"{len(checked)} designs need as many captions, got {len(texts)}")
    feasible = factory.feasible(checked)
    pictures = _pictures(factory, checked, camera)
    low = np.min([corner for _, corner, _ in pictures], axis=0)
    high = np.max([corner for _, _, corner in pictures], axis=0)
    rows = math.ceil(len(checked) / min(max_columns, math.ceil(math.sqrt(1.6 * len(checked)))))
    columns = math.ceil(len(checked) / rows)
    height = _WIDTH * (high[1] - low[1]) / (high[0] - low[0]) + _CAPTION
    figure = Figure((_WIDTH * columns, height * rows + _HEADING), dpi=150, facecolor="white", layout="constrained")
    figure.suptitle(_heading(factory, len(checked), captions is None), color=_SOFT, fontsize=9)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
        ax.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for ax, picture, text, sound in zip(axes, pictures, texts, feasible, strict=False):
        _draw(ax, *picture, text, bool(sound))
    return figure


def _pictures(factory: BodyFactory, designs: Array, camera: Camera) -> list[tuple[Array, Array, Array]]:
    """Picture of each body with its lower left and upper right corner [m], at one size of pixels."""
    pictures = []
    pixel = None
    for design in designs:
        surface = surface_of(body_scene(factory, design))
        low, high = bounds_of(surface, camera, shadow=True)
        margin = _MARGIN * (high[0] - low[0])
        low, high = low - margin, high + margin
        pixel = pixel or (high[0] - low[0]) / _PIXELS
        size = np.ceil((high - low) / pixel)
        high = low + size * pixel
        pictures.append((shade(surface, camera, low, high, int(size[0]), shadow=True), low, high))
    return pictures


def _draw(ax: Axes, image: Array, low: Array, high: Array, text: str, sound: bool) -> None:
    if not sound:
        image[..., :3] = _FADE + (1 - _FADE) * image[..., :3]
        text += "\nno sound level stance"
        ax.axhspan(*ax.get_ylim(), color=_PAPER, lw=0, zorder=0)
    ax.imshow(image, extent=(low[0], high[0], low[1], high[1]), interpolation="antialiased", zorder=1)
    place = {"transform": ax.transAxes, "ha": "center", "va": "top"}
    ax.text(0.5, -0.02, text, fontsize=7.5, linespacing=1.35, color=_INK if sound else _WARN, **place)


def _captions(factory: BodyFactory, designs: Array) -> list[str]:
    mass, height = factory.skeleton(designs).total_mass, factory.stance(designs).hip_height
    first = [
        "  ".join(f"{value:.2f}" for value in design) if len(design) <= _MOST_VALUES else f"body {i}"
        for i, design in enumerate(designs)
    ]
    return [f"{one}\n{m:.1f} kg,  {1000 * h:.0f} mm" for one, m, h in zip(first, mass, height, strict=True)]


def _heading(factory: BodyFactory, n: int, explain: bool) -> str:
    heading = f"{n} bodies of {factory.name}"
    if not explain:
        return heading
    named = factory.space.dim <= _MOST_VALUES
    parameters = ", ".join(name.replace("_", " ") for name in factory.space.names) + "; " if named else ""
    return f"{heading}: {parameters}mass, height of the hips"
