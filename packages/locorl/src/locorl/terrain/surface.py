"""The exact surface of boxes and of MuJoCo's height fields, as a ray from above meets it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from locorl.interfaces import Array
from locorl.terrain.tile import Box

_TOUCH = 1e-9
"""Points this close to a face count as inside, m, so that boxes side by side leave no crack."""


def box_top(box: Box, x: Array, y: Array) -> Array:
    """Height at which a ray from above meets `box` at the points (x, y), m; -inf where it misses."""
    rotation = _rotation(box.quat)
    cx, cy, cz = box.centre
    enter, leave = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
    for axis, half in zip(rotation.T, box.half_size, strict=True):
        # within the two faces across this axis: |offset + axis_z * z| <= half
        offset = axis[0] * (x - cx) + axis[1] * (y - cy) - axis[2] * cz
        if abs(axis[2]) < 1e-12:
            leave = np.where(np.abs(offset) <= half + _TOUCH, leave, -np.inf)
            continue
        ends = (-half - offset) / axis[2], (half - offset) / axis[2]
        enter, leave = np.maximum(enter, np.minimum(*ends)), np.minimum(leave, np.maximum(*ends))
    return np.where(enter <= leave + _TOUCH, leave, -np.inf)


def box_extent(box: Box) -> tuple[float, float, float]:
    """Half size of the upright box around `box`, m."""
    x, y, z = np.abs(_rotation(box.quat)) @ np.array(box.half_size)
    return float(x), float(y), float(z)


def raise_boxes(heights: Array, boxes: Sequence[Box], x: Array, y: Array) -> None:
    """Raise `heights` (rows, columns) over the grid x (rows,), y (columns,), both ascending, to the boxes' tops."""
    for box in boxes:
        reach_x, reach_y, _ = box_extent(box)
        rows = _within(x, box.centre[0], reach_x)
        columns = _within(y, box.centre[1], reach_y)
        part = heights[rows, columns]
        np.maximum(part, box_top(box, *np.meshgrid(x[rows], y[columns], indexing="ij")), out=part)


def _within(values: Array, middle: float, reach: float) -> slice:
    low, high = np.searchsorted(values, (middle - reach - _TOUCH, middle + reach + _TOUCH))
    return slice(int(low), int(high))


@dataclass(frozen=True)
class HeightField:
    """Ground of triangles over a grid of nodes, split as MuJoCo splits the cells of its height fields.

    Args:
        nodes: heights (rows along x, columns along y), m.
        low: world position (x, y) of node (0, 0), m.
        high: world position (x, y) of the last node, m.
    """

    nodes: Array
    low: tuple[float, float]
    high: tuple[float, float]

    def at(self, x: Array, y: Array) -> Array:
        """Height at points (x, y), m; outside, that of the nearest point of the border."""
        rows, columns = self.nodes.shape
        u = np.clip((x - self.low[0]) / (self.high[0] - self.low[0]), 0.0, 1.0) * (rows - 1)
        v = np.clip((y - self.low[1]) / (self.high[1] - self.low[1]), 0.0, 1.0) * (columns - 1)
        i = np.minimum(u.astype(int), rows - 2)
        j = np.minimum(v.astype(int), columns - 2)
        u, v = u - i, v - j
        near, far = self.nodes[i, j], self.nodes[i + 1, j + 1]
        # the diagonal runs from (i, j) to (i + 1, j + 1)
        corner = np.where(u > v, self.nodes[i + 1, j], self.nodes[i, j + 1])
        return near + np.maximum(u, v) * (corner - near) + np.minimum(u, v) * (far - corner)


def _rotation(quat: tuple[float, float, float, float]) -> Array:
    """Rotation matrix, (3, 3), of a quaternion (w, x, y, z) of any length."""
    w, x, y, z = (value / math.hypot(*quat) for value in quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
