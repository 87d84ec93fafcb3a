"""Tilted stones: stepping stones that lean to the left and to the right by turns."""

from __future__ import annotations

import math

import numpy as np

from locorl.terrain.course import OBSTACLES, RUN_UP, course
from locorl.terrain.tile import PIT, Box, Tile, TileSize, grown

LENGTH, WIDTH = 0.9, 1.0
"""Extent of a stone, m."""


def tilted_stones(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
    """Six stones over a pit, U(-0.1, 0.1 + 0.3 d) m apart, rising by 0.25 d m across their width of 1 m.

    They stand 0.1 to 0.3 m to the left and to the right by turns, their upper sides on the outside.
    """
    widest = grown(difficulty, 0.1, 0.3)
    gaps = rng.uniform(-0.1, widest, OBSTACLES + 1)
    side = np.resize((1.0, -1.0), OBSTACLES) * rng.choice((1.0, -1.0))
    y = side * rng.uniform(0.1, 0.3, OBSTACLES)
    x = RUN_UP + LENGTH / 2 + gaps[0] + np.concatenate(([0.0], np.cumsum(LENGTH + gaps[1:-1])))
    tilt = math.atan(0.25 * max(difficulty, 0.0) / WIDTH)
    boxes = [_stone(a, b, float(turn * tilt)) for a, b, turn in zip(x, y, side, strict=True)]
    end = float(x[-1] + LENGTH / 2 + gaps[-1])
    points = list(zip(x, y, strict=True))
    return course(size, boxes, points, end, widest, floor=False)


def _stone(x: float, y: float, roll: float) -> Box:
    """A pillar whose top has its middle at (x, y, 0) and rises to the left by `roll`, rad."""
    half_height = PIT / 2
    centre = (float(x), float(y + half_height * math.sin(roll)), -half_height * math.cos(roll))
    half_width = WIDTH / 2 / math.cos(roll)
    return Box(centre, (LENGTH / 2, half_width, half_height), (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0))
