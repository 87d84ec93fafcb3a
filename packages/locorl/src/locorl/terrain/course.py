"""What the parkour courses share: the run-up, six obstacles, the waypoints and the way out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from locorl.terrain.tile import PIT, Box, Tile, TileSize

OBSTACLES = 6
RUN_UP = 2.5
"""Length of the level ground before the first obstacle, m."""
OFFSET = 0.4
"""Obstacles lie up to this far to the left or right of the middle line, m."""
_START, _FIRST, _LAST = 1.0, 2.0, 1.5


def course(
    size: TileSize,
    boxes: Sequence[Box],
    points: Sequence[tuple[float, float]],
    end: float,
    obstacle: float,
    floor: bool = True,
) -> Tile:
    """A tile with a start, a first waypoint on the run-up, one per obstacle, and a last one straight on behind them.

    The last one marks no place that a camera could see, so it lies where the last obstacle leads to.

    Args:
        size: of the tile.
        boxes: the obstacles.
        points: waypoint of each obstacle, (x, y), m.
        end: where the last obstacle ends, x, m.
        obstacle: size of the obstacles, m.
        floor: as in `Tile`; without it, the run-up and the ground behind `end` are added to the boxes.

    Raises:
        ValueError: the course is longer than the tile.
    """
    if end + _LAST > size.length or size.width < 4 * OFFSET:
        raise ValueError(
            f"a course of {end + _LAST:.1f} m does not fit into a tile of {size.length} x {size.width} m; "
            "parkour needs tiles of 18 x 4 m"
        )
    if not floor:
        boxes = (slab(0.0, RUN_UP, size), *boxes, slab(end, size.length, size))
    waypoints = np.array([(_FIRST, 0.0), *points, (end + _LAST, points[-1][1])])
    return Tile(tuple(boxes), (_START, 0.0), waypoints, floor=floor, obstacle=obstacle)


def slab(near: float, far: float, size: TileSize, height: float = 0.0) -> Box:
    """Ground at `height` from `near` to `far`, m, over the full width of the tile, down to the floor of a pit."""
    return Box.between((near, -size.width / 2, -PIT), (far, size.width / 2, height))
