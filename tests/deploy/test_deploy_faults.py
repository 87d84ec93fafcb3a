"""Everything that a robot can do to its controller, in every state of it: Damp, latched, with its reason."""

from dataclasses import replace

import numpy as np
import pytest
from deploy import Controller, ControllerConfig, GuardLimits, OnnxRuntime, RobotError, load_bundle, run
from deploy.control.controller import Mode
from deploy.control.schedule import Schedule, Slot
from deploy.interfaces import PolicyOutput
from deploy.robots.disturbances import Disturbances, Fault, StateDisturber, disturbed_image
from deploy.robots.mujoco_robot import MujocoRobot

PERIOD = 20_000_000
COMMAND = np.array([0.3, 0.0, 0.0])
QUICK = ControllerConfig(
    passive_s=0.04, stand_up_s=0.1, hold_s=0.06, ready_timeout_s=0.1, ramp_in_s=0.08, stand_stiffness=1.0
)
TICKS_TO = {Mode.PASSIVE: 1, Mode.STAND_UP: 3, Mode.READY: 8, Mode.RAMP_IN: 11, Mode.POLICY: 15}
"""Ticks until the mode is first reached: 2 passive, 5 up, 3 hold, 4 ramp."""
LIMP = (Mode.IDLE, Mode.PASSIVE, Mode.DAMP)


@pytest.fixture
def bundle(bundle_dir):
    return load_bundle(bundle_dir)


class Consent:
    """An operator that a test speaks for."""

    def __init__(self, agrees=True):
        self.agrees = agrees
        self.reason = None

    def go(self):
        return self.agrees

    def stop(self):
        return self.reason


@pytest.fixture
def drive(bundle, fake_robot):
    """A controller on a fake robot; `drive(ticks)` runs it and returns the ticks."""

    class Drive:
        def __init__(self, config=QUICK, **options):
            self.robot = fake_robot()
            self.operator = Consent()
            self.controller = Controller(bundle, self.robot, OnnxRuntime(bundle), config, self.operator, **options)
            self.schedule = Schedule(self.robot.clock, PERIOD)

        def __call__(self, ticks):
            return [self.controller.tick(self.schedule.wait(), COMMAND) for _ in range(ticks)]

    return Drive


def zeros(state):
    names = ("q", "dq", "tau", "quat_wxyz", "gyro", "acc")
    return replace(state, **{name: np.zeros_like(getattr(state, name)) for name in names})


def nans(state):
    names = ("q", "dq", "tau", "quat_wxyz", "gyro", "acc")
    return replace(state, **{name: np.full_like(getattr(state, name), np.nan) for name in names})


class Frozen:
    """New stamps on old numbers."""

    def __init__(self):
        self.first = None

    def __call__(self, state):
        self.first = self.first or state
        return replace(self.first, stamp_ns=state.stamp_ns, seq=state.seq)


class FrozenImu(Frozen):
    """... where the joints live."""

    def __call__(self, state):
        first = super().__call__(state)
        return replace(state, quat_wxyz=first.quat_wxyz, gyro=first.gyro, acc=first.acc)


class Stale:
    """A driver that repeats its last reading."""

    def __init__(self):
        self.first = None

    def __call__(self, state):
        self.first = self.first or state
        return self.first


def unplugged(state):
    raise RobotError("no state since 0.1 s; check the cable")


FAULTS = {
    "stale": (Stale, 4, "ms old"),
    "frozen": (Frozen, 5, "frozen, 5 readings"),
    "frozen IMU": (FrozenImu, 5, "frozen, 5 readings of the IMU"),
    "nan": (lambda: nans, 1, "q is not finite"),
    "zero": (lambda: zeros, 1, "all joint angles and velocities are zero"),
    "no IMU": (
        lambda: lambda s: replace(s, gyro=np.zeros(3), acc=np.zeros(3)),
        1,
        "the IMU has no reading",
    ),
    "no driver": (lambda: unplugged, 1, "robot: no state since 0.1 s"),
    "remote stop": (lambda: lambda s: replace(s, operator_stop=True), 1, "operator stop: remote control"),
    "joint": (lambda: lambda s: replace(s, q=np.where(np.arange(12) == 5, 0.0, s.q)), 1, "joint limit: FR_calf_joint"),
    "torque": (
        lambda: lambda s: replace(s, tau=np.where(np.arange(12) == 7, -38.0, 0.0)),
        3,
        "torque limit: RL_thigh_joint at -38.0 N m for 3 ticks, allowed 37.5",
    ),
}


@pytest.mark.parametrize("mode", [Mode.IDLE, *TICKS_TO])
@pytest.mark.parametrize("fault", FAULTS)
def test_fault_in_every_state(drive, fault, mode):
    """Within the ticks that the guard needs, whatever mode that is by then; then nothing but damping."""
    made = drive()
    made(TICKS_TO.get(mode, 0))
    assert made.controller.mode is mode
    make, within, words = FAULTS[fault]
    made.robot.fault = make()
    ticks = made(within)
    assert ticks[-1].mode is Mode.DAMP
    assert words in ticks[-1].reason
    made.robot.fault = lambda state: state
    sent, damped = len(made.robot.sent), made.robot.damped
    assert {(tick.mode, tick.reason) for tick in made(5)} == {(Mode.DAMP, ticks[-1].reason)}
    assert (len(made.robot.sent), made.robot.damped) == (sent, damped + 5)


@pytest.mark.parametrize("mode", [Mode.IDLE, *TICKS_TO])
def test_operator_stops_in_every_state(drive, mode):
    made = drive()
    made(TICKS_TO.get(mode, 0))
    sent = len(made.robot.sent)
    made.operator.reason = "operator stop: key 'q'"
    [tick] = made(1)
    assert (tick.mode, tick.reason) == (Mode.DAMP, "operator stop: key 'q'")
    made.operator.reason = None
    assert made(3)[-1].mode is Mode.DAMP
    assert len(made.robot.sent) == sent


def test_nothing_but_damping_before_the_operator_agrees(drive):
    made = drive()
    made.operator.agrees = False
    assert {tick.mode for tick in made(20)} == {Mode.PASSIVE}
    assert (made.robot.sent, made.robot.damped) == ([], 20)
    made.operator.agrees = True
    assert made(1)[0].mode is Mode.STAND_UP
    made.operator.agrees = False
    assert {tick.mode for tick in made(30)[7:]} == {Mode.READY}
    made.operator.agrees = True
    assert made(1)[0].mode is Mode.RAMP_IN


def test_a_torque_that_spikes_is_survived(drive):
    """An estimate from a motor's current may jump for two ticks."""
    made = drive()
    made(14)
    made.robot.fault = lambda state: replace(state, tau=np.full(12, 45.0 if made.robot.reads % 3 else 0.0))
    assert {tick.mode for tick in made(30)} == {Mode.POLICY}


ENVELOPE = {
    "FL_thigh_joint +0.350 rad from its stance": lambda s: replace(s, q=s.q + np.where(np.arange(12) == 1, 0.35, 0)),
    "FR_hip_joint -2.100 rad/s speed": lambda s: replace(s, dq=np.where(np.arange(12) == 3, -2.1, 0.0)),
    "tilt 0.400 rad": lambda s: replace(s, quat_wxyz=np.array([np.cos(0.2), np.sin(0.2), 0, 0])),
    "the base turns at 1.20 rad/s": lambda s: replace(s, gyro=np.array([0, 1.2, 0])),
}


@pytest.mark.parametrize("words", ENVELOPE)
def test_start_envelope(drive, words):
    """Outside of it the policy never takes over; the robot waits, then gives up."""
    made = drive()
    noise = made.robot.fault

    def fault(state):
        spoiled = ENVELOPE[words](noise(state))
        return replace(spoiled, acc=spoiled.acc + 1e-6 * state.seq)

    made.robot.fault = fault
    ticks = made(17)
    assert [tick.mode for tick in ticks[7:]] == [Mode.READY] * 8 + [Mode.DAMP] * 2
    assert words in ticks[-1].reason
    assert not any(tick.step for tick in ticks)


def test_start_envelope_met_in_time(drive):
    made = drive()
    made(8)
    made.robot.fault = lambda state: replace(ENVELOPE["tilt 0.400 rad"](state), acc=state.acc + state.gyro)
    assert {tick.mode for tick in made(5)} == {Mode.READY}
    made.robot.fault = lambda state: state
    assert made(1)[0].mode is Mode.RAMP_IN


def test_loop_that_was_away_damps(drive):
    """Five slots given up are counted, six are too many."""
    for skipped, mode in ((5, Mode.POLICY), (6, Mode.DAMP)):
        made = drive()
        made(16)
        now = made.robot.clock.time
        tick = made.controller.tick(Slot(99, now, now, late=True, skipped=skipped), COMMAND)
        assert tick.mode is mode
    assert "deadline: 6 slots given up" in tick.reason


def test_loop_that_is_away_again_and_again_damps(drive):
    """Ten slots within a second are counted, more are too many; what is longer ago is forgotten."""
    for every, last, mode in ((2, 11, Mode.DAMP), (10, 199, Mode.POLICY)):
        made = drive()
        made(16)
        modes = []
        for k in range(1, last + 1):
            now = made.robot.clock.time
            tick = made.controller.tick(Slot(100 + every * k, now, now, late=True, skipped=1), COMMAND)
            modes.append(tick.mode)
        assert modes == [Mode.POLICY] * (last - 1) + [mode]
        assert tick.reason == ("deadline: 11 slots given up within a second, limit 10" if mode is Mode.DAMP else "")


def test_every_threshold_can_be_chosen(drive):
    made = drive(replace(QUICK, guards=GuardLimits(max_tilt=0.1)))
    made(14)
    made.robot.fault = lambda state: replace(state, quat_wxyz=np.array([np.cos(0.06), np.sin(0.06), 0, 0]))
    assert "tilt: 0.120 rad, limit 0.100 rad" in made(1)[0].reason


def test_dry_run_computes_and_sends_only_damping(drive):
    """Even where the robot hangs in other angles than those of its stance."""
    made = drive(dry_run=True)
    made.robot.q = made.robot.q + 0.4
    ticks = made(20)
    assert [tick.mode for tick in ticks[-6:]] == [Mode.POLICY] * 6
    assert all(tick.dry_run for tick in ticks)
    assert ticks[-1].joint_command is not None
    assert (made.robot.sent, made.robot.damped) == ([], 20)
    made.robot.fault = nans
    assert made(1)[0].mode is Mode.DAMP


def test_a_stop_during_the_computation_is_not_overruled(bundle, fake_robot):
    """Another thread stops while the network runs: the action does not reach the robot."""

    class Stops:
        def reset(self):
            pass

        def step(self, obs, seen=None):
            controller.stop("operator stop: button")
            return PolicyOutput(action=np.zeros(12), velocity=None)

    robot = fake_robot()
    controller = Controller(bundle, robot, Stops(), QUICK)
    schedule = Schedule(robot.clock, PERIOD)
    ticks = [controller.tick(schedule.wait(), COMMAND) for _ in range(12)]
    assert ticks[10].mode is Mode.DAMP
    assert ticks[10].joint_command is None
    assert len(robot.sent) == 8


def test_a_policy_that_feels_its_feet_needs_a_robot_that_does(folder, fake_robot):
    terms = folder.manifest["observation"]["terms"]
    terms.append(
        {"name": "feet", "source": "foot_contact", "frame": "", "unit": "1", "size": 4, "scale": 1.0},
    )
    folder.manifest["policy"]["inputs"]["obs"] = [1, 49]
    bundle = load_bundle(folder.seal())
    with pytest.raises(RobotError, match="does not feel its feet"):
        Controller(bundle, fake_robot(), None)
    robot = fake_robot()
    robot.spec = replace(robot.spec, feet=("a", "b", "c", "d"))
    with pytest.raises(RobotError, match="its feet"):
        Controller(bundle, robot, None)


# the same in simulation: what is injected is what the guards see


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("frozen", "frozen"),
        ("dropped", "ms old"),
        ("nan", "not finite"),
        ("zero", "are zero"),
    ],
)
def test_simulated_sensors_die(bundle_dir, bundle, kind, words):
    faults = Disturbances(joint_noise=1e-4, faults=(Fault(kind, start_s=0.5),))
    summary = run(bundle_dir, (0.3, 0, 0), 5.0, robot=MujocoRobot(bundle, disturbances=faults), config=QUICK)
    assert not summary.completed
    assert words in summary.reason
    assert summary.ticks < 20


@pytest.mark.parametrize("kind", ["depth_dropped", "depth_nan"])
def test_simulated_camera_dies(seeing_dir, kind):
    bundle = load_bundle(seeing_dir)
    robot = MujocoRobot(bundle, disturbances=Disturbances(faults=(Fault(kind, start_s=0.7),)))
    summary = run(seeing_dir, (0.3, 0, 0), 5.0, robot=robot, config=QUICK)
    assert summary.reason.startswith("depth: image in use is")
    assert ("every pixel is NaN" in summary.reason) == (kind == "depth_nan")


def test_short_faults_are_survived(bundle_dir, bundle):
    faults = Disturbances(
        joint_noise=1e-3, faults=(Fault("dropped", 0.5, 0.019), Fault("frozen", 0.7, 0.05)), state_dropout=0.02
    )
    summary = run(bundle_dir, (0.3, 0, 0), 0.8, robot=MujocoRobot(bundle, disturbances=faults), config=QUICK)
    assert summary.completed, summary.reason


def at(robot, time_s):
    robot.sleep_until(round(time_s * 1e9))
    return robot.read()


def test_delayed_readings_are_old_ones(bundle):
    exact = MujocoRobot(bundle, seed=1)
    late = MujocoRobot(bundle, seed=1, disturbances=Disturbances(state_delay_s=0.015))
    for robot in (exact, late):
        robot.damp()
    before, now = at(exact, 0.085), at(late, 0.1)
    assert now.stamp_ns == before.stamp_ns == 85_000_000
    np.testing.assert_allclose(now.q, before.q, atol=1e-6)
    assert np.abs(at(exact, 0.1).q - before.q).max() > 1e-4


def test_delayed_commands_act_later(bundle):
    robots = [MujocoRobot(bundle, seed=1, disturbances=Disturbances(action_delay_s=delay)) for delay in (0.0, 0.01)]
    for robot, wait in zip(robots, (0.01, 0.0), strict=True):
        robot.sleep_until(round(wait * 1e9))
        robot.damp()
    first, second = (at(robot, 0.1).q for robot in robots)
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_noise_has_its_size_and_repeats(bundle):
    config = Disturbances(joint_noise=0.01, joint_speed_noise=0.1, gyro_noise=0.05, tilt_noise=0.02, seed=3)
    exact = MujocoRobot(bundle).read()
    readings = [StateDisturber(config)(replace(exact, stamp_ns=time)) for time in range(400)]
    for name, size in (("q", 0.01), ("dq", 0.1), ("gyro", 0.05)):
        errors = np.array([getattr(reading, name) - getattr(exact, name) for reading in readings])
        assert errors.std() == pytest.approx(size, rel=0.1)
        assert abs(errors.mean()) < 0.2 * size
    angles = [2 * np.arccos(min(abs(reading.quat_wxyz @ exact.quat_wxyz), 1.0)) for reading in readings]
    assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(0.02 * np.sqrt(3), rel=0.1)
    np.testing.assert_allclose([np.linalg.norm(reading.quat_wxyz) for reading in readings], 1.0, atol=1e-12)
    again = StateDisturber(config)(replace(exact, stamp_ns=7))
    np.testing.assert_array_equal(again.q, readings[7].q)
    other = StateDisturber(replace(config, seed=4))(replace(exact, stamp_ns=7))
    assert (other.q != again.q).all()


def test_dropouts_have_their_share(bundle):
    exact = MujocoRobot(bundle).read()
    disturb = StateDisturber(Disturbances(state_dropout=0.3))
    stamps = [disturb(replace(exact, stamp_ns=time)).stamp_ns for time in range(1, 1001)]
    lost = np.mean([stamp != time for time, stamp in enumerate(stamps, start=1)])
    assert lost == pytest.approx(0.3, abs=0.05)
    image = np.ones((4, 4), np.float32)
    config = Disturbances(depth_dropout=0.2, depth_noise=0.1)
    images = [disturbed_image(config, image, seq, 0) for seq in range(1000)]
    assert np.mean([found is None for found in images]) == pytest.approx(0.2, abs=0.05)
    assert np.std([found for found in images if found is not None]) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("wrong", [{"joint_noise": -0.1}, {"state_delay_s": float("nan")}, {"state_dropout": 1.5}])
def test_disturbances_that_cannot_be(wrong):
    with pytest.raises(ValueError, match=r"Disturbances|share"):
        Disturbances(**wrong)


def test_simulated_feet_feel_the_ground(bundle):
    robot = MujocoRobot(bundle)
    assert robot.spec.feet == bundle.robot.feet
    robot.sleep_until(500_000_000)
    np.testing.assert_array_equal(robot.read().contact, True)


def test_simulated_camera_sees_a_wall(seeing_folder):
    """A wall 1 m ahead of the camera fills what is above its foot; a robot's own legs do not show."""
    from deploy.bundles.manifest import Depth

    seeing_folder.manifest["depth"]["camera"]["pitch"] = [0.0, 0.0]
    wall = '<geom type="box" size=".1 5 3" pos="1.37 0 3"/>'
    scene = seeing_folder.files["scene.xml"].decode().replace("<worldbody>", f"<worldbody>{wall}")
    seeing_folder.files["scene.xml"] = scene.encode()
    bundle = load_bundle(seeing_folder.seal())
    assert isinstance(bundle.depth, Depth)
    image = MujocoRobot(bundle, joint_noise=0.0).read_depth().image_m
    rays = (np.arange(6) + 0.5 - bundle.depth.optics.intrinsics.cy) / bundle.depth.optics.intrinsics.fy
    height = bundle.start_height + 0.03
    expected = [1.0 if down <= 0 else min(1.0, height / down) for down in rays]
    np.testing.assert_allclose(image, np.repeat(expected, 8).reshape(6, 8), atol=1e-4)


def test_late_images_are_of_their_own_moment(seeing_dir):
    bundle = load_bundle(seeing_dir)
    exact = MujocoRobot(bundle)
    late = MujocoRobot(bundle, disturbances=Disturbances(depth_delay_s=0.06))
    for robot in (exact, late):
        robot.damp()
    images = {}
    for tick in range(20):
        exact.sleep_until(tick * PERIOD)
        late.sleep_until(tick * PERIOD)
        frame = exact.read_depth()
        images[frame.stamp_ns] = frame.image_m
        delayed = late.read_depth()
        assert (delayed is None) == (tick < 3)
        if delayed is not None:
            assert delayed.stamp_ns == (tick - 3) * PERIOD
            np.testing.assert_array_equal(delayed.image_m, images[delayed.stamp_ns])
    both = np.isfinite(images[0]) & np.isfinite(images[300_000_000])
    assert np.abs(images[0][both] - images[300_000_000][both]).max() > 0.005
