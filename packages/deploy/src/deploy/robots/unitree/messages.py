"""Between the arrays of `RobotInterface` and the messages of a Go2."""

# pyright: reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportGeneralTypeIssues=false, reportOperatorIssue=false
# To the checker an IDL array is no sequence.
from __future__ import annotations

import numpy as np

from deploy.interfaces import JointCommand, RobotSpec, RobotState
from deploy.robots.unitree.crc import low_cmd_crc
from deploy.robots.unitree.wire import LowCmd, LowState

COMMANDS, STATES = "rt/lowcmd", "rt/lowstate"
JOINTS = 12
HEAD = (0xFE, 0xEF)
LOW_LEVEL = 0xFF
SERVO = 0x01
"""Motor mode: closed loop."""

NO_POSITION, NO_VELOCITY = 2.146e9, 16000.0
"""Targets of a motor that is not to be controlled."""

_L2, _B = 1 << 5, 1 << 1
"""Buttons of the remote control, bits of its bytes 2 and 3; held together they are the vendor's own damping."""


def low_cmd(command: JointCommand, spec: RobotSpec) -> LowCmd:
    """A command with its checksum.

    Args:
        command: In the robot's order, finite.
        spec: The robot; targets are cut to its joint limits.
    """
    message = LowCmd(head=list(HEAD), level_flag=LOW_LEVEL)
    target = np.clip(command.q, spec.lower, spec.upper)
    for index, motor in enumerate(message.motor_cmd):
        motor.mode = SERVO
        motor.q, motor.dq = NO_POSITION, NO_VELOCITY
        if index < JOINTS:
            motor.q, motor.dq = float(target[index]), float(command.dq[index])
            motor.kp, motor.kd = float(command.kp[index]), float(command.kd[index])
            motor.tau = float(command.tau[index])
    message.crc = low_cmd_crc(message)
    return message


def robot_state(message: LowState, stamp_ns: int, seq: int, contact_force: int) -> RobotState:
    """A reading.

    Args:
        message: What the robot sent.
        stamp_ns: Its time on our clock, ns.
        seq: Its number.
        contact_force: Counts of a foot's sensor above which it touches the ground.
    """
    motors, imu, remote = message.motor_state[:JOINTS], message.imu_state, message.wireless_remote
    return RobotState(
        stamp_ns=stamp_ns,
        seq=seq,
        q=np.array([motor.q for motor in motors]),
        dq=np.array([motor.dq for motor in motors]),
        tau=np.array([motor.tau_est for motor in motors]),
        quat_wxyz=np.array(imu.quaternion, dtype=np.float64),
        gyro=np.array(imu.gyroscope, dtype=np.float64),
        acc=np.array(imu.accelerometer, dtype=np.float64),
        contact=np.array(message.foot_force) > contact_force,
        battery=(float(message.power_v), float(message.power_a)),
        operator_stop=bool(remote[2] & _L2 and remote[3] & _B),
    )


class StampClock:
    """Puts the robot's millisecond counter onto our clock.

    A message is as old as its counter says, also one that lay in the queue, one that the robot keeps repeating, and the
    last one of a robot that has stopped. The smallest delay seen so far is taken for no delay; it may grow by one part
    in a thousand, far more than two quartz clocks drift apart.
    """

    DRIFT = 1e-3
    WRAP = 2**32

    def __init__(self) -> None:
        self._tick: int | None = None
        self._elapsed_ms = 0
        self._offset_ns = 0
        self._seen_ns = 0

    def stamp(self, tick: int, now_ns: int) -> int:
        """Time on our clock, ns, of a message with counter `tick` that is read at `now_ns`.

        Raises:
            ValueError: The counter went back, so nothing tells the age any more.
        """
        if self._tick is None:
            self._elapsed_ms, self._offset_ns = 0, now_ns
        elif self._went_back(tick):
            raise ValueError(f"the counter of its readings went back from {self._tick} to {tick}")
        else:
            self._elapsed_ms += (tick - self._tick) % self.WRAP
            if tick != self._tick:
                grown = self._offset_ns + round(self.DRIFT * (now_ns - self._seen_ns))
                self._offset_ns = min(now_ns - self._elapsed_ms * 1_000_000, grown)
        if tick != self._tick:
            self._tick, self._seen_ns = tick, now_ns
        return self._offset_ns + self._elapsed_ms * 1_000_000

    def _went_back(self, tick: int) -> bool:
        """Whether the counter went back: forward by more than half of its range means that."""
        assert self._tick is not None
        return (tick - self._tick) % self.WRAP > self.WRAP // 2
