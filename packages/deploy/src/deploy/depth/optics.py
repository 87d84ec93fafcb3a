"""The camera that a policy was trained with: what each pixel of its image looks at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.errors import RobotError
from deploy.interfaces import Intrinsics

BLIND_SHARE = 0.05
"""Share of the image that a camera may miss because its field of view is narrower than in training."""

TIE = 1e-6
"""Share of a pixel by which a ray on the border of two pixels is moved, so that rounding does not choose."""


@dataclass(frozen=True)
class DepthOptics:
    """Geometry and scale of the image that the network reads, as the section "depth" of a manifest says.

    Attributes:
        rows: Height of the image, px.
        columns: Width of the image, px.
        intrinsics: Of the image; with a crop, the principal point is not its centre.
        near: Depths below are clipped to this, m.
        far: Depths above are clipped to this, and pixels without a measurement read it, m.
        raw_size: Rows and columns of the sensor that the image was cropped from, px.
        crop_bottom: Rows of the sensor left out below.
        crop_sides: Columns of the sensor left out on the left, and as many on the right.
    """

    rows: int
    columns: int
    intrinsics: Intrinsics
    near: float
    far: float
    raw_size: tuple[int, int]
    crop_bottom: int
    crop_sides: int

    @classmethod
    def from_manifest(cls, depth: Mapping[str, Any]) -> DepthOptics:
        """Those of a section "depth" that keeps the bundle schema."""
        camera = depth["camera"]
        return cls(
            rows=depth["image"]["rows"],
            columns=depth["image"]["columns"],
            intrinsics=Intrinsics(camera["fx"], camera["fy"], camera["cx"], camera["cy"]),
            near=camera["near"],
            far=camera["far"],
            raw_size=(camera["raw_size"][0], camera["raw_size"][1]),
            crop_bottom=camera["crop_bottom"],
            crop_sides=camera["crop_sides"],
        )

    def rays(self) -> NDArray[np.float64]:
        """Directions (rows, columns, 3) that advance by 1 along the optical axis: x forward, y left, z up."""
        c = self.intrinsics
        right = (np.arange(self.columns) + 0.5 - c.cx) / c.fx
        down = (np.arange(self.rows) + 0.5 - c.cy) / c.fy
        grid = np.broadcast_arrays(1.0, -right[None, :], -down[:, None])
        return np.stack(grid, axis=-1)

    def sensor(self, height: int, width: int) -> Intrinsics:
        """Intrinsics of an uncropped frame of the trained field of view, at any resolution of its aspect ratio.

        Raises:
            RobotError: The frame has another aspect ratio, so its field of view is another one too.
        """
        raw_rows, raw_columns = self.raw_size
        y, x = height / raw_rows, width / raw_columns
        if not math.isclose(x, y, rel_tol=0.02):
            raise RobotError(
                f"depth camera: its frames are {width} x {height} px, the policy was trained with a sensor of "
                f"{raw_columns} x {raw_rows}: choose a stream of that aspect ratio or give the camera's intrinsics"
            )
        kept_x = (raw_columns - 2 * self.crop_sides) / self.columns
        kept_y = (raw_rows - self.crop_bottom) / self.rows
        c = self.intrinsics
        return Intrinsics(
            fx=c.fx * kept_x * x,
            fy=c.fy * kept_y * y,
            cx=(c.cx * kept_x + self.crop_sides) * x,
            cy=c.cy * kept_y * y,
        )


@dataclass(frozen=True)
class PixelMap:
    """Where the pixels of the image lie in a camera's frame: crop and resize in one step, row and column apart.

    The pixel of the frame that the ray through the centre of an image pixel meets stands for it, because training
    casts that one ray; averaging would put depths into the gap behind an edge where there is nothing.

    Attributes:
        row: Of the frame, for each row of the image, (rows,).
        column: Likewise, (columns,).
        row_range: First and last row of the frame whose centre falls into the image's row, (rows, 2).
        column_range: Likewise, (columns, 2).
        seen: Whether the frame reaches there, (rows, columns).
    """

    row: NDArray[np.intp]
    column: NDArray[np.intp]
    row_range: NDArray[np.intp]
    column_range: NDArray[np.intp]
    seen: NDArray[np.bool_]


def pixel_map(optics: DepthOptics, height: int, width: int, camera: Intrinsics) -> PixelMap:
    """Map the image onto a frame of `height` x `width` px with the intrinsics `camera`.

    Raises:
        RobotError: The camera misses more than `BLIND_SHARE` of the image.
    """
    c = optics.intrinsics
    row, row_range, row_seen = _axis(optics.rows, (c.fy, c.cy), height, (camera.fy, camera.cy))
    column, column_range, column_seen = _axis(optics.columns, (c.fx, c.cx), width, (camera.fx, camera.cx))
    seen = row_seen[:, None] & column_seen[None, :]
    if (blind := 1.0 - float(seen.mean())) > BLIND_SHARE:
        raise RobotError(
            f"depth camera: its field of view misses {blind:.0%} of the image that the policy was trained with "
            f"(frame {width} x {height} px, fx {camera.fx:g}, fy {camera.fy:g}); choose a wider stream"
        )
    return PixelMap(row, column, row_range, column_range, seen)


def _axis(
    count: int, image: tuple[float, float], size: int, frame: tuple[float, float]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Centre pixel, first and last pixel of the footprint, and whether the centre is inside, along one axis."""

    def to_frame(position: NDArray[np.float64]) -> NDArray[np.float64]:
        return (position - image[1]) / image[0] * frame[0] + frame[1] + TIE

    centre = np.floor(to_frame(np.arange(count, dtype=np.float64) + 0.5)).astype(np.intp)
    edges = np.ceil(to_frame(np.arange(count + 1.0)) - 0.5 - 2 * TIE).astype(np.intp)
    seen = (centre >= 0) & (centre < size)
    first, last = np.minimum(edges[:-1], centre), np.maximum(edges[1:] - 1, centre)
    inside = np.clip(np.stack((first, last), axis=1), 0, size - 1)
    return np.clip(centre, 0, size - 1), inside, seen
