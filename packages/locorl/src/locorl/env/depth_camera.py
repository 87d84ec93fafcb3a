"""The depth camera of a robot: its optics, its mount, and what it would measure without noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from locorl.env.kinematics import rotation
from locorl.env.raycast import RayCaster
from locorl.env.state import check_ranges
from locorl.terrain.heights import HeightGrid


class Intrinsics(NamedTuple):
    """Pinhole model, px; pixel (row i, column j) looks through (j + 0.5, i + 0.5), rows counted downwards."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class DepthConfig:
    """Optics, mount, timing and noise of the depth camera.

    The defaults are those of the reference implementation (Extreme Parkour), which has no noise. It takes an image of
    60 x 106 pixels, crops two rows at the bottom and four columns on either side, and resizes the remaining 58 x 98 to
    58 x 87. Here each pixel is one ray through its centre, so the pixels are 98/87 as wide as high.
    """

    rows: int = 58
    """Height of the image, px."""
    columns: int = 87
    """Width of the image, px."""
    raw_size: tuple[int, int] = (60, 106)
    """Rows and columns of the sensor, with square pixels."""
    crop_bottom: int = 2
    """Rows of the sensor that the image leaves out below."""
    crop_sides: int = 4
    """Columns of the sensor that the image leaves out on the left, and as many on the right."""
    field_of_view: float = 87.0
    """Horizontal angle of view of the whole sensor, deg."""
    position: tuple[float, float, float] = (0.27, 0.0, 0.03)
    """Of the camera in the base frame, m."""
    pitch: tuple[float, float] = (-5.0, 5.0)
    """Range of the pitch of the mount, drawn for each robot at its reset, deg; positive looks down."""
    near: float = 0.0
    """Depths below are clipped to this, m."""
    far: float = 2.0
    """Depths above, and rays that meet nothing, read this, m."""
    period: float = 0.1
    """Time between two images, s."""
    latency: float = 0.1
    """Time from an image to its use, s; one period is the image before last of the reference implementation."""
    relative_noise: float = 0.0
    """Standard deviation of the noise as a share of the depth."""
    additive_noise: float = 0.0
    """Standard deviation of the noise, m."""
    dropout: float = 0.0
    """Share of all pixels that read `far`, anew in each image."""
    edge_dropout: float = 0.0
    """Share of the pixels on the far side of a depth edge that read `far`, as in the shadows of stereo cameras."""
    edge_jump: float = 0.3
    """Difference in inverse depth of neighbouring pixels that makes an edge, 1/m; it is even across a plane."""

    def __post_init__(self) -> None:
        """Refuse cameras that cannot be."""
        if min(self.rows, self.columns) < 1 or self.crop_bottom >= self.raw_size[0]:
            raise ValueError(f"DepthConfig: need rows >= 1, columns >= 1 and some rows left by the crop, got {self}")
        if 2 * self.crop_sides >= self.raw_size[1] or not 0.0 < self.field_of_view < 180.0:
            raise ValueError(f"DepthConfig: need columns left by the crop and 0 < field_of_view < 180, got {self}")
        if not 0.0 <= self.near < self.far:
            raise ValueError(f"DepthConfig: need 0 <= near < far, got {self.near} and {self.far} m")
        if min(self.relative_noise, self.additive_noise) < 0:
            raise ValueError(f"DepthConfig: need noise >= 0, got {self}")
        check_ranges(self, "pitch")
        if not (0.0 <= self.dropout <= 1.0 and 0.0 <= self.edge_dropout <= 1.0):
            raise ValueError(f"DepthConfig: dropout is a share, 0 to 1, got {self.dropout} and {self.edge_dropout}")

    @classmethod
    def small(cls) -> DepthConfig:
        """24 x 36 pixels, for CPUs; so that few of them are sky, it looks down by 25 degrees, and as far as 3 m."""
        return cls(rows=24, columns=36, pitch=(20.0, 30.0), far=3.0)

    @property
    def intrinsics(self) -> Intrinsics:
        """Of the cropped and resized image."""
        raw_rows, raw_columns = self.raw_size
        focal = 0.5 * raw_columns / math.tan(math.radians(0.5 * self.field_of_view))
        x = self.columns / (raw_columns - 2 * self.crop_sides)
        y = self.rows / (raw_rows - self.crop_bottom)
        return Intrinsics(focal * x, focal * y, 0.5 * self.columns, 0.5 * raw_rows * y)


class DepthCamera:
    """Depth along the optical axis (not along the ray), as depth buffers of renderers hold it.

    It sees the ground alone: no robot, neither others nor its own legs. The camera's frame has x along the optical
    axis, y to the left of the image and z up.

    Args:
        config: optics.
        ground: what the camera sees.
        chunk: rays cast at a time; a thousand take up to 1.5 MB of temporary memory. CPUs are fastest with what fits
            their caches.
    """

    def __init__(self, config: DepthConfig, ground: HeightGrid, chunk: int | None = None) -> None:
        self.config = config
        rays = _rays(config).to(ground.device)
        self._rays = rays
        self._caster = RayCaster(ground, reach=config.far, speed=float(rays.norm(dim=1).max()))
        chunk = chunk or (2**14 if ground.device.type == "cpu" else 2**18)
        self._robots_at_once = max(1, chunk // len(rays))

    @torch.no_grad()
    def render(self, position: Tensor, quat: Tensor) -> Tensor:
        """One image of each camera.

        Args:
            position: of the cameras, world, (n, 3), m.
            quat: camera -> world, (w, x, y, z), (n, 4).

        Returns:
            Depth, (n, rows, columns), m; `far` where nothing is nearer.
        """
        position, turn = position.float(), rotation(quat.float())
        depth = torch.empty(len(position), len(self._rays), device=self._rays.device)
        for first in range(0, len(position), self._robots_at_once):
            some = slice(first, first + self._robots_at_once)
            depth[some] = self._caster.cast(position[some], self._rays @ turn[some].transpose(1, 2))
        return depth.clamp_(max=self.config.far).view(-1, self.config.rows, self.config.columns)


def mounted(config: DepthConfig, position: Tensor, quat: Tensor, pitch: Tensor) -> tuple[Tensor, Tensor]:
    """Poses of the cameras on their robots.

    Args:
        config: where the camera sits on the base.
        position: of the bases, world, (n, 3), m.
        quat: base -> world, (w, x, y, z), (n, 4).
        pitch: of the mounts, (n,), rad; positive looks down.

    Returns:
        Positions (n, 3), m, and quaternions camera -> world (n, 4).
    """
    offset = torch.tensor(config.position, dtype=quat.dtype, device=quat.device)
    w, x, y, z = quat.unbind(dim=1)
    c, s = torch.cos(0.5 * pitch), torch.sin(0.5 * pitch)
    turned = torch.stack((w * c - y * s, x * c - z * s, y * c + w * s, z * c + x * s), dim=1)
    return position + rotation(quat) @ offset, turned


def _rays(config: DepthConfig) -> Tensor:
    """Directions in the camera's frame that advance by 1 along the optical axis, row by row, (rows * columns, 3)."""
    fx, fy, cx, cy = config.intrinsics
    right = (torch.arange(config.columns) + 0.5 - cx) / fx
    down = (torch.arange(config.rows) + 0.5 - cy) / fy
    down, right = torch.meshgrid(down, right, indexing="ij")
    return torch.stack((torch.ones_like(down), -right, -down), dim=-1).view(-1, 3)
