"""ROS 2 messages of a log, made from ticks without ROS: rosbags' type store, CDR bytes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from deploy.bundles.manifest import Bundle
from deploy.control.controller import Tick
from deploy.interfaces import Array, EnergyReading, GroundTruth
from deploy.policy.observation import rotate_inverse

WORLD, BASE, CAMERA = "world", "base", "camera_depth_optical_frame"
"""Frames: `world` has z up; `base` is the floating base, x forward, y left, z up; the camera looks along z."""

DEFINITIONS = {
    "legged_deploy/msg/Power": """
# Mechanical joint power and energy; per joint in the order of /joint_states.
std_msgs/Header header
float64 pos_w                  # sum of positive joint powers at this instant, W (paper eq. 10, one tick)
float64 net_w                  # sum of joint powers at this instant, W
float64 peak_w                 # largest pos_w at any state since the previous message, NaN where nothing measured it
float64 energy_pos_j           # positive work since the start, summed at the rate of the state, NaN as above
float64[12] joint_power_w      # at this instant
float64[12] joint_energy_pos_j # share of each joint in energy_pos_j
uint64 states                  # states summed since the start, 0 where nothing measured it
""",
    "legged_deploy/msg/Timing": """
# One tick of the control loop, times in ns on the robot's clock.
std_msgs/Header header
uint64 tick
int64 due_ns
int64 start_ns
int64 done_ns
int64 state_stamp_ns
int64 seen_tick            # policy tick of the image whose features the policy used, -1: none
int64 seen_stamp_ns        # when it was taken, -1: none
int64 picture_tick         # policy tick of the image that entered the depth encoder now, -1: none
bool late                  # started more than the tolerance after due_ns
uint32 skipped             # slots given up since the previous tick
""",
    "legged_deploy/msg/ControllerState": """
std_msgs/Header header
string mode                # idle, passive, stand_up, ready, ramp_in, policy, damp
string reason              # why the robot is damped
uint32 clamped             # joint targets cut to the joint limits at this tick
""",
}

TOPICS = {
    "/robot_description": "std_msgs/msg/String",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/joint_commands": "sensor_msgs/msg/JointState",
    "/imu": "sensor_msgs/msg/Imu",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/policy/obs": "std_msgs/msg/Float32MultiArray",
    "/policy/action": "std_msgs/msg/Float32MultiArray",
    "/policy/velocity": "geometry_msgs/msg/TwistStamped",
    "/policy/terrain": "std_msgs/msg/Float32MultiArray",
    "/policy/heading": "std_msgs/msg/Float32MultiArray",
    "/depth/image": "sensor_msgs/msg/Image",
    "/foot_contact": "std_msgs/msg/Float32MultiArray",
    "/battery": "sensor_msgs/msg/BatteryState",
    "/power": "legged_deploy/msg/Power",
    "/timing": "legged_deploy/msg/Timing",
    "/controller": "legged_deploy/msg/ControllerState",
    "/ground_truth": "nav_msgs/msg/Odometry",
}


@dataclass(frozen=True)
class Sample:
    """A tick and what was measured at the same instant.

    Attributes:
        tick: What the controller did.
        truth: Pose and velocity of a simulated base, None on hardware.
        energy: Work of the joints so far, in policy order; None where nothing counts it.
    """

    tick: Tick
    truth: GroundTruth | None = None
    energy: EnergyReading | None = None


class Encoder:
    """Message types and their CDR bytes."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in DEFINITIONS.items():
            self._store.register(get_types_from_msg(text, name))

    def make(self, typename: str, **fields: Any) -> Any:
        """A message of a type, from its fields."""
        return self._store.types[typename](**fields)

    def definition(self, typename: str) -> str:
        """The message definition in full, as a ros2msg schema."""
        return self._store.generate_msgdef(typename, ros_version=2)[0]

    def encode(self, message: Any) -> bytes:
        """CDR bytes of a message."""
        return bytes(self._store.serialize_cdr(message, message.__msgtype__))


class Composer:
    """Makes the messages of a tick; joints are named in policy order."""

    def __init__(self, bundle: Bundle, encoder: Encoder) -> None:
        self._make = encoder.make
        self._names = list(bundle.joint_names)
        self._torque_limit = bundle.per_joint("torque_limit")
        self._obs_label = " ".join(f"{term.name}[{term.size}]" for term in bundle.terms)

    def text(self, data: str) -> Any:
        """A std_msgs/String."""
        return self._make("std_msgs/msg/String", data=data)

    def messages(self, sample: Sample) -> Iterator[tuple[str, Any]]:
        """Topic and message of everything that is known about one tick."""
        tick = sample.tick
        state, sent, step = tick.state, tick.joint_command, tick.step
        seen, picture = (None, None) if step is None else (step.seen, step.picture)
        stamp = tick.slot.start_ns
        yield "/joint_states", self._joints(state.stamp_ns, state.q, state.dq, state.tau)
        if sent is not None:
            torque = sent.kp * (sent.q - state.q) + sent.kd * (sent.dq - state.dq) + sent.tau
            effort = np.clip(torque, -self._torque_limit, self._torque_limit)
            yield "/joint_commands", self._joints(sent.stamp_ns, sent.q, sent.dq, effort)
        yield "/imu", self._imu(sample)
        yield "/cmd_vel", self._twist_stamped(stamp, tick.command[:2], tick.command[2])
        if step is not None:
            yield "/policy/obs", self._array(step.obs, self._obs_label)
            yield "/policy/action", self._array(step.action, "action")
            if step.velocity is not None:
                yield "/policy/velocity", self._twist_stamped(stamp, step.velocity, 0.0)
        if seen is not None:
            yield "/policy/terrain", self._array(seen.terrain, "terrain")
            yield "/policy/heading", self._array(seen.heading, "heading")
        if picture is not None:
            yield "/depth/image", self._image(picture.stamp_ns, picture.image)
        if state.contact is not None:
            yield "/foot_contact", self._array(state.contact, "contact")
        if state.battery is not None:
            yield "/battery", self._battery(state.stamp_ns, *state.battery)
        yield "/power", self._power(sample)
        slot = tick.slot
        yield (
            "/timing",
            self._make(
                "legged_deploy/msg/Timing",
                header=self._header(stamp),
                tick=slot.index,
                due_ns=slot.due_ns,
                start_ns=slot.start_ns,
                done_ns=tick.done_ns,
                state_stamp_ns=state.stamp_ns,
                seen_tick=-1 if seen is None else seen.tick,
                seen_stamp_ns=-1 if seen is None else seen.stamp_ns,
                picture_tick=-1 if picture is None else picture.tick,
                late=slot.late,
                skipped=slot.skipped,
            ),
        )
        yield (
            "/controller",
            self._make(
                "legged_deploy/msg/ControllerState",
                header=self._header(stamp),
                mode=tick.mode.value,
                reason=tick.reason,
                clamped=tick.clamped,
            ),
        )
        if sample.truth is not None:
            yield "/ground_truth", self._odometry(state.stamp_ns, sample.truth)

    def _header(self, stamp_ns: int, frame: str = BASE) -> Any:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        time = self._make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self._make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def _vector(self, values: Array) -> Any:
        padded = [*map(float, values), 0.0, 0.0, 0.0]
        return self._make("geometry_msgs/msg/Vector3", x=padded[0], y=padded[1], z=padded[2])

    def _quaternion(self, wxyz: Array) -> Any:
        w, x, y, z = map(float, wxyz)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _joints(self, stamp_ns: int, position: Array, velocity: Array, effort: Array) -> Any:
        return self._make(
            "sensor_msgs/msg/JointState",
            header=self._header(stamp_ns, ""),
            name=self._names,
            position=position,
            velocity=velocity,
            effort=effort,
        )

    def _imu(self, sample: Sample) -> Any:
        state = sample.tick.state
        return self._make(
            "sensor_msgs/msg/Imu",
            header=self._header(state.stamp_ns),
            orientation=self._quaternion(state.quat_wxyz),
            orientation_covariance=np.zeros(9),
            angular_velocity=self._vector(state.gyro),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector(state.acc),
            linear_acceleration_covariance=np.zeros(9),
        )

    def _twist(self, linear: Array, angular: Array) -> Any:
        return self._make("geometry_msgs/msg/Twist", linear=self._vector(linear), angular=self._vector(angular))

    def _twist_stamped(self, stamp_ns: int, linear: Array, yaw_rate: float) -> Any:
        return self._make(
            "geometry_msgs/msg/TwistStamped",
            header=self._header(stamp_ns),
            twist=self._twist(linear, np.array([0.0, 0.0, yaw_rate])),
        )

    def _array(self, values: np.ndarray, label: str) -> Any:
        size = len(values)
        dim = self._make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)
        layout = self._make("std_msgs/msg/MultiArrayLayout", dim=[dim], data_offset=0)
        return self._make("std_msgs/msg/Float32MultiArray", layout=layout, data=values.astype(np.float32))

    def _image(self, stamp_ns: int, image: NDArray[np.float32]) -> Any:
        """The image as the network reads it, so that a replay feeds the very same numbers."""
        rows, columns = image.shape
        return self._make(
            "sensor_msgs/msg/Image",
            header=self._header(stamp_ns, CAMERA),
            height=rows,
            width=columns,
            encoding="32FC1",
            is_bigendian=0,
            step=4 * columns,
            data=np.ascontiguousarray(image, dtype="<f4").view(np.uint8).ravel(),
        )

    def _battery(self, stamp_ns: int, volts: float, amperes: float) -> Any:
        unknown = dict.fromkeys(("temperature", "charge", "capacity", "design_capacity", "percentage"), np.nan)
        status = dict.fromkeys(("power_supply_status", "power_supply_health", "power_supply_technology"), 0)
        return self._make(
            "sensor_msgs/msg/BatteryState",
            header=self._header(stamp_ns),
            voltage=volts,
            current=amperes,
            present=True,
            cell_voltage=np.zeros(0, np.float32),
            cell_temperature=np.zeros(0, np.float32),
            location="",
            serial_number="",
            **unknown,
            **status,
        )

    def _power(self, sample: Sample) -> Any:
        state, energy = sample.tick.state, sample.energy
        power = state.dq * state.tau
        joint_energy = np.full_like(power, np.nan) if energy is None else energy.joint_energy_pos_j
        return self._make(
            "legged_deploy/msg/Power",
            header=self._header(state.stamp_ns),
            pos_w=float(np.maximum(power, 0.0).sum()),
            net_w=float(power.sum()),
            peak_w=np.nan if energy is None else energy.peak_pos_w,
            energy_pos_j=float(joint_energy.sum()),
            joint_power_w=power,
            joint_energy_pos_j=joint_energy,
            states=0 if energy is None else energy.states,
        )

    def _odometry(self, stamp_ns: int, truth: GroundTruth) -> Any:
        """Pose in the world; twist in the base frame, as the message asks for."""
        x, y, z = map(float, truth.position)
        pose = self._make(
            "geometry_msgs/msg/Pose",
            position=self._make("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=self._quaternion(truth.quat_wxyz),
        )
        twist = self._twist(rotate_inverse(truth.quat_wxyz, truth.velocity), truth.angular_velocity)
        return self._make(
            "nav_msgs/msg/Odometry",
            header=self._header(stamp_ns, WORLD),
            child_frame_id=BASE,
            pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )
