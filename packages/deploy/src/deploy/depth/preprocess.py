"""From a depth frame to what the network reads; simulated, RealSense and ROS 2 cameras all go through here.

The order is that of the manifest: crop and resize (one lookup, see `optics`), fill small holes, clip, normalise.
`cpp/src/depth.cpp` repeats it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.depth.optics import DepthOptics, PixelMap, pixel_map
from deploy.errors import RobotError
from deploy.interfaces import DepthFrame, Intrinsics

Image = NDArray[np.float32]
LEAST_MEASURED = 0.1
"""Share of the image that a frame must have measured; below it a policy would walk by what it imagines."""


@dataclass(frozen=True)
class DepthReading:
    """A frame as the network reads it.

    Attributes:
        image: Shape (rows, columns), from -0.5 (near) to 0.5 (far, or no measurement).
        measured: Share of the image's pixels with a measurement, filled holes included.
        fault: Why the frame shows nothing, or less than `LEAST_MEASURED`; None for a frame that can be used.
    """

    image: Image
    measured: float
    fault: str | None


class DepthPreprocessor:
    """Turns frames into readings; the mapping of pixels is made once for each geometry of the frames."""

    def __init__(self, optics: DepthOptics) -> None:
        self._optics = optics
        self._geometry: tuple[tuple[int, ...], Intrinsics | None] | None = None
        self._candidates = np.empty((0, 1), dtype=np.intp)
        self._seen = np.empty(0, dtype=np.bool_)

    def __call__(self, frame: DepthFrame) -> DepthReading:
        """Preprocess one frame.

        A frame of the image's own size without intrinsics counts as cropped and resized already: that is what a
        simulated camera gives, which casts `DepthOptics.rays`.

        Args:
            frame: Depths in m; 0, NaN and negative numbers are pixels without a measurement, inf is out of sight.

        Returns:
            The image, how much of it was measured, and whether that is too little.

        Raises:
            RobotError: The frame is no image, or its field of view is not that of the policy's camera.
        """
        if (frame.image_m.shape, frame.intrinsics) != self._geometry:
            self._prepare(frame)
        optics = self._optics
        depths = frame.image_m.reshape(-1).astype(np.float32, copy=False)
        centre = self._candidates[:, 0]
        depth = depths[centre]
        holes = np.flatnonzero(~_is_measured(depth) & self._seen)
        filled = self._seen & _is_measured(depth)
        if holes.size:
            around = depths[self._candidates[holes]]
            usable = _is_measured(around)
            nearest = usable.argmax(axis=1)
            depth[holes] = around[np.arange(holes.size), nearest]
            filled[holes] = usable.any(axis=1)
        depth = np.where(filled, depth, np.float32(optics.far))
        image = (np.clip(depth, optics.near, optics.far) - optics.near) / (optics.far - optics.near) - 0.5
        image = image.astype(np.float32, copy=False).reshape(optics.rows, optics.columns)
        measured = float(filled.mean())
        return DepthReading(image, measured, _fault(depths, measured))

    def _prepare(self, frame: DepthFrame) -> None:
        shape = frame.image_m.shape
        if len(shape) != 2 or 0 in shape:
            raise RobotError(f"depth camera: a frame has shape {shape}; need (height, width) in metres")
        optics, camera = self._optics, frame.intrinsics
        if camera is None and shape == (optics.rows, optics.columns):
            self._candidates = np.arange(frame.image_m.size)[:, None]
            self._seen = np.ones(frame.image_m.size, dtype=np.bool_)
        else:
            pixels = pixel_map(optics, *shape, camera or optics.sensor(*shape))
            self._candidates, self._seen = _candidates(pixels, shape[1]), pixels.seen.reshape(-1)
        self._geometry = (shape, camera)


def _is_measured(depth: Image) -> NDArray[np.bool_]:
    """Positive and infinite depths are measurements (inf: out of sight, -inf: too near to tell), see REP 117."""
    return (depth > 0.0) | np.isneginf(depth)


def _fault(depths: Image, measured: float) -> str | None:
    if measured >= LEAST_MEASURED:
        return None
    if np.isnan(depths).all():
        return "depth: every pixel is NaN, the camera measures nothing; check its driver and its projector"
    if not depths.any():
        return "depth: every pixel is 0, as from a covered lens or a stalled stream; check the camera"
    if not measured:
        return "depth: no pixel holds a measurement; check the camera"
    return (
        f"depth: only {measured:.1%} of the image is measured, need {LEAST_MEASURED:.0%}; "
        "check the lens, the light and the distance"
    )


def _candidates(pixels: PixelMap, width: int) -> NDArray[np.intp]:
    """Pixels of the frame that may stand for each image pixel, (rows * columns, K), flat, the best one first.

    First the one under the ray, then the others of its footprint by distance from it, then by row, then by column;
    short lists repeat the first. Holes wider than a footprint stay holes, as in training.
    """
    rows, row_gap = _spread(pixels.row, pixels.row_range)
    columns, column_gap = _spread(pixels.column, pixels.column_range)
    shape = (len(rows), len(columns), rows.shape[1], columns.shape[1])
    distance = np.broadcast_to(row_gap[:, None, :, None] + column_gap[None, :, None, :], shape)
    index = np.broadcast_to(rows[:, None, :, None] * width + columns[None, :, None, :], shape)
    flat = (shape[0] * shape[1], shape[2] * shape[3])
    order = np.argsort(distance.reshape(flat), axis=1, kind="stable")
    return np.take_along_axis(index.reshape(flat), order, axis=1)


def _spread(centre: NDArray[np.intp], span: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pixels of each footprint along one axis, (n, K), and their squared distances; short ones repeat the centre."""
    pixel = span[:, :1] + np.arange(int((span[:, 1] - span[:, 0]).max()) + 1)
    pixel = np.where(pixel <= span[:, 1:], pixel, centre[:, None])
    return pixel, (pixel - centre[:, None]) ** 2
