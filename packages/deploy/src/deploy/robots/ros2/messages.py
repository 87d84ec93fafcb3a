"""Between the arrays of `RobotInterface` and standard ROS 2 messages; any object with their fields will do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.depth.sources import to_metres
from deploy.errors import RobotError
from deploy.interfaces import Array, Intrinsics, JointCommand, RobotState

SERVO_ROWS = ("position", "velocity", "kp", "kd", "effort")
"""Rows of a servo command; the columns are joints."""


def stamp_ns(header: Any) -> int:
    """Time of a `std_msgs/msg/Header`, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def joint_arrays(message: Any, names: tuple[str, ...], topic: str) -> tuple[Array, Array, Array]:
    """Angles, velocities and torques of a `sensor_msgs/msg/JointState`, in the order of `names`; others are left out.

    Raises:
        RobotError: A joint or one of the three is missing.
    """
    place = {name: index for index, name in enumerate(message.name)}
    if missing := [name for name in names if name not in place]:
        raise RobotError(f"{topic}: has no joint {missing}, only {list(message.name)}; is this the driver's topic?")
    order = [place[name] for name in names]
    found = []
    for field in ("position", "velocity", "effort"):
        values = np.asarray(getattr(message, field), dtype=np.float64)
        if len(values) != len(message.name):
            raise RobotError(
                f"{topic}: {field} has {len(values)} of {len(message.name)} values; the driver must fill it"
            )
        found.append(values[order])
    return found[0], found[1], found[2]


def robot_state(joints: Any, imu: Any, names: tuple[str, ...], topics: tuple[str, str], seq: int) -> RobotState:
    """A reading.

    Args:
        joints: `sensor_msgs/msg/JointState`.
        imu: `sensor_msgs/msg/Imu`, in the frame of the base.
        names: The joints wanted, in order.
        topics: Where the two came from.
        seq: Number of the reading.

    Raises:
        RobotError: Something is missing in them.
    """
    q, dq, tau = joint_arrays(joints, names, topics[0])
    if imu.orientation_covariance[0] == -1.0:  # the message's own sign for that
        raise RobotError(f"{topics[1]}: gives no orientation; use an IMU driver or filter that does")
    turn, gyro, acc = imu.orientation, imu.angular_velocity, imu.linear_acceleration
    return RobotState(
        stamp_ns=min(stamp_ns(joints.header), stamp_ns(imu.header)),  # as old as its older half
        seq=seq,
        q=q,
        dq=dq,
        tau=tau,
        quat_wxyz=np.array([turn.w, turn.x, turn.y, turn.z]),
        gyro=np.array([gyro.x, gyro.y, gyro.z]),
        acc=np.array([acc.x, acc.y, acc.z]),
    )


def fill_servo(message: Any, dimension: Any, command: JointCommand, names: tuple[str, ...]) -> Any:
    """A servo command as `std_msgs/msg/Float64MultiArray`: rows `SERVO_ROWS`, columns joints, both named in the layout.

    Args:
        message: An empty message, to be filled.
        dimension: Class `std_msgs/msg/MultiArrayDimension`.
        command: In the order of `names`.
        names: Of the joints.
    """
    table = np.stack((command.q, command.dq, command.kp, command.kd, command.tau))
    message.layout.dim = [
        dimension(label=" ".join(SERVO_ROWS), size=len(SERVO_ROWS), stride=table.size),
        dimension(label=" ".join(names), size=len(names), stride=len(names)),
    ]
    message.layout.data_offset = 0
    message.data = table.reshape(-1).tolist()
    return message


def depth_image(message: Any, topic: str, metres_per_count: float = 1e-3) -> NDArray[np.float32]:
    """Depths of a `sensor_msgs/msg/Image` (16UC1 or 32FC1), shape (height, width), m.

    Raises:
        RobotError: It is no depth image.
    """
    types = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
    if message.encoding not in types:
        raise RobotError(f"{topic}: its encoding is {message.encoding!r}; need a depth image, 16UC1 or 32FC1")
    dtype = np.dtype((">" if message.is_bigendian else "<") + types[message.encoding])
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if step < width * dtype.itemsize or data.size != height * step:
        raise RobotError(f"{topic}: {data.size} bytes do not make {height} rows of {step} with {width} pixels each")
    rows = np.ascontiguousarray(data.reshape(height, step)[:, : width * dtype.itemsize])
    return to_metres(rows.view(dtype).astype(dtype.newbyteorder("=")), metres_per_count)


def intrinsics(message: Any, topic: str) -> Intrinsics:
    """Those of a `sensor_msgs/msg/CameraInfo`, which counts from the centre of the first pixel.

    Raises:
        RobotError: The camera is not calibrated, or its image is distorted.
    """
    fx, fy = float(message.k[0]), float(message.k[4])
    if not (fx > 0 and fy > 0):
        raise RobotError(f"{topic}: the camera is not calibrated, its k is {list(message.k)}")
    if any(message.d):
        raise RobotError(f"{topic}: the image is distorted (d is {list(message.d)}); use the rectified one")
    return Intrinsics(fx, fy, float(message.k[2]) + 0.5, float(message.k[5]) + 0.5)
