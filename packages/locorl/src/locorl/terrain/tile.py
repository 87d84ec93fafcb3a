"""What a terrain is made of: one tile, described by boxes, relief, waypoints and a start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from locorl.interfaces import Array

Relief = Callable[[Array, Array], Array]
"""Height of the ground at points (x, y) of the tile's frame, m; arrays of one shape in, the same shape out."""


@dataclass(frozen=True)
class TileSize:
    """Extent of a tile, m: `length` along the course (x), `width` across (y)."""

    length: float = 8.0
    width: float = 8.0

    def __post_init__(self) -> None:
        """Refuse tiles without area."""
        if not (self.length > 0 and self.width > 0):
            raise ValueError(f"a tile needs length > 0 and width > 0, got {self}")


LOCOMOTION = TileSize(8.0, 8.0)
"""Open ground; the robot starts in the middle and may go any way."""
PARKOUR = TileSize(18.0, 4.0)
"""A course of six obstacles, run from the near end to the far one."""
PIT = 1.0
"""Depth of a pit, m."""


@dataclass(frozen=True)
class Box:
    """A solid box in the tile's frame: centre (m), half size (m), orientation (w, x, y, z)."""

    centre: tuple[float, float, float]
    half_size: tuple[float, float, float]
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @staticmethod
    def between(low: tuple[float, float, float], high: tuple[float, float, float]) -> Box:
        """The upright box with opposite corners `low` and `high`, m."""
        a, b = np.array(low), np.array(high)
        return Box(tuple(((a + b) / 2).tolist()), tuple(((b - a) / 2).tolist()))


@dataclass(frozen=True)
class Tile:
    """One tile in a frame of its own.

    The origin is the middle of the near edge at ground level: x runs along the course, y to the left, z up.
    Boxes start at the ground or below it; whatever no box and no relief covers is level ground at z = 0 if
    `floor`, or else a pit.
    """

    boxes: tuple[Box, ...] = ()
    start: tuple[float, float] = (0.0, 0.0)
    """Where robots start, m."""
    waypoints: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2), m, in order; their height is that of the ground there."""
    relief: Relief | None = None
    """Height of smooth ground; it should be 0 on the border of the tile."""
    floor: bool = True
    """Level ground under the boxes; without it, a pit."""
    obstacle: float = 0.0
    """Size that the difficulty sets, m: height of a hurdle or a step, width of a gap, rise of a hill."""


Kind = Callable[[float, np.random.Generator, TileSize], Tile]
"""A kind of terrain: (difficulty, random generator, size of the tile) -> tile.

Difficulty is 0 at the easiest and 1 at the hardest that the paper trains on; more is allowed. From 0 down to -1 the
obstacles of the easiest shrink to nothing, so that a policy can learn to walk on the way to them.
"""


def grown(difficulty: float, easiest: float, growth: float) -> float:
    """A size that is `easiest` at difficulty 0, grows by `growth` up to difficulty 1, and shrinks to 0 down to -1."""
    return easiest + growth * difficulty if difficulty >= 0.0 else easiest * (1.0 + difficulty)


def either(*kinds: Kind) -> Kind:
    """The kind that is one of `kinds`, drawn anew for every tile."""

    def draw(difficulty: float, rng: np.random.Generator, size: TileSize) -> Tile:
        return kinds[rng.integers(len(kinds))](difficulty, rng, size)

    return draw


def middle(size: TileSize) -> tuple[float, float]:
    """The middle of a tile, m."""
    return size.length / 2, 0.0
