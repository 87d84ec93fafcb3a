"""The messages on the wire, as `cyclonedds` sends them.

Names, order and types of the members are given by the robot: DDS compares them when it matches the two sides.
"""

# No `from __future__ import annotations`: cyclonedds reads the annotations as types.
# pyright: reportMissingImports=false, reportInvalidTypeForm=false, reportUntypedBaseClass=false
# pyright: reportInvalidTypeArguments=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# pyright: reportCallIssue=false, reportArgumentType=false
# ruff: noqa: RUF009 (`zeros` and `each` return fields with a default factory)
from dataclasses import dataclass, field

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import autoid, final
from cyclonedds.idl.types import array, float32, int16, int32, int64, sequence, uint8, uint16, uint32

MOTORS = 20
"""Slots for motors; a Go2 uses the first twelve."""


def zeros(count: int) -> list[int]:
    """A field of `count` zeros, one of its own for each message."""
    return field(default_factory=lambda: [0] * count)


def each(kind: type) -> list:
    """A field with one `kind` per motor."""
    return field(default_factory=lambda: [kind() for _ in range(MOTORS)])


@dataclass
@final
@autoid("sequential")
class MotorCmd(IdlStruct, typename="unitree_go.msg.dds_.MotorCmd_"):
    """Servo law of one motor: rad, rad/s, N m, N m/rad, N m s/rad; mode 1 is closed loop."""

    mode: uint8 = 0
    q: float32 = 0.0
    dq: float32 = 0.0
    tau: float32 = 0.0
    kp: float32 = 0.0
    kd: float32 = 0.0
    reserve: array[uint32, 3] = zeros(3)


@dataclass
@final
@autoid("sequential")
class BmsCmd(IdlStruct, typename="unitree_go.msg.dds_.BmsCmd_"):
    """Battery: 0 leaves it on."""

    off: uint8 = 0
    reserve: array[uint8, 3] = zeros(3)


@dataclass
@final
@autoid("sequential")
class LowCmd(IdlStruct, typename="unitree_go.msg.dds_.LowCmd_"):
    """Command to all motors on `rt/lowcmd`; ignored unless head, level flag and CRC are right."""

    head: array[uint8, 2] = zeros(2)
    level_flag: uint8 = 0
    frame_reserve: uint8 = 0
    sn: array[uint32, 2] = zeros(2)
    version: array[uint32, 2] = zeros(2)
    bandwidth: uint16 = 0
    motor_cmd: array[MotorCmd, MOTORS] = each(MotorCmd)
    bms_cmd: BmsCmd = field(default_factory=BmsCmd)
    wireless_remote: array[uint8, 40] = zeros(40)
    led: array[uint8, 12] = zeros(12)
    fan: array[uint8, 2] = zeros(2)
    gpio: uint8 = 0
    reserve: uint32 = 0
    crc: uint32 = 0


@dataclass
@final
@autoid("sequential")
class ImuState(IdlStruct, typename="unitree_go.msg.dds_.IMUState_"):
    """Quaternion w, x, y, z; rad/s and m/s^2 in the frame of the base; roll, pitch, yaw in rad."""

    quaternion: array[float32, 4] = zeros(4)
    gyroscope: array[float32, 3] = zeros(3)
    accelerometer: array[float32, 3] = zeros(3)
    rpy: array[float32, 3] = zeros(3)
    temperature: uint8 = 0


@dataclass
@final
@autoid("sequential")
class MotorState(IdlStruct, typename="unitree_go.msg.dds_.MotorState_"):
    """Reading of one motor: rad, rad/s, rad/s^2, N m (from the current), deg C; packets lost."""

    mode: uint8 = 0
    q: float32 = 0.0
    dq: float32 = 0.0
    ddq: float32 = 0.0
    tau_est: float32 = 0.0
    q_raw: float32 = 0.0
    dq_raw: float32 = 0.0
    ddq_raw: float32 = 0.0
    temperature: uint8 = 0
    lost: uint32 = 0
    reserve: array[uint32, 2] = zeros(2)


@dataclass
@final
@autoid("sequential")
class BmsState(IdlStruct, typename="unitree_go.msg.dds_.BmsState_"):
    """Battery: charge in percent, current in mA, cell voltages in mV."""

    version_high: uint8 = 0
    version_low: uint8 = 0
    status: uint8 = 0
    soc: uint8 = 0
    current: int32 = 0
    cycle: uint16 = 0
    bq_ntc: array[uint8, 2] = zeros(2)
    mcu_ntc: array[uint8, 2] = zeros(2)
    cell_vol: array[uint16, 15] = zeros(15)


@dataclass
@final
@autoid("sequential")
class LowState(IdlStruct, typename="unitree_go.msg.dds_.LowState_"):
    """All sensors on `rt/lowstate`; `tick` counts ms, `power_v` and `power_a` are V and A at the battery."""

    head: array[uint8, 2] = zeros(2)
    level_flag: uint8 = 0
    frame_reserve: uint8 = 0
    sn: array[uint32, 2] = zeros(2)
    version: array[uint32, 2] = zeros(2)
    bandwidth: uint16 = 0
    imu_state: ImuState = field(default_factory=ImuState)
    motor_state: array[MotorState, MOTORS] = each(MotorState)
    bms_state: BmsState = field(default_factory=BmsState)
    foot_force: array[int16, 4] = zeros(4)
    foot_force_est: array[int16, 4] = zeros(4)
    tick: uint32 = 0
    wireless_remote: array[uint8, 40] = zeros(40)
    bit_flag: uint8 = 0
    adc_reel: float32 = 0.0
    temperature_ntc1: uint8 = 0
    temperature_ntc2: uint8 = 0
    power_v: float32 = 0.0
    power_a: float32 = 0.0
    fan_frequency: array[uint16, 4] = zeros(4)
    reserve: uint32 = 0
    crc: uint32 = 0


@dataclass
@final
@autoid("sequential")
class RequestIdentity(IdlStruct, typename="unitree_api.msg.dds_.RequestIdentity_"):
    """Number of a request, repeated in its response, and what is asked."""

    id: int64 = 0
    api_id: int64 = 0


@dataclass
@final
@autoid("sequential")
class RequestLease(IdlStruct, typename="unitree_api.msg.dds_.RequestLease_"):
    """Lease under which a request is made; 0: none."""

    id: int64 = 0


@dataclass
@final
@autoid("sequential")
class RequestPolicy(IdlStruct, typename="unitree_api.msg.dds_.RequestPolicy_"):
    """How a request is treated."""

    priority: int32 = 0
    noreply: bool = False


@dataclass
@final
@autoid("sequential")
class RequestHeader(IdlStruct, typename="unitree_api.msg.dds_.RequestHeader_"):
    """Head of a request."""

    identity: RequestIdentity = field(default_factory=RequestIdentity)
    lease: RequestLease = field(default_factory=RequestLease)
    policy: RequestPolicy = field(default_factory=RequestPolicy)


@dataclass
@final
@autoid("sequential")
class Request(IdlStruct, typename="unitree_api.msg.dds_.Request_"):
    """A request to a service of the robot; `parameter` is JSON."""

    header: RequestHeader = field(default_factory=RequestHeader)
    parameter: str = ""
    binary: sequence[uint8] = field(default_factory=list)


@dataclass
@final
@autoid("sequential")
class ResponseStatus(IdlStruct, typename="unitree_api.msg.dds_.ResponseStatus_"):
    """0: done."""

    code: int32 = 0


@dataclass
@final
@autoid("sequential")
class ResponseHeader(IdlStruct, typename="unitree_api.msg.dds_.ResponseHeader_"):
    """Head of a response."""

    identity: RequestIdentity = field(default_factory=RequestIdentity)
    status: ResponseStatus = field(default_factory=ResponseStatus)


@dataclass
@final
@autoid("sequential")
class Response(IdlStruct, typename="unitree_api.msg.dds_.Response_"):
    """A response; `data` is JSON."""

    header: ResponseHeader = field(default_factory=ResponseHeader)
    data: str = ""
    binary: sequence[uint8] = field(default_factory=list)
