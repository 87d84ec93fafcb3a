"""The height of the ground anywhere on the map, as tensors on the simulator's device."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from locorl.interfaces import Array


class HeightGrid:
    """Ground heights sampled on a regular grid; outside of it, the nearest border value holds.

    Args:
        heights: (rows, columns), m; node (i, j) lies at `origin + cell * (i, j)` in the world's x and y.
        origin: world position of node (0, 0), (x, y), m.
        cell: distance of neighbouring nodes, m.
        device: where lookups happen.
        edge_step: height difference of neighbouring nodes that makes an edge, m.
        edge_reach: distance to an edge that counts as near it, m (5 cm in Table I).

    Raises:
        ValueError: fewer than 2 x 2 nodes, or a height that is not finite.
    """

    def __init__(
        self,
        heights: Array,
        origin: tuple[float, float] = (0.0, 0.0),
        cell: float = 0.05,
        device: torch.device | str = "cpu",
        edge_step: float = 0.06,
        edge_reach: float = 0.05,
    ) -> None:
        heights = np.asarray(heights, dtype=np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all() or cell <= 0:
            raise ValueError(
                f"a height grid needs 2 x 2 finite nodes or more and cell > 0, got {heights.shape}, {cell}"
            )
        self.cell = cell
        self.origin = origin
        self.device = torch.device(device)
        self.shape = heights.shape
        self.highest = float(heights.max())
        self.heights = torch.from_numpy(heights).to(self.device, torch.float32)
        self._flat = self.heights.reshape(-1)
        self._edge = torch.from_numpy(_near_edges(heights, edge_step, math.ceil(edge_reach / cell))).to(self.device)
        self._edge = self._edge.reshape(-1)
        self._start = torch.tensor(origin, dtype=torch.float32, device=self.device)
        self._last = torch.tensor((heights.shape[0] - 1, heights.shape[1] - 1), device=self.device)
        self._last_float = self._last.float()

    def at(self, xy: Tensor) -> Tensor:
        """Height at the node nearest to each point `xy` (..., 2), world, m -> (...,), m."""
        return self._flat[self._nearest(xy)]

    def interpolate(self, xy: Tensor) -> Tensor:
        """Bilinear height at each point `xy` (..., 2), world, m -> (...,), m; vertical faces become ramps."""
        place = ((xy - self._start) / self.cell).clamp(min=0.0)
        place = torch.minimum(place, self._last_float)
        low = torch.minimum(place.long(), self._last - 1)
        u, v = (place - low).unbind(dim=-1)
        index = low[..., 0] * self.shape[1] + low[..., 1]
        a, b = self._flat[index], self._flat[index + 1]
        c, d = self._flat[index + self.shape[1]], self._flat[index + self.shape[1] + 1]
        return (a * (1 - v) + b * v) * (1 - u) + (c * (1 - v) + d * v) * u

    def near_edge(self, xy: Tensor) -> Tensor:
        """Whether each point `xy` (..., 2), world, m, lies within `edge_reach` of an edge -> (...,) bool."""
        return self._edge[self._nearest(xy)]

    def _nearest(self, xy: Tensor) -> Tensor:
        node = (xy - self._start).div_(self.cell).add_(0.5).clamp_(min=0.0)
        node = torch.minimum(node, self._last_float, out=node).int()
        return node[..., 0] * self.shape[1] + node[..., 1]


def level_ground(device: torch.device | str = "cpu") -> HeightGrid:
    """An infinite floor at z = 0."""
    return HeightGrid(np.zeros((2, 2)), device=device)


def _near_edges(heights: Array, step: float, reach: int) -> np.ndarray:
    """Nodes within `reach` cells of a jump of more than `step` between neighbours along x or y."""
    jump = np.zeros(heights.shape, dtype=bool)
    for axis in (0, 1):
        steep = np.abs(np.diff(heights, axis=axis)) > step
        low, high = [slice(None)] * 2, [slice(None)] * 2
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        jump[tuple(low)] |= steep
        jump[tuple(high)] |= steep
    near = jump.copy()
    # nodes beside a jump lie up to a cell from it, so they count as the first cell of the reach
    for _ in range(reach - 1):
        grown = near.copy()
        grown[1:] |= near[:-1]
        grown[:-1] |= near[1:]
        grown[:, 1:] |= near[:, :-1]
        grown[:, :-1] |= near[:, 1:]
        near = grown
    return near
