"""What a robot needs from a depth camera, and units."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deploy.errors import RobotError
from deploy.interfaces import Clock, DepthFrame


class DepthSource(Protocol):
    """A depth camera that runs beside the control loop."""

    def start(self, clock: Clock) -> None:
        """Begin to take images, stamped with the time of `clock`.

        Raises:
            RobotError: There is no such camera, or it gives no images.
        """
        ...

    def stop(self) -> None:
        """Give the camera back. Safe to call twice, and after a failed `start`."""
        ...

    def latest(self) -> DepthFrame | None:
        """The newest image, without waiting; None before the first."""
        ...


def to_metres(image: NDArray[np.generic], metres_per_count: float = 1e-3) -> NDArray[np.float32]:
    """A raw depth image in metres.

    Args:
        image: Shape (height, width): counts as uint16 (ROS 16UC1, RealSense z16), or metres as float32 (32FC1).
        metres_per_count: Value of one count, m; millimetres where the driver does not say otherwise.

    Raises:
        RobotError: Any other type of pixel.
    """
    if image.dtype == np.uint16:
        return image.astype(np.float32) * np.float32(metres_per_count)
    if image.dtype == np.float32:
        return image.astype(np.float32)
    raise RobotError(f"depth camera: pixels are {image.dtype}; need uint16 counts (16UC1) or float32 metres (32FC1)")
