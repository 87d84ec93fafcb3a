"""Rays against the height of the ground: where each one meets it first."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from locorl.terrain.heights import HeightGrid

_PIECES = (8, 2, 1)
"""Length of the pieces that rays are cut into, cells."""
_STRIDES = (4, 1)
"""Spacing of the bounds for all but the shortest pieces, cells."""
_BISECTIONS = 8
_HAIR = 1e-3
"""How far before a face a ray is looked at, cells."""


class RayCaster:
    """First hits of rays on a height grid, by bounds over ever shorter pieces of the rays.

    A piece above all heights around it is free, one below all of them is past the hit; what remains is cut further.
    The shortest are looked at where they leave the square around a node and at their ends; the first place below the
    ground is bisected, down to 0.2 mm for a cell of 5 cm.

    Neighbouring nodes that differ by a slope of more than `steepest` are the two sides of a vertical face halfway
    between them; others are joined by bilinear interpolation. Steps keep their edges and hills stay smooth.

    Args:
        ground: heights.
        reach: largest ray parameter of a hit.
        speed: longest direction, m per unit of the ray parameter.
        steepest: slope (rise over run) above which two nodes are the two sides of a face.
    """

    def __init__(self, ground: HeightGrid, reach: float, speed: float, steepest: float = 0.7) -> None:
        heights, cell = ground.heights, ground.cell
        self._reach = reach
        self._cell = cell / speed
        self._origin = torch.tensor((*ground.origin, 0.0), dtype=torch.float32, device=heights.device)
        self._scale = torch.tensor((1.0 / cell, 1.0 / cell, 1.0), dtype=torch.float32, device=heights.device)
        self._around = _Bounds(heights, radius=math.ceil(reach * speed / cell), stride=16)
        self._levels = [
            _Bounds(heights, radius=piece // 2, stride=stride)
            for piece, stride in zip(_PIECES[:-1], _STRIDES, strict=True)
        ]
        self._shape = ground.shape
        self._heights = heights.reshape(-1)
        self._face = _faces(heights, steepest * cell).reshape(-1).float()

    def cast(self, origin: Tensor, direction: Tensor) -> Tensor:
        """The ray parameter of the first hit.

        Args:
            origin: common start of n bundles of rays, world, (n, 3), m.
            direction: P directions of each bundle, world, (n, P, 3), m per unit of the ray parameter.

        Returns:
            t of the first point `origin + t direction` on or below the ground; infinite without one up to
            `reach`; (n, P).
        """
        origin, direction = (origin - self._origin) * self._scale, direction * self._scale
        # a hair off the axes spares rays along them a case of their own
        direction = torch.where(direction.abs() < 1e-6, torch.full_like(direction, -1e-6), direction)
        low, high = self._around.at(origin[:, 0], origin[:, 1])
        z, dz = origin[:, 2:], direction[..., 2]
        to_low, to_high = (low[:, None] - z) / dz, (high[:, None] - z) / dz
        start, stop = torch.minimum(to_low, to_high).clamp_(min=0.0), torch.maximum(to_low, to_high)
        hit = torch.where((dz < 0) & (stop <= self._reach), stop.clamp(min=0.0), torch.inf).view(-1)
        stop.clamp_(max=self._reach)
        open_ = (start < stop).view(-1).nonzero().squeeze(1)
        rays = torch.cat((origin[:, None].expand_as(direction), direction), dim=2).view(-1, 6)[open_]
        hit[open_] = self._search(rays, start.view(-1)[open_], stop.view(-1)[open_], hit[open_])
        return hit.masked_fill_(hit > self._reach, torch.inf).view_as(dz)

    def _search(self, rays: Tensor, start: Tensor, stop: Tensor, hit: Tensor) -> Tensor:
        """First hits (R,) of `rays` (R, 6) between `start` and `stop` (R,), given upper bounds `hit` (R,)."""
        length = self._cell * _PIECES[0]
        count = ((stop - start) / length).ceil_().long()
        ray = torch.arange(len(count), device=count.device).repeat_interleave(count)
        order = torch.arange(len(ray), device=ray.device) - (count.cumsum(0) - count).index_select(0, ray)
        t = torch.add(start.index_select(0, ray), order, alpha=length)
        for level, piece, shorter in zip(self._levels, _PIECES[:-1], _PIECES[1:], strict=True):
            row = rays.index_select(0, ray)
            x, y, z = torch.addcmul(row[:, :3], t[:, None] + 0.5 * length, row[:, 3:]).unbind(1)
            low, high = level.at(x, y)
            slack = (0.5 * length) * row[:, 5].abs()
            past = (z + slack < low).nonzero().squeeze(1)
            hit.scatter_reduce_(0, ray.index_select(0, past), t.index_select(0, past), "amin")
            keep = ((z - slack <= high) & (t < hit.index_select(0, ray))).nonzero().squeeze(1)
            length, parts = self._cell * shorter, piece // shorter
            ray = ray.index_select(0, keep).repeat_interleave(parts)
            t = (t.index_select(0, keep)[:, None] + length * torch.arange(parts, device=t.device)).view(-1)
        row = rays.index_select(0, ray)
        for stop in (*_leaving(row, t, length).unbind(1), t + length):
            below = self._below(row, stop).nonzero().squeeze(1)
            hit.scatter_reduce_(0, ray.index_select(0, below), stop.index_select(0, below), "amin")
        return self._bisect(rays, torch.maximum(start, hit - length), hit)

    def _bisect(self, rays: Tensor, above: Tensor, hit: Tensor) -> Tensor:
        """Hits (R,) of `rays` (R, 6) between `above` the ground and `hit` (R,) below it or infinite."""
        ids = hit.isfinite().nonzero().squeeze(1)
        rays, t = rays.index_select(0, ids), above.index_select(0, ids)
        width = hit.index_select(0, ids) - t
        for _ in range(_BISECTIONS):
            width *= 0.5
            t += width * ~self._below(rays, t + width)
        return hit.index_copy_(0, ids, t + width)

    def _below(self, rays: Tensor, t: Tensor) -> Tensor:
        """Whether the points at `t` (R,) of `rays` (R, 6) are on or below the ground, (R,) bool."""
        rows, columns = self._shape
        x, y, z = torch.addcmul(rays[:, :3], t[:, None], rays[:, 3:]).unbind(1)
        x, y = x.clamp(0.0, rows - 1.0), y.clamp(0.0, columns - 1.0)
        i, j = x.int().clamp_(max=rows - 2), y.int().clamp_(max=columns - 2)
        index = i * columns + j
        face = self._face.index_select(0, index)
        u, v = x.sub_(i), y.sub_(j)
        u, v = torch.addcmul(u, face, u.round() - u), torch.addcmul(v, face, v.round() - v)
        a, b, c, d = (self._heights.index_select(0, index + corner) for corner in (0, 1, columns, columns + 1))
        return z <= torch.lerp(torch.lerp(a, b, v), torch.lerp(c, d, v), u)


class _Bounds:
    """Lowest and highest ground within `radius` cells of any point of a block of `stride` x `stride` nodes."""

    def __init__(self, heights: Tensor, radius: int, stride: int) -> None:
        low, high = -_windows(-heights, radius, stride), _windows(heights, radius, stride)
        self._stride = stride
        self._shape = high.shape
        self._table = torch.stack((low, high), dim=-1).view(-1, 2)

    def at(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Lowest and highest ground around the points (`x`, `y`), each (R,), in cells -> each (R,), m."""
        i, j = (
            ((place + 0.5) * (1.0 / self._stride)).clamp_(0, size - 1).int()
            for place, size in zip((x, y), self._shape, strict=True)
        )
        low, high = self._table.index_select(0, i * self._shape[1] + j).unbind(1)
        return low, high


def _windows(heights: Tensor, radius: int, stride: int) -> Tensor:
    # one cell more: the surface between two nodes depends on both
    margin = radius + 1
    rows, columns = heights.shape
    padding = (margin, margin - columns % -stride, margin, margin - rows % -stride)
    windows = pad(heights[None, None], padding, mode="replicate")
    kernel = stride + 2 * margin
    windows = max_pool2d(windows, (kernel, 1), (stride, 1))
    return max_pool2d(windows, (1, kernel), (1, stride))[0, 0]


def _faces(heights: Tensor, step: float) -> Tensor:
    """The squares of four nodes two neighbours of which differ by more than `step`, (rows, columns)."""
    face = torch.zeros(heights.shape, dtype=torch.bool, device=heights.device)
    along_x = heights.diff(dim=0).abs() > step
    along_y = heights.diff(dim=1).abs() > step
    face[:-1, :-1] = along_x[:, :-1] | along_x[:, 1:] | along_y[:-1] | along_y[1:]
    return face


def _leaving(rays: Tensor, t: Tensor, length: float) -> Tensor:
    """Where pieces of `rays` (R, 6) at `t` (R,) leave the square around a node, along x and along y, (R, 2).

    It is a hair on the lower side of the face between the squares, where a ray that clips a corner is below it.
    """
    place, speed = torch.addcmul(rays[:, :2], t[:, None], rays[:, 3:5]), rays[:, 3:5]
    side = speed.sign()
    face = (place + 0.5).floor_() + 0.5 * side + (_HAIR * side) * rays[:, 5:].sign()
    return t[:, None] + ((face - place) / speed).clamp_(0.0, length)
