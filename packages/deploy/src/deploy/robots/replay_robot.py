"""A log as a robot: it gives the readings of a run again, and keeps what is sent to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from deploy.bundles.manifest import Bundle
from deploy.control.schedule import Slot
from deploy.errors import LogError
from deploy.interfaces import Array, DepthFrame, JointCommand, RobotSpec, RobotState
from deploy.logs.reading import read_log

NEEDED = ("/joint_states", "/imu", "/cmd_vel", "/controller", "/timing")
OPTIONAL = ("/joint_commands", "/policy/obs", "/policy/action", "/depth/image", "/foot_contact")


@dataclass(frozen=True)
class LoggedTick:
    """One tick of a log, joints in policy order.

    Attributes:
        slot: Its slot of the schedule.
        mode: Mode of the controller.
        state: The reading.
        command: (vx, vy, yaw_rate).
        sent: Joint targets that were sent, shape (12,), rad; None while damped.
        obs: What the policy read, shape (P,); None where it did not run.
        action: What it answered, shape (12,).
        frame: The image that entered the depth encoder at this tick.
        picture_tick: Policy tick to which that image belongs, -1: none.
        seen_tick: Policy tick of the image in use, -1: none.
    """

    slot: Slot
    mode: str
    state: RobotState
    command: Array
    sent: Array | None
    obs: NDArray[np.float32] | None
    action: NDArray[np.float32] | None
    frame: DepthFrame | None
    picture_tick: int
    seen_tick: int


class ReplayRobot:
    """A `RobotInterface` that lives through a log; its clock is virtual and stands at the tick in turn.

    Attributes:
        ticks: All of the log.
        sent: What `write` was given, by tick.
    """

    def __init__(self, log: str | Path, bundle: Bundle) -> None:
        """Read a log.

        Args:
            log: A complete .mcap file of this package.
            bundle: The bundle to be run on it; the log names its joints.

        Raises:
            LogError: The file is missing, torn, altered, or not a log of this package.
        """
        path = Path(log)
        info = read_log(path).info
        with AnyReader([path]) as reader:
            connections = [c for c in reader.connections if c.topic in NEEDED + OPTIONAL]
            messages: dict[int, dict[str, Any]] = {}
            for connection, time, raw in reader.messages(connections=connections):
                messages.setdefault(time, {})[connection.topic] = reader.deserialize(raw, connection.msgtype)
        self.ticks = [_tick(path, time, tick) for time, tick in sorted(messages.items())]
        names = tuple(next(iter(messages.values()))["/joint_states"].name)
        self.spec = RobotSpec(f"{info.robot}, replayed", names, feet=bundle.robot.feet, noiseless=True)
        self.sent: dict[int, JointCommand] = {}
        self._index = 0

    @property
    def clock(self) -> ReplayRobot:
        """The robot is its own virtual clock."""
        return self

    @property
    def virtual(self) -> bool:
        """Time passes only in `sleep_until`."""
        return True

    @property
    def tick(self) -> LoggedTick:
        """The tick in turn."""
        return self.ticks[self._index]

    def go_to(self, index: int) -> LoggedTick:
        """Make a tick the one in turn."""
        self._index = index
        return self.ticks[index]

    def lost_before(self, index: int) -> int:
        """How many ticks are missing from the log before one: a disk was slow, or the log was recovered."""
        slot = self.ticks[index].slot
        return slot.index - slot.skipped - 1 - self.ticks[index - 1].slot.index if index else 0

    def now_ns(self) -> int:
        """Time of the tick in turn, as soon as its reading is there, ns."""
        return max(self.tick.slot.start_ns, self.tick.state.stamp_ns)

    def sleep_until(self, time_ns: int) -> None:
        """Go on to the first tick that started at `time_ns` or later; at the end of the log, stay."""
        while self.tick.slot.start_ns < time_ns and self._index + 1 < len(self.ticks):
            self._index += 1

    def start(self) -> None:
        """Nothing to take over."""

    def stop(self) -> None:
        """Nothing to give back."""

    def read(self) -> RobotState:
        """The reading of the tick in turn."""
        return self.tick.state

    def read_depth(self) -> DepthFrame | None:
        """The image that entered the depth encoder at the tick in turn, as it read it."""
        return self.tick.frame

    def write(self, command: JointCommand) -> None:
        """Keep a command."""
        self.sent[self._index] = command

    def damp(self) -> None:
        """Nothing to damp."""


def _tick(path: Path, time: int, messages: Mapping[str, Any]) -> LoggedTick:
    if absent := [topic for topic in NEEDED if topic not in messages]:
        raise LogError(f"{path}: no {absent[0]} at {time} ns; the log is incomplete: it cannot be replayed")
    timing, joints, imu = messages["/timing"], messages["/joint_states"], messages["/imu"]
    linear, turn = messages["/cmd_vel"].twist.linear, messages["/cmd_vel"].twist.angular
    contact = messages.get("/foot_contact")
    values = {
        name: getattr(messages[topic], field)
        for name, topic, field in (
            ("sent", "/joint_commands", "position"),
            ("obs", "/policy/obs", "data"),
            ("action", "/policy/action", "data"),
        )
        if topic in messages
    }
    slot = Slot(timing.tick, timing.due_ns, timing.start_ns, timing.late, timing.skipped)
    state = RobotState(
        stamp_ns=timing.state_stamp_ns,
        seq=timing.tick,
        q=joints.position,
        dq=joints.velocity,
        tau=joints.effort,
        quat_wxyz=np.array([imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z]),
        gyro=_vector(imu.angular_velocity),
        acc=_vector(imu.linear_acceleration),
        contact=None if contact is None else np.asarray(contact.data) > 0.5,
    )
    return LoggedTick(
        slot=slot,
        mode=messages["/controller"].mode,
        state=state,
        command=np.array([linear.x, linear.y, turn.z]),
        sent=values.get("sent"),
        obs=values.get("obs"),
        action=values.get("action"),
        frame=_frame(messages.get("/depth/image"), timing.tick),
        picture_tick=timing.picture_tick,
        seen_tick=timing.seen_tick,
    )


def _vector(message: Any) -> Array:
    return np.array([message.x, message.y, message.z])


def _frame(message: Any, seq: int) -> DepthFrame | None:
    if message is None:
        return None
    stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    image = message.data.view("<f4").reshape(message.height, message.width)
    return DepthFrame(stamp, seq, image, prepared=True)
