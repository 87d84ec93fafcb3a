"""Height scan: the ground around a robot as seen from its base."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from locorl.terrain.heights import HeightGrid


@dataclass(frozen=True)
class ScanConfig:
    """A grid of points around the base; the defaults are the 12 x 11 points of the reference implementation."""

    forward: tuple[float, float] = (-0.45, 1.2)
    """First and last row ahead of the base, m."""
    sideways: tuple[float, float] = (-0.75, 0.75)
    """First and last column to the left of the base, m."""
    spacing: float = 0.15
    """Distance of neighbouring points, m."""
    clip: float = 1.0
    """Heights are clipped to +- this, m."""

    @property
    def size(self) -> int:
        """Number of points."""
        return len(_axis(self.forward, self.spacing)) * len(_axis(self.sideways, self.spacing))


class HeightScan:
    """Measures `clip(z_base - z_stance - z_ground)` at the points of a scan: 0 where a robot stands on level ground.

    Args:
        config: the points.
        ground: heights.
    """

    def __init__(self, config: ScanConfig, ground: HeightGrid) -> None:
        self.config = config
        self.ground = ground
        forward, sideways = _axis(config.forward, config.spacing), _axis(config.sideways, config.spacing)
        grid = torch.stack(torch.meshgrid(forward, sideways, indexing="ij"), dim=-1).reshape(-1, 2)
        self.offsets = grid.to(ground.device)
        """Points in the base's heading frame, row by row from behind, (P, 2), m."""

    def points(self, position: Tensor, yaw: Tensor) -> Tensor:
        """World positions of the points, (n, P, 2), m."""
        cos, sin = torch.cos(yaw)[:, None], torch.sin(yaw)[:, None]
        x, y = self.offsets.unbind(dim=1)
        return torch.stack((position[:, :1] + cos * x - sin * y, position[:, 1:2] + sin * x + cos * y), dim=-1)

    def measure(self, position: Tensor, yaw: Tensor, stance_height: Tensor) -> Tensor:
        """The scan, (n, P), m.

        Args:
            position: of the bases, world, (n, 3), m.
            yaw: their headings, (n,), rad.
            stance_height: height of each base above the ground in its stance, (n,), m.
        """
        level = (position[:, 2] - stance_height)[:, None]
        return (level - self.ground.at(self.points(position, yaw))).clamp(-self.config.clip, self.config.clip)


def _axis(bounds: tuple[float, float], spacing: float) -> Tensor:
    low, high = bounds
    if spacing <= 0 or high < low:
        raise ValueError(f"a scan needs spacing > 0 and rising bounds, got {bounds} every {spacing} m")
    return low + spacing * torch.arange(round((high - low) / spacing) + 1)
