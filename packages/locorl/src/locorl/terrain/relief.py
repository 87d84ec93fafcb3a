"""Smooth ground: flat, hills, slopes."""

from __future__ import annotations

import numpy as np

from locorl.interfaces import Array
from locorl.terrain.tile import Relief, Tile, TileSize, either, grown, middle

PLATFORM = 1.6
"""Half the side of the level square in the middle of a slope, m."""


def flat(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """Level ground; with the difficulty nothing changes."""
    return Tile(start=middle(size))


def hills(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """Hills and hollows of +-(0.05 + 0.2 d) m every 1.5 m or so, under roughness of +-(0.01 + 0.02 d) m.

    The start and the border of the tile are level.
    """
    amplitude, roughness = grown(difficulty, 0.05, 0.2), grown(difficulty, 0.01, 0.02)
    swell = value_noise(rng, size, spacing=1.5, smooth=True)
    grain = value_noise(rng, size, spacing=0.2, smooth=False)

    def relief(x: Array, y: Array) -> Array:
        border = np.minimum(np.minimum(x, size.length - x), size.width / 2 - np.abs(y))
        start = np.maximum(np.abs(x - size.length / 2), np.abs(y)) - 0.4
        fade = np.clip(border, 0.0, 1.0) * np.clip(start, 0.0, 1.0)
        return fade * (amplitude * swell(x, y) + roughness * grain(x, y))

    return Tile(start=middle(size), relief=relief, obstacle=amplitude + roughness)


def slope_up(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """A hollow: from its level bottom in the middle, the ground rises by 0.4 d m per m to the border."""
    return _pyramid(difficulty, size, hollow=True)


def slope_down(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """A pyramid: from the level top in the middle, the ground falls by 0.4 d m per m to the border."""
    return _pyramid(difficulty, size, hollow=False)


slope = either(slope_up, slope_down)


def _pyramid(difficulty: float, size: TileSize, hollow: bool) -> Tile:
    run = min(size.length, size.width) / 2 - PLATFORM
    if run <= 0:
        raise ValueError(f"a slope needs a tile of more than {2 * PLATFORM} m each way, got {size}")
    rise = 0.4 * max(difficulty, 0.0) * run

    def relief(x: Array, y: Array) -> Array:
        border = np.minimum(np.minimum(x, size.length - x), size.width / 2 - np.abs(y))
        height = rise * np.clip(border / run, 0.0, 1.0)
        return -height if hollow else height

    return Tile(start=middle(size), relief=relief, obstacle=rise)


def value_noise(rng: np.random.Generator, size: TileSize, spacing: float, smooth: bool) -> Relief:
    """Random heights in [-1, 1] every `spacing` m, joined by straight or by smooth (level at the nodes) flanks."""
    shape = (int(np.ceil(size.length / spacing)) + 1, int(np.ceil(size.width / spacing)) + 1)
    nodes = rng.uniform(-1.0, 1.0, shape)

    def noise(x: Array, y: Array) -> Array:
        u, v = x / spacing, (y + size.width / 2) / spacing
        i = np.clip(u.astype(int), 0, shape[0] - 2)
        j = np.clip(v.astype(int), 0, shape[1] - 2)
        u, v = u - i, v - j
        if smooth:
            u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
        near = nodes[i, j] * (1 - v) + nodes[i, j + 1] * v
        far = nodes[i + 1, j] * (1 - v) + nodes[i + 1, j + 1] * v
        return near * (1 - u) + far * u

    return noise
