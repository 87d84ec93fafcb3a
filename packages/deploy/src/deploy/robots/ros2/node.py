"""A ROS 2 node whose callbacks run in a thread of their own."""

# pyright: reportMissingImports=false
from __future__ import annotations

import threading
from collections.abc import Callable
from importlib import import_module
from typing import Any

from deploy.errors import RobotError


def message_type(name: str) -> Any:
    """The Python class of a ROS 2 message, such as `sensor_msgs/msg/Imu`.

    Raises:
        RobotError: ROS 2 is not installed, or not sourced.
    """
    package, _, short = name.split("/")
    return getattr(_ros(f"{package}.msg"), short)


def _ros(module: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise RobotError(
            f"ROS 2 is needed and {module!r} cannot be imported; it is no package of pip: install ROS 2 "
            "(https://docs.ros.org, packages ros-DISTRO-ros-base and python3-venv), run `source "
            "/opt/ros/DISTRO/setup.bash`, and use a virtual environment made with --system-site-packages by the "
            "Python of that ROS 2"
        ) from error


class Ros2Node:
    """A node with subscriptions and publishers; `close` ends it."""

    def __init__(self, name: str) -> None:
        """Make the node.

        Raises:
            RobotError: ROS 2 is not installed, or not sourced.
        """
        self._rclpy = _ros("rclpy")
        executors, self._qos = _ros("rclpy.executors"), _ros("rclpy.qos")
        self._mine = not self._rclpy.ok()
        if self._mine:
            self._rclpy.init()
        self._node = self._rclpy.create_node(name)
        self._executor = executors.SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, name=name, daemon=True)

    def subscribe(self, typename: str, topic: str, callback: Callable[[Any], None]) -> None:
        """Have `callback` called with each message; like sensors, the newest matters and a lost one does not."""
        self._node.create_subscription(message_type(typename), topic, callback, self._qos.qos_profile_sensor_data)

    def publisher(self, typename: str, topic: str) -> Callable[[Any], None]:
        """A function that publishes."""
        return self._node.create_publisher(message_type(typename), topic, 1).publish

    def publishers(self, topic: str) -> int:
        """How many publish on a topic, ours among them."""
        return self._node.count_publishers(topic)

    def subscribers(self, topic: str) -> int:
        """How many listen to a topic."""
        return self._node.count_subscribers(topic)

    def spin(self) -> None:
        """Begin to run callbacks."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and the node. Safe to call twice."""
        self._executor.shutdown()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout=2.0)
        self._node.destroy_node()
        if self._mine and self._rclpy.ok():
            self._rclpy.shutdown()
