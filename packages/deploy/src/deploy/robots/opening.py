"""Robots of metal, opened by name; what each needs is imported only then."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from deploy.bundles.manifest import Bundle
from deploy.depth.realsense import RealSenseConfig, RealSenseDepth
from deploy.depth.ros2 import Ros2Depth, Ros2DepthConfig
from deploy.depth.sources import DepthSource
from deploy.errors import RobotError
from deploy.interfaces import RobotInterface, RobotSpec
from deploy.robots.ros2.robot import Ros2Config, Ros2Robot
from deploy.robots.specs import ROBOTS

DRIVERS = ("go2", "ros2")


@dataclass(frozen=True)
class Connection:
    """How to reach a robot and its camera."""

    interface: str = "eth0"
    """Network interface that a Go2 is wired to; lo for a simulator on this machine."""
    domain: int = 0
    """DDS domain of a Go2."""
    allow_silent_publishers: bool = False
    """Accept programs that could command a Go2 but have sent nothing."""
    depth: Literal["none", "realsense", "ros2"] = "none"
    """Depth camera."""
    realsense: RealSenseConfig = field(default_factory=RealSenseConfig)
    """Stream of a RealSense camera."""
    ros2: Ros2Config = field(default_factory=Ros2Config)
    """Topics of a robot behind ROS 2."""
    ros2_depth: Ros2DepthConfig = field(default_factory=Ros2DepthConfig)
    """Topics of a depth camera behind ROS 2."""


def open_robot(name: str, bundle: Bundle, connection: Connection | None = None) -> RobotInterface:
    """Make the interface to a robot; nothing is sent, and nothing opened, before its `start`.

    Args:
        name: "go2" (DDS) or "ros2" (any robot whose driver takes servo commands, with the joints of the bundle).
        bundle: What shall run on it.
        connection: How to reach it.

    Raises:
        RobotError: There is no such robot, its library is missing, or the policy sees and no camera is named.
    """
    connection = connection or Connection()
    if name not in DRIVERS:
        raise RobotError(f"no driver for a robot {name!r}; choose mujoco, {' or '.join(DRIVERS)}")
    if bundle.depth is not None and connection.depth == "none":
        raise RobotError(f"{bundle.name} sees: name the robot's depth camera, realsense or ros2 (--connect.depth)")
    camera = _camera(connection) if bundle.depth is not None else None
    if name == "ros2":
        return Ros2Robot(_behind_ros2(bundle), connection.ros2, camera)
    try:
        from deploy.robots.unitree.robot import UnitreeConfig, UnitreeRobot
    except ImportError as error:
        raise RobotError(f"a Go2 needs cyclonedds ({error}): pip install 'legged-deploy[unitree]'") from error
    config = UnitreeConfig(
        connection.interface, connection.domain, allow_silent_publishers=connection.allow_silent_publishers
    )
    return UnitreeRobot(config, camera)


def _behind_ros2(bundle: Bundle) -> RobotSpec:
    """The robot that a bundle was made for, as far as it is known; feet and rates are its driver's affair."""
    name, known = f"{bundle.robot.name} over ROS 2", ROBOTS.get(bundle.robot.name)
    if known is None or set(known.joint_names) != set(bundle.joint_names):
        return RobotSpec(name, bundle.joint_names)
    return replace(known, name=name, feet=None, state_hz=None, command_hz=None)


def _camera(connection: Connection) -> DepthSource:
    if connection.depth == "realsense":
        return RealSenseDepth(connection.realsense)
    return Ros2Depth(connection.ros2_depth)
