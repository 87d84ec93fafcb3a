"""High jump: hurdles to clear, and platforms to climb."""

from __future__ import annotations

import numpy as np

from locorl.terrain.course import OBSTACLES, OFFSET, RUN_UP, course
from locorl.terrain.tile import Box, Tile, TileSize, either, grown

_PROFILE = (1, 2, 3, 3, 2, 1)
"""Height of each platform in steps: three up, one level, two down."""


def hurdles(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """Six hurdles, 0.1 + 0.3 d m deep and U(0.1 + 0.1 d, 0.15 + 0.25 d) m high, every 1.2 to 2.2 m.

    The floor goes on beside them; waypoints lie on top of them.
    """
    depth, half_width = 0.1 + 0.3 * max(difficulty, 0.0), rng.uniform(0.4, 0.8)
    heights = rng.uniform(grown(difficulty, 0.1, 0.1), grown(difficulty, 0.15, 0.25), OBSTACLES)
    # the first stands within its spacing, so that no robot starts against it
    x = RUN_UP + np.cumsum(rng.uniform(1.2, 2.2, OBSTACLES))
    y = rng.uniform(-OFFSET, OFFSET, OBSTACLES)
    boxes = [
        Box.between((a - depth / 2, b - half_width, 0.0), (a + depth / 2, b + half_width, height))
        for a, b, height in zip(x, y, heights, strict=True)
    ]
    points = list(zip(x, y, strict=True))
    return course(size, boxes, points, float(x[-1] + depth / 2), float(heights.max()))


def platforms(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """Six platforms in steps of h = 0.1 + 0.35 d m, three up, one level, two down, each U(0.3, 1.5) + h m long."""
    height, half_width = grown(difficulty, 0.1, 0.35), rng.uniform(0.5, 1.0)
    ends = RUN_UP + np.cumsum(rng.uniform(0.3, 1.5, OBSTACLES) + height)
    starts = np.concatenate(([RUN_UP], ends[:-1]))
    y = rng.uniform(-OFFSET, OFFSET, OBSTACLES)
    boxes = [
        Box.between((near, b - half_width, 0.0), (far, b + half_width, steps * height))
        for near, far, b, steps in zip(starts, ends, y, _PROFILE, strict=True)
    ]
    points = list(zip((starts + ends) / 2, y, strict=True))
    return course(size, boxes, points, float(ends[-1]), height)


high_jump = either(hurdles, platforms)
