"""A depth camera behind ROS 2 topics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from deploy.errors import RobotError
from deploy.interfaces import Clock, DepthFrame
from deploy.robots.ros2.messages import depth_image, intrinsics, stamp_ns
from deploy.robots.ros2.node import Ros2Node


@dataclass(frozen=True)
class Ros2DepthConfig:
    """Topics: `sensor_msgs/msg/Image` (16UC1 or 32FC1) and `sensor_msgs/msg/CameraInfo`, rectified.

    The defaults are those of realsense-ros.
    """

    image: str = "/camera/camera/depth/image_rect_raw"
    info: str = "/camera/camera/depth/camera_info"
    metres_per_count: float = 1e-3


class Ros2Depth:
    """A `DepthSource` on topics; images count from the first calibration on."""

    def __init__(self, config: Ros2DepthConfig | None = None) -> None:
        self._config = config or Ros2DepthConfig()
        self._node: Ros2Node | None = None
        self._info: Any = None
        self._image: Any = None
        self._count = 0

    def start(self, clock: Clock) -> None:
        """Join the topics; `clock` must be that of the driver, wall time.

        Raises:
            RobotError: ROS 2 is missing, or `clock` is a simulator's.
        """
        if clock.virtual:
            raise RobotError("ROS 2 depth camera: stamps its images with wall time, the robot's time is simulated")
        self._node = Ros2Node("legged_deploy_depth")
        self._node.subscribe("sensor_msgs/msg/CameraInfo", self._config.info, self._take_info)
        self._node.subscribe("sensor_msgs/msg/Image", self._config.image, self._take_image)
        self._node.spin()

    def stop(self) -> None:
        """Leave the topics."""
        node, self._node = self._node, None
        if node is not None:
            node.close()

    def latest(self) -> DepthFrame | None:
        """The newest image; None before the first image and calibration.

        Raises:
            RobotError: What arrives is no rectified depth image.
        """
        image, info = self._image, self._info
        if image is None or info is None:
            return None
        depths = depth_image(image, self._config.image, self._config.metres_per_count)
        return DepthFrame(stamp_ns(image.header), self._count, depths, intrinsics(info, self._config.info))

    def _take_info(self, message: Any) -> None:
        self._info = message

    def _take_image(self, message: Any) -> None:
        self._image = message
        self._count += 1
