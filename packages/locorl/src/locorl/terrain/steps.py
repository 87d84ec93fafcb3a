"""Stairs with true vertical faces: up first, or down first, whichever way the robot leaves the middle."""

from __future__ import annotations

import numpy as np

from locorl.terrain.tile import Box, Tile, TileSize, either, grown, middle

TREAD = 0.31
"""Depth of a step, m."""
PLATFORM = 1.5
"""Half the side of the top of a pyramid, m."""
VALLEY = 1.25
"""Half the side of the floor inside a ring of stairs, m."""
BORDER = 0.2
"""Level ground left between the stairs and the edge of the tile, m."""
RIM = 0.6
"""Width of the top of a ring, m."""


def step_height(difficulty: float) -> float:
    """Height of one step, m: 0.05 + 0.18 d."""
    return grown(difficulty, 0.05, 0.18)


def steps_down(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """A pyramid of steps; the robot starts on its top."""
    height = step_height(difficulty)
    count = _count(min(size.length, size.width) / 2 - PLATFORM - BORDER, size)
    x, _ = middle(size)
    boxes = []
    for step in range(1, count + 1):
        # each box stands on the ground, so that no step rests on the edge of another
        half = PLATFORM + (count - step) * TREAD
        boxes.append(Box.between((x - half, -half, 0.0), (x + half, half, step * height)))
    return Tile(tuple(boxes), middle(size), obstacle=height)


def steps_up(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """A square ring with stairs inside and outside; the robot starts on the floor within."""
    height = step_height(difficulty)
    count = _count((min(size.length, size.width) / 2 - VALLEY - RIM - BORDER + 2 * TREAD) / 2, size)
    boxes = []
    for step in range(1, count + 1):
        inner = VALLEY + (step - 1) * TREAD
        outer = VALLEY + RIM + (2 * count - 1 - step) * TREAD
        boxes += _ring(size, inner, outer, step * height)
    return Tile(tuple(boxes), middle(size), obstacle=height)


steps = either(steps_up, steps_down)


def _count(run: float, size: TileSize) -> int:
    count = int(run / TREAD + 1e-9)
    if count < 1:
        raise ValueError(f"stairs do not fit into a tile of {size.length} x {size.width} m; make it 8 x 8 m")
    return count


def _ring(size: TileSize, inner: float, outer: float, height: float) -> list[Box]:
    """Four boxes between the squares of half sides `inner` and `outer` around the middle."""
    x, _ = middle(size)
    return [
        Box.between((x - outer, -outer, 0.0), (x - inner, outer, height)),
        Box.between((x + inner, -outer, 0.0), (x + outer, outer, height)),
        Box.between((x - inner, -outer, 0.0), (x + inner, -inner, height)),
        Box.between((x - inner, inner, 0.0), (x + inner, outer, height)),
    ]
