"""State machine, guards and deadlines on a fake robot and a fake clock."""

import time
from dataclasses import replace

import numpy as np
import pytest
from deploy import Controller, ControllerConfig, DeployError, OnnxRuntime, RobotError, Unattended, load_bundle, run
from deploy.control.clock import WallClock
from deploy.control.controller import Mode
from deploy.control.guards import GuardLimits
from deploy.control.schedule import Schedule
from deploy.interfaces import PolicyOutput
from hypothesis import given, settings
from hypothesis import strategies as st

PERIOD = 20_000_000
COMMAND = np.array([0.3, 0.0, 0.0])
QUICK = ControllerConfig(
    passive_s=0.04, stand_up_s=0.1, hold_s=0.06, ready_timeout_s=0.1, ramp_in_s=0.08, stand_stiffness=1.0
)
TICKS_TO = {Mode.PASSIVE: 1, Mode.STAND_UP: 3, Mode.READY: 8, Mode.RAMP_IN: 11, Mode.POLICY: 15}
"""Ticks until the mode is first reached: 2 passive, 5 up, 3 hold, 4 ramp."""


@pytest.fixture
def bundle(bundle_dir):
    return load_bundle(bundle_dir)


@pytest.fixture
def drive(bundle, fake_robot):
    """A controller on a fake robot; `drive(ticks)` runs it and returns the ticks."""

    class Drive:
        def __init__(self):
            self.robot = fake_robot()
            self.controller = Controller(bundle, self.robot, OnnxRuntime(bundle), QUICK)
            self.schedule = Schedule(self.robot.clock, PERIOD)

        def __call__(self, ticks):
            return [self.controller.tick(self.schedule.wait(), COMMAND) for _ in range(ticks)]

    return Drive()


def test_modes_follow_each_other(drive):
    assert drive.controller.mode is Mode.IDLE
    modes = [tick.mode for tick in drive(18)]
    up = [Mode.PASSIVE] * 2 + [Mode.STAND_UP] * 5 + [Mode.READY] * 3
    assert modes == up + [Mode.RAMP_IN] * 4 + [Mode.POLICY] * 4
    assert (drive.robot.damped, len(drive.robot.sent)) == (2, 16)


def test_stands_up_from_the_measured_joints(drive, bundle):
    drive.robot.q = drive.robot.q + 0.3
    drive(2)
    ticks = drive(8)
    measured, offset = bundle.per_joint("stance") + 0.3, bundle.per_joint("target_offset")
    sent = np.array([tick.joint_command.q for tick in ticks])
    np.testing.assert_allclose(sent[0], measured + 0.2 * (offset - measured))
    np.testing.assert_allclose(sent[4:], np.tile(offset, (4, 1)), atol=1e-12)


def test_stands_up_from_the_torque_that_holds_it(drive, bundle):
    """The first target keeps a loaded robot where it is: kp (target - q) starts at the measured torque."""
    torque = np.linspace(-8, 8, 12)
    drive.robot.fault = lambda state: replace(state, tau=torque)
    drive(2)
    [tick] = drive(1)
    start, offset = bundle.per_joint("stance") + torque / 80.0, bundle.per_joint("target_offset")
    np.testing.assert_allclose(tick.joint_command.q, start + 0.2 * (offset - start))


def test_policy_comes_in_by_and_by(drive, bundle):
    ticks = drive(16)
    offset = bundle.per_joint("target_offset")
    for tick, share in zip(ticks[10:], [0.2, 0.4, 0.6, 0.8, 1.0, 1.0], strict=True):
        np.testing.assert_allclose(tick.joint_command.q - offset, share * (tick.step.target - offset))
    np.testing.assert_array_equal(ticks[10].step.obs[-12:], 0.0)  # starts from a reset


def test_stands_stiffer_than_the_policy_walks(bundle, fake_robot):
    """Twice the stiffness, half the distance between stance and target: the same torque against gravity."""
    robot = fake_robot()
    controller = Controller(bundle, robot, OnnxRuntime(bundle), replace(QUICK, stand_stiffness=4.0))
    schedule = Schedule(robot.clock, PERIOD)
    ticks = [controller.tick(schedule.wait(), COMMAND) for _ in range(16)]
    stance, offset = bundle.per_joint("stance"), bundle.per_joint("target_offset")
    ready, ramp, walks = (ticks[index] for index in (9, 11, 15))
    np.testing.assert_allclose(ready.joint_command.kp, 4 * 80.0)
    np.testing.assert_allclose(ready.joint_command.kd, 2 * 2.0)
    np.testing.assert_allclose(320.0 * (ready.joint_command.q - stance), 80.0 * (offset - stance))
    np.testing.assert_allclose(ramp.joint_command.kp, 320.0 - 0.4 * 240.0)
    np.testing.assert_allclose(walks.joint_command.kp, 80.0)
    np.testing.assert_allclose(walks.joint_command.q, walks.step.target)


def changed(**fields):
    return lambda state: replace(state, **fields)


def spoiled(name, index, value):
    def fault(state):
        values = getattr(state, name).copy()
        values[index] = value
        return replace(state, **{name: values})

    return fault


def tilted(angle):
    return changed(quat_wxyz=np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0]))


FAULTS = {
    "q is not finite": spoiled("q", 3, np.nan),
    "dq is not finite": spoiled("dq", 3, np.inf),
    "tau is not finite": spoiled("tau", 0, np.nan),
    "quat_wxyz is not finite": spoiled("quat_wxyz", 0, np.nan),
    "gyro is not finite": spoiled("gyro", 1, -np.inf),
    "acc is not finite": spoiled("acc", 2, np.nan),
    "length 0.0000": changed(quat_wxyz=np.zeros(4)),
    "length 1.0100": changed(quat_wxyz=np.array([1.01, 0, 0, 0])),
    "tilt: 1.010 rad": tilted(1.01),
    "tilt: 3.142 rad": tilted(np.pi),
    "FL_calf_joint at -2.850": spoiled("q", 2, -2.85),
    "RR_hip_joint at 1.050": spoiled("q", 9, 1.05),
    "41.0 ms old": lambda state: replace(state, stamp_ns=state.stamp_ns - 41_000_000),
    "-1.0 ms old": lambda state: replace(state, stamp_ns=state.stamp_ns + 1_000_000),
}


@pytest.mark.parametrize("mode", [Mode.IDLE, *TICKS_TO])
@pytest.mark.parametrize("words", FAULTS)
def test_fault_damps_and_latches(drive, mode, words):
    drive(TICKS_TO.get(mode, 0))
    sent, damped = len(drive.robot.sent), drive.robot.damped
    drive.robot.fault = FAULTS[words]
    [tick] = drive(1)
    assert tick.mode is Mode.DAMP
    assert words in tick.reason
    assert tick.joint_command is None
    assert drive.robot.damped > damped
    drive.robot.fault = lambda state: state
    again = drive(5)
    assert {(t.mode, t.reason) for t in again} == {(Mode.DAMP, tick.reason)}
    assert len(drive.robot.sent) == sent
    assert drive.robot.damped >= damped + 6


@pytest.mark.parametrize(
    "fault", [tilted(0.99), spoiled("q", 2, -2.79), changed(quat_wxyz=np.array([1.0005, 0, 0, 0]))]
)
def test_what_is_within_limits_passes(drive, fault):
    drive(14)
    drive.robot.fault = fault
    assert {tick.mode for tick in drive(5)} == {Mode.POLICY}


def test_frozen_state_is_stale(drive):
    """A driver that repeats its last reading trips within three ticks."""
    drive(14)
    frozen = drive.robot.read()
    drive.robot.fault = lambda _: frozen
    modes = [tick.mode for tick in drive(4)]
    assert modes == [Mode.POLICY, Mode.POLICY, Mode.DAMP, Mode.DAMP]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_action_that_is_no_number(bundle, fake_robot, value):
    class Broken:
        def reset(self):
            pass

        def step(self, obs, seen=None):
            return PolicyOutput(action=np.where(np.arange(12) == 4, value, 0.0), velocity=None)

    robot = fake_robot()
    controller = Controller(bundle, robot, Broken(), QUICK)
    schedule = Schedule(robot.clock, PERIOD)
    ticks = [controller.tick(schedule.wait(), COMMAND) for _ in range(11)]
    assert ticks[-2].mode is Mode.READY
    assert ticks[-1].mode is Mode.DAMP
    assert "action: not finite" in ticks[-1].reason
    assert all(np.isfinite(command.q).all() for command in robot.sent)


def test_command_that_is_no_number(drive):
    drive(14)
    tick = drive.controller.tick(drive.schedule.wait(), np.array([np.nan, 0, 0]))
    assert tick.mode is Mode.DAMP
    assert "command" in tick.reason


@pytest.mark.parametrize("ticks", [0, *TICKS_TO.values()])
def test_stop_from_outside_in_every_mode(drive, ticks):
    drive(ticks)
    damped, sent = drive.robot.damped, len(drive.robot.sent)
    drive.controller.stop("operator stop")
    assert (drive.robot.damped, len(drive.robot.sent)) == (damped + 1, sent)
    assert drive(1)[0].reason == "operator stop"
    drive.controller.stop("something later")
    assert drive.controller.reason == "operator stop"


def test_targets_stay_within_joint_limits(bundle, fake_robot):
    class Wild:
        def reset(self):
            pass

        def step(self, obs, seen=None):
            return PolicyOutput(action=np.full(12, 100.0), velocity=None)

    robot = fake_robot()
    controller = Controller(bundle, robot, Wild(), QUICK)
    schedule = Schedule(robot.clock, PERIOD)
    ticks = [controller.tick(schedule.wait(), COMMAND) for _ in range(15)]
    np.testing.assert_array_equal(robot.sent[-1].q, bundle.per_joint("upper"))
    assert ticks[-1].clamped == 12
    assert ticks[0].clamped == 0


@settings(deadline=None, max_examples=10)
@given(st.permutations(range(12)))
def test_joints_are_bound_by_name(intact_bundle, fake_robot, order):
    """A robot with permuted joints receives the same value for each name, gains included."""
    names = tuple(intact_bundle.joint_names[i] for i in order)
    robots = [fake_robot(), fake_robot(names)]
    runtime = OnnxRuntime(intact_bundle)
    for robot in robots:
        rng = np.random.default_rng(0)
        offsets = dict(zip(intact_bundle.joint_names, rng.normal(size=12) * 0.1, strict=True))
        robot.q = robot.q + np.array([offsets[name] for name in robot.spec.joint_names])
        controller = Controller(intact_bundle, robot, runtime, QUICK)
        schedule = Schedule(robot.clock, PERIOD)
        for _ in range(17):
            controller.tick(schedule.wait(), COMMAND)
    for straight, permuted in zip(*(robot.sent for robot in robots), strict=True):
        for field in ("q", "dq", "kp", "kd", "tau"):
            np.testing.assert_array_equal(getattr(straight, field)[list(order)], getattr(permuted, field))


@pytest.fixture(scope="module")
def intact_bundle(bundle_dir):
    """A bundle whose gains differ from joint to joint."""
    bundle = load_bundle(bundle_dir)
    joints = tuple(replace(j, kp=50.0 + i, kd=1.0 + 0.1 * i) for i, j in enumerate(bundle.joints))
    return replace(bundle, joints=joints)


@pytest.mark.parametrize("change", ["renamed", "missing", "twice"])
def test_robot_with_other_joints_is_refused(bundle, fake_robot, change):
    names = list(bundle.joint_names)
    robot = fake_robot()
    changes = {"renamed": [*names[:-1], "tail"], "missing": names[:-1], "twice": [*names, names[0]]}
    robot.spec = replace(robot.spec, joint_names=tuple(changes[change]))
    with pytest.raises(RobotError, match="joints are not those of the bundle"):
        Controller(bundle, robot, OnnxRuntime(bundle))


def test_schedule_is_absolute(fake_clock):
    """Work of any length inside the period does not shift the next tick."""
    schedule = Schedule(fake_clock, PERIOD)
    for index in range(100):
        slot = schedule.wait()
        assert (slot.index, slot.due_ns, slot.start_ns) == (index, index * PERIOD, index * PERIOD)
        assert not slot.late
        fake_clock.time += (index * 7_919_000) % PERIOD


def test_late_ticks_are_counted_not_caught_up(fake_clock):
    schedule = Schedule(fake_clock, PERIOD)
    schedule.wait()
    fake_clock.time = 25_000_000  # 5 ms into slot 1
    late = schedule.wait()
    assert (late.index, late.start_ns, late.late, late.skipped) == (1, 25_000_000, True, 0)
    on_time = schedule.wait()
    assert (on_time.index, on_time.start_ns, on_time.late) == (2, 40_000_000, False)
    fake_clock.time = 107_000_000  # slots 3 and 4 are over
    slot = schedule.wait()
    assert (slot.index, slot.late, slot.skipped) == (5, True, 2)
    assert schedule.wait().start_ns == 120_000_000


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(0, 5 * PERIOD), max_size=30))
def test_every_slot_is_run_or_skipped_once(make_clock, work):
    clock = make_clock()
    schedule = Schedule(clock, PERIOD)
    slots = []
    for duration in work:
        slots.append(schedule.wait())
        clock.time += duration
    accounted = sum(1 + slot.skipped for slot in slots)
    assert accounted == (slots[-1].index + 1 if slots else 0)
    assert all(slot.due_ns <= slot.start_ns < slot.due_ns + PERIOD for slot in slots)


def test_run_on_a_robot_that_is_not_simulated(bundle_dir, fake_robot, tmp_path):
    """No truth, no physics energy: None, not zero; the robot ends damped and released."""
    robot = fake_robot()
    summary = run(bundle_dir, (0.3, 0.0, 0.0), 0.5, tmp_path / "fake.mcap", robot, config=QUICK)
    assert summary.completed
    assert summary.ticks == 25
    assert summary.distance_m is None
    assert summary.energy_j_physics is None
    assert summary.cost_of_transport is None
    assert summary.energy_j_50hz == 0.0
    assert (robot.damped >= 1, robot.stopped) == (True, 1)


def test_metal_wants_an_operator_the_right_legs_and_a_long_goodbye(bundle_dir, fake_robot):
    robot = fake_robot()
    robot.clock.virtual = False
    with pytest.raises(DeployError, match="no simulation: name its operator"):
        run(bundle_dir, (0.3, 0.0, 0.0), 0.1, robot=robot, config=QUICK)
    somebody = Unattended()
    with pytest.raises(RobotError, match=r"trained with calf 1.1, this fake has 1;"):
        run(bundle_dir, (0.3, 0.0, 0.0), 0.1, None, robot, 0, QUICK, somebody)
    assert (robot.reads, robot.damped) == (0, 0)
    built = {"calf": 1.1}
    assert run(bundle_dir, (0.3, 0.0, 0.0), 0.1, None, robot, 0, QUICK, somebody, design=built).completed
    passive_and_last = 2 + 1
    assert (robot.damped, robot.stopped) == (passive_and_last + 1 + 26, 1)


class RealTime(WallClock):
    @property
    def time(self):
        return self.now_ns()


def test_a_loop_that_hangs_is_damped_meanwhile(bundle_dir, fake_robot):
    """By a thread of its own, before the loop comes back and finds out."""
    robot = fake_robot()
    robot.clock = RealTime()
    patient = replace(QUICK, guards=GuardLimits(max_skipped=25, max_skipped_per_s=1000))  # of a busy machine
    damped = []

    def hang(sample):
        if sample.tick.mode is Mode.POLICY and not damped:
            damped.append(robot.damped)
            time.sleep(1.5)
            damped.append(robot.damped)

    built = {"calf": 1.1}
    summary = run(bundle_dir, (0.3, 0.0, 0.0), 9.0, None, robot, 0, patient, Unattended(), design=built, on_tick=hang)
    before, meanwhile = damped
    assert meanwhile > before + 2
    assert "slots given up in a row" in summary.reason


def test_driver_that_raises_leaves_a_damped_robot_and_a_log(bundle_dir, fake_robot, tmp_path):
    robot = fake_robot()

    def unplug(state):
        if state.stamp_ns > 500_000_000:
            raise ConnectionError("cable")
        return state

    robot.fault = unplug
    with pytest.raises(ConnectionError):
        run(bundle_dir, (0.3, 0.0, 0.0), 5.0, tmp_path / "torn.mcap", robot, config=QUICK)
    assert (robot.damped > 2, robot.stopped) == (True, 1)
    assert (tmp_path / "torn.mcap").stat().st_size > 10_000


def test_interrupt_damps(bundle_dir, fake_robot):
    robot = fake_robot()
    pressed = []

    def press(state):
        if state.stamp_ns > 500_000_000 and not pressed:
            pressed.append(True)
            raise KeyboardInterrupt
        return state

    robot.fault = press
    summary = run(bundle_dir, (0.3, 0.0, 0.0), 5.0, None, robot, config=QUICK)
    assert "operator stop" in summary.reason
    assert not summary.completed
    assert robot.damped >= 1
