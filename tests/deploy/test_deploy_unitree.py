"""Unitree Go2 over DDS, against the vendor's own message definitions and checksum."""

import itertools
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from deploy.errors import RobotError
from deploy.interfaces import DepthFrame, JointCommand
from deploy.robots.specs import GO2
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'legged-deploy[unitree]'")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from deploy.robots.unitree import wire
from deploy.robots.unitree.crc import crc32, low_cmd_crc
from deploy.robots.unitree.domain import configuration
from deploy.robots.unitree.messages import StampClock, low_cmd, robot_state
from deploy.robots.unitree.robot import UnitreeConfig, UnitreeRobot

DOMAINS = itertools.count(91)
"""One for each test: DDS remembers a killed process for 10 s."""
LOW, HIGH = np.array(GO2.lower), np.array(GO2.upper)


@pytest.fixture(scope="module")
def vendor():
    """The vendor's message definitions and checksum."""
    sdk = pytest.importorskip("unitree_sdk2py", reason="needs unitree-sdk2py-dimos: the extra `test-unitree`")
    from unitree_sdk2py.utils.crc import CRC

    return sdk.idl.unitree_go.msg.dds_, sdk.idl.unitree_api.msg.dds_, CRC()


def servo(q, kp=30.0, kd=1.0) -> JointCommand:
    one = np.ones(12)
    return JointCommand(np.asarray(q, float), 0.0 * one, kp * one, kd * one, 0.0 * one, 0)


# ---------------------------------------------------------------------------------------------- checksum


def test_checksum_by_long_division():
    def slow(words):
        value = 0xFFFFFFFF
        for word in words:
            value ^= word
            for _ in range(32):
                value = ((value << 1) ^ (0x04C11DB7 if value & 0x80000000 else 0)) & 0xFFFFFFFF
        return value

    # CRC-32/MPEG-2 of "123456789" is 0x0376E6E7 in the catalogues; its first 8 bytes as big-endian words:
    assert crc32(b"43218765") == slow([0x31323334, 0x35363738])
    assert crc32(bytes(16)) == slow([0, 0, 0, 0])


def test_checksum_bytes_of_the_vendor():
    """Recorded from the vendor's library (unitree-sdk2py-dimos 1.0.3, crc_amd64.so)."""
    message = wire.LowCmd()
    assert low_cmd_crc(message) == VENDOR_CRC["zeros"]
    message = wire.LowCmd(head=[0xFE, 0xEF], level_flag=0xFF)
    for i, motor in enumerate(message.motor_cmd):
        motor.mode, motor.q, motor.dq, motor.tau, motor.kp, motor.kd = 1, 0.1 * i, -i, 0.5, 20.0 + i, 0.5
    assert low_cmd_crc(message) == VENDOR_CRC["motors"]


VENDOR_CRC = {"zeros": 0x4B5A4880, "motors": 0x8FB741BB}


@given(st.integers(0, 2**32 - 1), st.binary(min_size=62, max_size=62))
def test_checksum_and_bytes_equal_the_vendors(vendor, word, octets):
    go, _, crc = vendor
    numbers = np.random.default_rng(word).normal(0.0, 100.0, 100).astype(np.float32).tolist()
    ours, theirs = wire.LowCmd(), go.LowCmd_(*_vendor_low_cmd(go))
    for message in (ours, theirs):
        message.head, message.level_flag, message.frame_reserve = list(octets[:2]), octets[2], octets[3]
        message.sn, message.version, message.bandwidth = [word, 1], [2, word], word % 2**16
        message.bms_cmd.off, message.bms_cmd.reserve = octets[4], list(octets[4:7])
        message.wireless_remote, message.led = list(octets[7:47]), list(octets[47:59])
        message.fan, message.gpio, message.reserve, message.crc = list(octets[59:61]), octets[61], word, word
        for i, motor in enumerate(message.motor_cmd):
            motor.mode, motor.reserve = octets[i], [word, i, 0]
            motor.q, motor.dq, motor.tau, motor.kp, motor.kd = numbers[5 * i : 5 * i + 5]
    assert low_cmd_crc(ours) == crc.Crc(theirs)
    assert ours.serialize() == theirs.serialize()


def _vendor_low_cmd(go):
    motors = [go.MotorCmd_(0, 0.0, 0.0, 0.0, 0.0, 0.0, [0, 0, 0]) for _ in range(20)]
    return [0, 0], 0, 0, [0, 0], [0, 0], 0, motors, go.BmsCmd_(0, [0, 0, 0]), [0] * 40, [0] * 12, [0, 0], 0, 0, 0


# ---------------------------------------------------------------------------------------------- messages


def test_a_state_written_by_the_vendors_definition_is_read(vendor):
    go, _, _ = vendor
    motors = [go.MotorState_(1, 0.1 * i, 1.0 + i, 9.0, 0.5 * i, 9.0, 9.0, 9.0, 40, 3, [0, 0]) for i in range(20)]
    imu = go.IMUState_([0.5, -0.5, 0.5, -0.5], [0.1, 0.2, 0.3], [1.0, 2.0, 9.5], [7.0, 7.0, 7.0], 60)
    bms = go.BmsState_(1, 2, 3, 80, -1500, 12, [30, 31], [32, 33], list(range(15)))
    remote = [0] * 40
    message = go.LowState_(
        *([0xFE, 0xEF], 255, 0, [1, 2], [3, 4], 5, imu, motors, bms, [60, 20, 21, 0], [1, 2, 3, 4], 123456, remote),
        *(6, 7.0, 8, 9, 28.5, 1.5, [10, 11, 12, 13], 14, 15),
    )
    read = wire.LowState.deserialize(message.serialize())
    assert read.serialize() == message.serialize()
    state = robot_state(read, stamp_ns=5, seq=6, contact_force=20)
    np.testing.assert_allclose(state.q, 0.1 * np.arange(12), rtol=1e-6)
    np.testing.assert_allclose(state.dq, 1.0 + np.arange(12))
    np.testing.assert_allclose(state.tau, 0.5 * np.arange(12))
    np.testing.assert_allclose(state.quat_wxyz, [0.5, -0.5, 0.5, -0.5])
    np.testing.assert_allclose(state.gyro, [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(state.acc, [1.0, 2.0, 9.5])
    assert state.contact is not None
    assert state.contact.tolist() == [True, False, True, False]
    assert (state.battery, state.stamp_ns, state.seq) == ((28.5, 1.5), 5, 6)
    assert not state.operator_stop


@pytest.mark.parametrize(("octets", "stop"), [((0x20, 0x02), True), ((0x20, 0), False), ((0, 0x02), False)])
def test_the_remotes_damping_combination_stops(octets, stop):
    remote = [0, 0, *octets] + [0] * 36
    assert robot_state(wire.LowState(wireless_remote=remote), 0, 0, 20).operator_stop is stop


def test_service_messages_equal_the_vendors(vendor):
    _, api, _ = vendor
    ours = wire.Request(wire.RequestHeader(wire.RequestIdentity(2**40, 1001)), '{"a": 1}')
    header = api.RequestHeader_(api.RequestIdentity_(2**40, 1001), api.RequestLease_(0), api.RequestPolicy_(0, False))
    assert ours.serialize() == api.Request_(header, '{"a": 1}', []).serialize()
    theirs = api.Response_(api.ResponseHeader_(api.RequestIdentity_(7, 1003), api.ResponseStatus_(3104)), "{}", [1])
    read = wire.Response.deserialize(theirs.serialize())
    assert (read.header.identity.id, read.header.status.code, read.data, list(read.binary)) == (7, 3104, "{}", [1])


def test_a_command_is_cut_to_the_limits_and_leaves_other_motors_alone():
    command = servo(np.where(np.arange(12) % 2, 9.0, -9.0), kp=20.0, kd=0.5)
    message = low_cmd(command, GO2)
    sent = message.motor_cmd
    np.testing.assert_allclose([m.q for m in sent[:12]], np.where(np.arange(12) % 2, HIGH, LOW))
    assert {(m.mode, m.kp, m.kd, m.dq, m.tau) for m in sent[:12]} == {(1, 20.0, 0.5, 0.0, 0.0)}
    assert {(m.q, m.dq, m.kp, m.kd, m.tau) for m in sent[12:]} == {(2.146e9, 16000.0, 0.0, 0.0, 0.0)}
    assert (message.head, message.level_flag, message.crc) == ([0xFE, 0xEF], 0xFF, low_cmd_crc(message))


# ---------------------------------------------------------------------------------------------- age of a reading


def test_age_of_a_delayed_and_a_frozen_counter():
    clock, ms = StampClock(), 1_000_000
    assert clock.stamp(1000, 50 * ms) == 50 * ms  # the first is taken as fresh
    assert clock.stamp(1020, 75 * ms) == pytest.approx(70 * ms, abs=0.03 * ms)  # it took 5 ms longer
    assert clock.stamp(1040, 88 * ms) == 88 * ms  # it took less than the first: that is no delay now
    assert clock.stamp(1040, 500 * ms) == 88 * ms  # frozen: as old as it is
    with pytest.raises(ValueError, match="went back from 1040 to 3"):  # restarted, or of another robot
        clock.stamp(3, 600 * ms)


def test_a_counter_may_wrap_round():
    clock, ms = StampClock(), 1_000_000
    assert clock.stamp(2**32 - 1, 700 * ms) == 700 * ms
    assert clock.stamp(4, 705 * ms) == 705 * ms  # 5 ms later


@settings(max_examples=20)
@given(st.floats(-3e-4, 3e-4), st.integers(0, 2**32 - 1), st.integers(0, 1000))
def test_clocks_may_drift_apart(drift, first, seed):
    rng, clock, ms = np.random.default_rng(seed), StampClock(), 1_000_000
    for k in range(600):  # readings that are 0 to 2 ms old, for ten minutes
        now = round(1000 * k * ms * (1 + drift))
        age = rng.uniform(0.0, 2.0)
        stamp = clock.stamp((first + round(1000 * k - age)) % 2**32, now)
        assert -0.01 * ms <= now - stamp <= 4.5 * ms


# ---------------------------------------------------------------------------------------------- over loopback


class StandIn:
    """The process of `go2_stand_in.py`."""

    def __init__(self, domain: int, *options: str) -> None:
        script = Path(__file__).with_name("go2_stand_in.py")
        command = [sys.executable, str(script), str(domain), configuration("lo"), *options]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._answer()

    def __call__(self, order: str) -> dict:
        self.process.stdin.write(order + "\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict:
        return json.loads(self.process.stdout.readline())

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def domain():
    """A DDS domain of its own."""
    return next(DOMAINS)


@pytest.fixture
def stand_in(vendor, domain):
    """Starts stand-ins and ends them."""
    started = []

    def start(*options):
        started.append(StandIn(domain, *options))
        return started[-1]

    yield start
    for one in started:
        one.close()


@pytest.fixture
def robot(domain):
    """Makes robots on loopback and stops them."""
    made = []

    def make(depth=None, **config):
        made.append(UnitreeRobot(UnitreeConfig("lo", domain, wait_s=config.pop("wait_s", 10.0), **config), depth))
        return made[-1]

    yield make
    for one in made:
        one.stop()


def age_ms(robot, state) -> float:
    return (robot.clock.now_ns() - state.stamp_ns) * 1e-6


def until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened in time"
        time.sleep(0.01)


class Camera:
    """Counts what is asked of a depth source."""

    def __init__(self):
        self.calls = []

    def start(self, clock):
        self.calls.append("start")

    def stop(self):
        self.calls.append("stop")

    def latest(self):
        return DepthFrame(1, 2, np.ones((3, 4), np.float32))


@pytest.mark.slow
def test_both_ways_with_a_stand_in_of_the_vendors_definitions(stand_in, robot):
    go2, camera = stand_in(), Camera()
    ours = robot(camera)
    ours.damp()  # before the start nothing is sent
    ours.start()
    assert go2("report")["active"] == ""  # its own service was asked to let go
    first = ours.read()
    np.testing.assert_allclose(first.q, 0.01 * np.arange(1, 13), atol=1e-6)
    np.testing.assert_allclose(first.tau, 0.5 * np.arange(12))
    np.testing.assert_allclose(first.acc, [0.0, 0.5, 9.8], rtol=1e-6)
    assert first.contact.tolist() == [True, False, True, False]
    assert ours.read_depth().seq == 2

    target = np.clip(np.linspace(-0.5, 0.6, 12), LOW, HIGH)
    for _ in range(100):
        ours.write(servo(target))
        time.sleep(0.02)
    report = go2("report")
    assert report["received"] > 50
    assert report["wrong_crc"] == 0  # by the vendor's checksum
    assert report["head"] == [0xFE, 0xEF, 0xFF]
    np.testing.assert_allclose([motor[1] for motor in report["motors"][:12]], target, rtol=1e-6)
    until(lambda: np.abs(ours.read().q - target).max() < 0.05)
    latest = ours.read()
    assert latest.seq > first.seq
    assert latest.stamp_ns > first.stamp_ns

    ours.damp()
    until(lambda: go2("report")["motors"][0][4:] == [0.0, 3.0])
    assert {tuple(motor[2:]) for motor in go2("report")["motors"][:12]} == {(0.0, 0.0, 0.0, 3.0)}

    with pytest.raises(RobotError, match="a command is not finite; the robot was damped"):
        ours.write(servo(np.full(12, np.nan)))
    assert go2("report")["motors"][5][4:] == [0.0, 3.0]
    ours.stop()
    ours.stop()
    assert camera.calls == ["start", "stop", "stop"]
    with pytest.raises(RobotError, match="not started"):
        ours.write(servo(target))
    with pytest.raises(RobotError, match="not started"):
        ours.read()
    ours.damp()


@pytest.mark.slow
def test_a_state_that_freezes_stops_or_is_spoilt_is_seen(stand_in, robot):
    go2, ours = stand_in("--no-switcher"), robot()
    ours.start()
    go2("buttons")
    until(lambda: ours.read().operator_stop)
    go2("nan")
    until(lambda: np.isnan(ours.read().q[3]))
    for order in ("freeze", "mute"):
        go2("report")
        until(lambda: age_ms(ours, ours.read()) < 30.0)
        go2(order)
        began = time.monotonic()
        until(lambda: age_ms(ours, ours.read()) > 40.0)
        assert time.monotonic() - began < 1.0
        go2("normal")


@pytest.mark.slow
def test_work_is_counted_at_the_rate_of_the_states(stand_in, robot):
    """12 W of motor 2, and what motor 5 takes in counts nothing."""
    go2, ours = stand_in("--no-switcher"), robot()
    assert ours.energy() is None
    ours.start()
    until(lambda: ours.energy() is not None)
    go2("work")
    time.sleep(0.2)
    first, begin = ours.energy(), ours.read().stamp_ns
    time.sleep(1.0)
    second, end = ours.energy(), ours.read().stamp_ns
    spent = second.joint_energy_pos_j - first.joint_energy_pos_j
    assert spent[2] == pytest.approx(12.0 * (end - begin) * 1e-9, rel=0.1)
    assert np.flatnonzero(spent).tolist() == [2]
    assert second.states - first.states > 100  # far more than ticks of a policy
    assert second.peak_pos_w == pytest.approx(12.0)
    counter = ours._energy._process
    counter.kill()
    until(lambda: ours.energy() is None)
    ours.stop()
    assert ours.energy() is None


@pytest.mark.slow
def test_a_counter_of_energy_ends_with_its_reader(stand_in, domain):
    stand_in("--no-switcher")
    code = (
        "import os, sys, time\n"
        "from deploy.robots.unitree.energy import EnergyProcess\n"
        "counter = EnergyProcess(int(sys.argv[1]), 'lo')\n"
        "while counter.read() is None: time.sleep(0.01)\n"
        "print(counter._process.pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(domain)], capture_output=True, text=True, timeout=60)
    assert done.returncode == -9
    until(lambda: not Path(f"/proc/{done.stdout.strip()}").exists())


@pytest.mark.slow
def test_another_publisher_is_noticed_and_refused(vendor, domain, stand_in, robot):
    go, _, _ = vendor
    stand_in("--no-switcher")
    running = robot()
    running.start()
    running.read()
    other = DomainParticipant(domain)
    writer = DataWriter(other, Topic(other, "rt/lowcmd", go.LowCmd_))
    until(lambda: len(writer.get_matched_subscriptions()) >= 2)  # stand-in and robot
    running.read()  # silent so far

    late = robot()
    with pytest.raises(RobotError, match=r"other program\(s\) could publish on rt/lowcmd, silent so far"):
        late.start()
    running.write(servo(np.zeros(12)))  # ours is no stranger to itself
    running.read()
    writer.write(go.LowCmd_(*_vendor_low_cmd(go)))

    def read():
        time.sleep(0.02)
        running.read()

    with pytest.raises(RobotError, match="another program publishes on rt/lowcmd"):
        until(read)


@pytest.mark.slow
def test_a_robot_that_is_not_there(robot):
    absent = robot(wait_s=0.5)
    with pytest.raises(RobotError, match=r"Go2 on lo, DDS domain \d+: no rt/lowstate within 0.5 s; is the robot on"):
        absent.start()
    absent.damp()


def test_an_interface_that_is_not_there(domain):
    from deploy.robots.unitree.domain import join

    with pytest.raises(RobotError, match="cannot be opened on network interface 'nowhere0'"):
        join(domain, "nowhere0")


@pytest.mark.slow
def test_a_counter_that_stands_still(stand_in, robot):
    go2 = stand_in("--no-switcher")
    go2("freeze")
    with pytest.raises(RobotError, match="its counter stands at"):
        robot(wait_s=3.0).start()


@pytest.mark.slow
def test_a_robot_that_was_restarted_is_not_read(stand_in, robot):
    go2 = stand_in("--no-switcher")
    driver = robot(wait_s=3.0)
    driver.start()
    driver.read()
    go2("restart")
    time.sleep(0.05)
    with pytest.raises(RobotError, match=r"went back from .*: it was restarted, or two robots"):
        driver.read()


@pytest.mark.slow
@pytest.mark.parametrize(("option", "service"), [("--stubborn", "'ai'"), ("--mumbling", "that does not answer")])
def test_a_service_that_does_not_let_go_or_does_not_say_so(domain, stand_in, option, service):
    from deploy.robots.unitree.domain import join
    from deploy.robots.unitree.motion_switcher import MotionSwitcher

    stand_in(option)
    switcher = MotionSwitcher(join(domain, "lo"))
    with pytest.raises(RobotError, match=f"the service {service} may still drive the motors 4 s after"):
        switcher.release(timeout_s=4.0, discovery_s=10.0)
