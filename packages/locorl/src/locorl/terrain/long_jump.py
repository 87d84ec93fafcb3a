"""Long jump: gaps between ledges over a pit."""

from __future__ import annotations

import numpy as np

from locorl.terrain.course import OBSTACLES, OFFSET, RUN_UP, course, slab
from locorl.terrain.tile import PIT, Box, Tile, TileSize, grown

_NARROW = 0.1
"""Width of the narrowest gap, m; feet get stuck in narrower ones."""


def long_jump(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """Six gaps of 0.1 + 0.7 d m between ledges 0.8 to 1.5 m long and 1.2 to 2.4 m wide.

    Waypoints lie in the middle of the ledges; the last obstacle's lies behind its gap. Below difficulty 0 the gaps are
    ditches 0.1 m wide and 0.1 (1 + d) m deep, and their depth is the obstacle's size.
    """
    gap, half_width = _NARROW + 0.7 * max(difficulty, 0.0), rng.uniform(0.6, 1.2)
    lengths = rng.uniform(0.8, 1.5, OBSTACLES - 1)
    y = rng.uniform(-OFFSET, OFFSET, OBSTACLES - 1)
    starts = RUN_UP + gap + np.concatenate(([0.0], np.cumsum(lengths + gap)))
    boxes = [
        Box.between((near, b - half_width, -PIT), (near + length, b + half_width, 0.0))
        for near, length, b in zip(starts[:-1], lengths, y, strict=True)
    ]
    obstacle = gap
    if difficulty < 0.0:
        obstacle = grown(difficulty, 0.1, 0.0)
        boxes += [slab(near - gap, near, size, -obstacle) for near in starts]
    landing = float(starts[-1])
    points = [*zip(starts[:-1] + lengths / 2, y, strict=True), (landing + 0.4, 0.0)]
    return course(size, boxes, points, landing, obstacle, floor=False)
