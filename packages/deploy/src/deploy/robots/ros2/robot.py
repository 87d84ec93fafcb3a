"""A robot whose driver speaks ROS 2: joint states and IMU in, servo commands out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from deploy.control.clock import WallClock
from deploy.depth.sources import DepthSource
from deploy.errors import RobotError
from deploy.interfaces import Clock, DepthFrame, EnergyReading, JointCommand, RobotSpec, RobotState
from deploy.robots.energy_meter import EnergyMeter
from deploy.robots.ros2.messages import fill_servo, joint_arrays, robot_state, stamp_ns
from deploy.robots.ros2.node import Ros2Node, message_type

SERVO = "std_msgs/msg/Float64MultiArray"


@dataclass(frozen=True)
class Ros2Config:
    """Topics and patience.

    Attributes:
        joint_states: `sensor_msgs/msg/JointState` with position, velocity and effort.
        imu: `sensor_msgs/msg/Imu` in the frame of the base, with orientation.
        servo: Where commands go, see `deploy.robots.ros2.messages.fill_servo`.
        wait_s: How long `start` waits for each of them, s.
        damping: Gain of `damp`, N m s/rad.
    """

    joint_states: str = "/joint_states"
    imu: str = "/imu"
    servo: str = "/joint_servo"
    wait_s: float = 3.0
    damping: float = 3.0


class Ros2Robot:
    """A `RobotInterface` on topics; time stamps of the driver count, so its clock must be this computer's."""

    def __init__(
        self, spec: RobotSpec, config: Ros2Config, depth: DepthSource | None = None, clock: Clock | None = None
    ) -> None:
        self._spec = spec
        self._config = config
        self._depth = depth
        self._clock = clock or WallClock()
        self._lock = threading.RLock()  # a signal may damp in the middle of a write
        self._node: Ros2Node | None = None
        self._publish: Callable[[Any], None] | None = None
        self._joints: Any = None
        self._imu: Any = None
        self._count = 0
        self._counting = threading.Lock()
        self._meter = EnergyMeter(len(spec.joint_names))

    @property
    def spec(self) -> RobotSpec:
        """As given."""
        return self._spec

    @property
    def clock(self) -> Clock:
        """Wall time."""
        return self._clock

    def start(self) -> None:
        """Join the topics; nothing is sent yet.

        Raises:
            RobotError: ROS 2 is missing, a topic is silent, nobody listens, or somebody else sends commands.
        """
        config = self._config
        self._node = node = Ros2Node("legged_deploy")
        node.subscribe("sensor_msgs/msg/JointState", config.joint_states, self._take_joints)
        node.subscribe("sensor_msgs/msg/Imu", config.imu, self._take_imu)
        node.spin()
        self._wait(lambda: self._joints is not None, f"nothing arrives on {config.joint_states}")
        self._wait(lambda: self._imu is not None, f"nothing arrives on {config.imu}")
        if node.publishers(config.servo):
            raise RobotError(f"ROS 2: another node publishes on {config.servo}; stop it, two make the legs thrash")
        if self._depth is not None:
            self._depth.start(self._clock)
        self._publish = node.publisher(SERVO, config.servo)
        self._wait(lambda: node.subscribers(config.servo) > 0, f"nobody listens to {config.servo}")

    def stop(self) -> None:
        """Leave the topics."""
        with self._lock:
            node, self._node, self._publish = self._node, None, None
        if self._depth is not None:
            self._depth.stop()
        if node is not None:
            node.close()

    def read(self) -> RobotState:
        """The latest state.

        Raises:
            RobotError: The robot is not started, its messages lack something, or somebody else commands it too.
        """
        node, joints, imu = self._node, self._joints, self._imu
        if node is None or joints is None or imu is None:
            raise RobotError("ROS 2: not started")
        if node.publishers(self._config.servo) > 1:
            raise RobotError(
                f"ROS 2: another node publishes on {self._config.servo}; stop it, two make the legs thrash"
            )
        topics = self._config.joint_states, self._config.imu
        return robot_state(joints, imu, self._spec.joint_names, topics, self._count)

    def read_depth(self) -> DepthFrame | None:
        """The latest image of the depth camera, None without one."""
        return None if self._depth is None else self._depth.latest()

    def energy(self) -> EnergyReading | None:
        """Work of the joints, from every `JointState` that the driver sent; the effort must be measured, not asked."""
        with self._counting:
            reading = self._meter.read()
        return reading if reading.states else None

    def write(self, command: JointCommand) -> None:
        """Send a command.

        Raises:
            RobotError: The robot is not started, or a number is not finite; then it is damped instead.
        """
        if not command.finite:
            self.damp()
            raise RobotError("ROS 2: a command is not finite; the robot was damped instead")
        if not self._send(command):
            raise RobotError("ROS 2: not started")

    def damp(self) -> None:
        """No stiffness, `damping` on every joint; from any thread. Before `start` and after `stop` nothing is sent."""
        self._send(JointCommand.limp(len(self._spec.joint_names), self._config.damping))

    def _send(self, command: JointCommand) -> bool:
        with self._lock:
            if self._publish is None:
                return False
            dimension = message_type("std_msgs/msg/MultiArrayDimension")
            self._publish(fill_servo(message_type(SERVO)(), dimension, command, self._spec.joint_names))
            return True

    def _take_joints(self, message: Any) -> None:
        last, self._joints = self._joints, message
        self._count += 1
        if last is None:
            return
        with suppress(RobotError), self._counting:  # `read` says what is wrong with it
            _, dq, tau = joint_arrays(message, self._spec.joint_names, self._config.joint_states)
            self._meter.add(dq, tau, max(stamp_ns(message.header) - stamp_ns(last.header), 0) * 1e-9)

    def _take_imu(self, message: Any) -> None:
        self._imu = message

    def _wait(self, condition: Callable[[], bool], problem: str) -> None:
        end = time.monotonic() + self._config.wait_s
        while not condition():
            if time.monotonic() > end:
                raise RobotError(
                    f"ROS 2: {problem} within {self._config.wait_s:g} s; `ros2 topic list` shows what there is: is the "
                    "driver running, with the same ROS_DOMAIN_ID, and are the topics named as in its launch file?"
                )
            time.sleep(0.01)
