"""What the controller needs from a robot and from a network: numpy arrays and two protocols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class RobotSpec:
    """What a robot is; None where nothing is known.

    Attributes:
        name: For messages and logs.
        joint_names: In the robot's own order, which all its arrays use; others bind by these names.
        lower: Smallest joint angles, rad.
        upper: Largest joint angles, rad.
        torque_limit: Largest joint torques, N m.
        velocity_limit: Largest joint velocities, rad/s.
        feet: Names of the feet, in the order of `RobotState.contact`.
        state_hz: Rate at which new readings come, Hz.
        command_hz: Highest rate of commands, Hz.
        noiseless: Whether readings may repeat exactly, as those of an ideal simulation do where it stands still. A real
            sensor that repeats itself has stopped.
    """

    name: str
    joint_names: tuple[str, ...]
    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    torque_limit: tuple[float, ...] | None = None
    velocity_limit: tuple[float, ...] | None = None
    feet: tuple[str, ...] | None = None
    state_hz: float | None = None
    command_hz: float | None = None
    noiseless: bool = False


@dataclass(frozen=True)
class RobotState:
    """One reading of the sensors.

    Attributes:
        stamp_ns: Time of the reading on the robot's clock, ns.
        seq: Number of the reading.
        q: Joint angles, shape (n,), rad.
        dq: Joint velocities, shape (n,), rad/s.
        tau: Torques that act at this instant, shape (n,), N m.
        quat_wxyz: Orientation of the base in the world, shape (4,).
        gyro: Angular velocity, base frame, shape (3,), rad/s.
        acc: Specific force (gravity included), base frame, shape (3,), m/s^2.
        contact: Feet that touch the ground, in the order of ``spec.feet``; None where nothing tells.
        battery: Voltage and current of the battery, V and A; None where unknown.
        operator_stop: The operator asks for a stop on the robot's own remote control.
    """

    stamp_ns: int
    seq: int
    q: Array
    dq: Array
    tau: Array
    quat_wxyz: Array
    gyro: Array
    acc: Array
    contact: NDArray[np.bool_] | None = None
    battery: tuple[float, float] | None = None
    operator_stop: bool = False


@dataclass(frozen=True)
class JointCommand:
    """A servo command per joint: torque = kp (q - q_measured) + kd (dq - dq_measured) + tau.

    Shapes (n,); rad, rad/s, N m/rad, N m s/rad, N m; `stamp_ns` on the robot's clock.
    """

    q: Array
    dq: Array
    kp: Array
    kd: Array
    tau: Array
    stamp_ns: int

    @classmethod
    def limp(cls, joints: int, damping: float, stamp_ns: int = 0) -> JointCommand:
        """No stiffness and no torque, `damping` (N m s/rad) on every joint."""
        zeros = np.zeros(joints)
        return cls(zeros, zeros, zeros, zeros + damping, zeros, stamp_ns)

    @property
    def finite(self) -> bool:
        """Whether every number is."""
        return all(bool(np.isfinite(each).all()) for each in (self.q, self.dq, self.kp, self.kd, self.tau))


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole model, px; pixel (row i, column j) looks through (j + 0.5, i + 0.5), rows counted downwards."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class DepthFrame:
    """A depth image.

    Attributes:
        stamp_ns: Time of the image on the robot's clock, ns.
        seq: Number of the image.
        image_m: Depth along the optical axis, shape (height, width), m; 0 or NaN where nothing was measured, inf
            where nothing is in sight.
        intrinsics: Of this image; None for one that has the field of view of the policy's camera.
        prepared: Whether `image_m` is what the network reads instead, (rows, columns) from -0.5 to 0.5: from a log.
    """

    stamp_ns: int
    seq: int
    image_m: NDArray[np.float32]
    intrinsics: Intrinsics | None = None
    prepared: bool = False


class Clock(Protocol):
    """The robot's time: real on hardware, virtual in simulation."""

    @property
    def virtual(self) -> bool:
        """Whether time passes only in `sleep_until`, so that waiting for a computation costs none."""
        ...

    def now_ns(self) -> int:
        """Current time, ns."""
        ...

    def sleep_until(self, time_ns: int) -> None:
        """Return at `time_ns`, at once if it has passed. A simulator advances its physics here."""
        ...


class RobotInterface(Protocol):
    """A robot that takes servo commands; arrays are in the order of ``spec.joint_names``."""

    @property
    def spec(self) -> RobotSpec:
        """Names, fixed for the life of the object."""
        ...

    @property
    def clock(self) -> Clock:
        """The clock that stamps states and paces the loop."""
        ...

    def start(self) -> None:
        """Take control of the robot; nothing moves before the first `write`."""
        ...

    def stop(self) -> None:
        """Give control back. Safe to call twice, and after a failed `start`."""
        ...

    def read(self) -> RobotState:
        """The latest state, without waiting."""
        ...

    def read_depth(self) -> DepthFrame | None:
        """The latest depth image, None where there is no camera."""
        ...

    def write(self, command: JointCommand) -> None:
        """Send a command; it holds until the next one."""
        ...

    def damp(self) -> None:
        """Go limp against damping. Works in every state and needs no valid reading."""
        ...


@dataclass(frozen=True)
class Seen:
    """What the depth encoder made of an image.

    Attributes:
        terrain: Latent of the terrain, shape (S,).
        heading: Directions to the next waypoints, shape (K,), rad.
        tick: Policy tick since the start to which the image belongs; -1: no image yet, zeros above.
        stamp_ns: When the image was taken; -1: no image yet.
    """

    terrain: Image
    heading: Image
    tick: int = -1
    stamp_ns: int = -1


@dataclass(frozen=True)
class PolicyOutput:
    """`action` (12,) as the network gave it; `velocity` (3,) its estimate, base frame, m/s, or None."""

    action: Array
    velocity: Array | None


class PolicyRuntime(Protocol):
    """Runs the networks of a bundle and keeps their recurrent states."""

    def reset(self) -> None:
        """Put all recurrent states to their initial values; no `see` is under way."""
        ...

    def step(self, obs: NDArray[np.float32], seen: Seen | None = None) -> PolicyOutput:
        """One tick: observation of shape (P,) in, action out, recurrent state moved on.

        A policy that sees is given what is in use at this tick.
        """
        ...

    def see(self, image: Image, obs: NDArray[np.float32]) -> tuple[Image, Image]:
        """One image (rows, columns) as the network reads it, with the observation of its tick.

        Called in a thread of its own, one call at a time, in the order of the images.

        Returns:
            Terrain latent (S,) and headings (K,), rad.
        """
        ...


@dataclass(frozen=True)
class GroundTruth:
    """What only a simulator knows; for measuring, never for control.

    Attributes:
        position: Base origin, world frame, shape (3,), m.
        quat_wxyz: Orientation of the base in the world, shape (4,).
        velocity: Of the base origin, world frame, shape (3,), m/s.
        angular_velocity: Base frame, shape (3,), rad/s.
        height_over_feet: World z of the base above the lowest foot, m.
    """

    position: Array
    quat_wxyz: Array
    velocity: Array
    angular_velocity: Array
    height_over_feet: float


@dataclass(frozen=True)
class EnergyReading:
    """Mechanical energy summed at the rate of the state, not of the loop.

    Attributes:
        joint_energy_pos_j: Positive work of each joint since the start (paper eq. 10 times the step), shape (n,), J.
        peak_pos_w: Largest positive power of all joints together since the previous reading, W.
        states: How many states were summed since the start.
    """

    joint_energy_pos_j: Array
    peak_pos_w: float
    states: int


@runtime_checkable
class Metered(Protocol):
    """A robot that counts the work of its joints at the rate of its states."""

    def energy(self) -> EnergyReading | None:
        """What it counted so far, joints in its own order; reading restarts the peak. None: it cannot tell any more."""
        ...


@runtime_checkable
class Simulated(Metered, Protocol):
    """A robot that can also be measured from outside."""

    def truth(self) -> GroundTruth:
        """Pose and velocity of the base, exact."""
        ...
