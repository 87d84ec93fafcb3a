"""A log replayed: the same bundle answers the same bits, another one does not, and the first difference is named."""

from concurrent.futures import Future
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from deploy import Controller, ControllerConfig, LogError, OnnxRuntime, RobotError, Unattended, load_bundle, run
from deploy.bundles.recording import record_golden
from deploy.comparison import replay
from deploy.control.controller import Mode
from deploy.interfaces import DepthFrame
from deploy.policy import perception
from deploy.robots.disturbances import Disturbances
from deploy.robots.mujoco_robot import MujocoRobot
from deploy.robots.replay_robot import ReplayRobot

QUICK = ControllerConfig(passive_s=0.04, stand_up_s=0.2, hold_s=0.1, ramp_in_s=0.08)


@pytest.fixture(scope="module")
def log(bundle_dir, tmp_path_factory):
    """A run in MuJoCo with noise and delays."""
    path = tmp_path_factory.mktemp("log") / "walk.mcap"
    bundle = load_bundle(bundle_dir)
    noisy = Disturbances(joint_noise=0.01, gyro_noise=0.05, tilt_noise=0.01, state_delay_s=0.01, state_dropout=0.1)
    summary = run(bundle_dir, (0.3, 0.0, 0.1), 1.0, path, MujocoRobot(bundle, disturbances=noisy), config=QUICK)
    assert summary.completed, summary.reason
    return path


@pytest.fixture(scope="module")
def seeing_log(seeing_dir, tmp_path_factory):
    """A run of a policy that sees, with a camera that is noisy and late."""
    path = tmp_path_factory.mktemp("log") / "look.mcap"
    bundle = load_bundle(seeing_dir)
    noisy = Disturbances(joint_noise=0.01, depth_noise=0.02, depth_delay_s=0.04, depth_dropout=0.2)
    summary = run(seeing_dir, (0.3, 0.0, 0.0), 1.0, path, MujocoRobot(bundle, disturbances=noisy), config=QUICK)
    assert summary.completed, summary.reason
    return path


def test_every_action_is_reproduced(bundle_dir, log):
    bundle = load_bundle(bundle_dir)
    result = replay(log, bundle, OnnxRuntime(bundle))
    assert (result.ticks, result.identical, result.largest, result.first) == (54, 54, 0.0, None)
    assert set(result.terms.values()) == {0.0}


def test_every_action_of_a_policy_that_sees_is_reproduced(seeing_dir, seeing_log):
    bundle = load_bundle(seeing_dir)
    result = replay(seeing_log, bundle, OnnxRuntime(bundle))
    assert (result.ticks, result.identical, result.first) == (54, 54, None)
    ticks = ReplayRobot(seeing_log, bundle).ticks
    assert {tick.seen_tick for tick in ticks if tick.obs is not None} > {-1, 0}
    assert sum(tick.frame is not None for tick in ticks) >= 8


class SlowWorker:
    """Hands over what it computed when the time for it has passed on the clock."""

    def __init__(self, clock, takes_ns):
        self.clock = clock
        self.takes_ns = takes_ns

    def submit(self, compute, *args):
        return SlowFuture(self.clock, self.takes_ns, compute(*args))

    def shutdown(self, wait):
        pass


class SlowFuture(Future):
    def __init__(self, clock, takes_ns, result):
        super().__init__()
        self.set_result(result)
        self.clock = clock
        self.done_ns = clock.now_ns() + takes_ns

    def done(self):
        return self.clock.now_ns() >= self.done_ns


def test_a_run_whose_depth_encoder_was_too_late_is_reproduced(seeing_dir, fake_robot, tmp_path, monkeypatch):
    """In real time nothing waits: the log says which image was in use."""
    bundle = load_bundle(seeing_dir)
    tick_ns = bundle.period_ns
    period, takes = bundle.depth.period_ticks, bundle.depth.latency_ticks + 1
    images = np.random.default_rng(0).uniform(0.2, 1.9, (200, 6, 8)).astype(np.float32)
    robot = fake_robot()
    robot.clock.virtual = False
    worker = SlowWorker(robot.clock, takes * tick_ns)
    monkeypatch.setattr(perception, "ThreadPoolExecutor", lambda **kwargs: worker)
    robot.eye = lambda time_ns: DepthFrame(time_ns // tick_ns * tick_ns, time_ns // tick_ns, images[time_ns // tick_ns])
    path = tmp_path / "late.mcap"
    built = bundle.robot.design
    summary = run(seeing_dir, (0.3, 0.0, 0.0), 1.0, path, robot, 0, QUICK, Unattended(), design=built)
    assert summary.completed, summary.reason
    monkeypatch.undo()
    result = replay(path, bundle, OnnxRuntime(bundle))
    assert (result.ticks, result.first) == (54, None)
    policy = [tick for tick in ReplayRobot(path, bundle).ticks if tick.obs is not None]
    start = policy[0].slot.index
    changes = [now.slot.index - start for last, now in pairwise(policy) if now.seen_tick > last.seen_tick]
    assert changes == list(range(takes, 54, period))


def test_the_first_action_that_differs_is_named(bundle_dir, log):
    """The stance of one joint moved by 0.01 rad shows in the observation of the first tick."""
    bundle = load_bundle(bundle_dir)
    joints = list(bundle.joints)
    joints[4] = replace(joints[4], stance=joints[4].stance + 0.01)
    other = replace(bundle, joints=tuple(joints))
    result = replay(log, other, OnnxRuntime(other))
    robot = ReplayRobot(log, bundle)
    first = next(tick for tick in robot.ticks if tick.obs is not None)
    assert result.identical == 0
    assert result.first.tick == first.slot.index
    assert (result.first.what, result.first.element) == ("observation", "joint_position_error[4]")
    assert result.first.replayed - result.first.logged == pytest.approx(-0.01, abs=1e-6)
    assert result.terms["joint_position_error"] == pytest.approx(0.01, abs=1e-6)
    assert result.terms["joint_velocity"] == 0.0


def test_another_network_is_named_by_the_joint(bundle_dir, log):
    bundle = load_bundle(bundle_dir)

    class Other(OnnxRuntime):
        count = 0

        def step(self, obs, seen=None):
            output = super().step(obs, seen)
            Other.count += 1
            if Other.count == 20:
                output.action[7] = np.nextafter(np.float32(output.action[7]), np.float32(10))
            return output

    result = replay(log, bundle, Other(bundle))
    robot = ReplayRobot(log, bundle)
    nth = [tick for tick in robot.ticks if tick.obs is not None][19]
    assert (result.first.tick, result.first.what) == (nth.slot.index, "action of")
    assert result.first.element == bundle.joint_names[7]
    assert 0 < result.largest < 1e-6
    # the last bit of one action is in the next observation, and from there in the recurrent state
    assert result.identical >= 19


def test_the_whole_controller_on_a_log_sends_what_was_sent(bundle_dir, log):
    """Guards, ramps and gains included, bit by bit."""
    bundle = load_bundle(bundle_dir)
    robot = ReplayRobot(log, bundle)
    controller = Controller(bundle, robot, OnnxRuntime(bundle), QUICK)
    modes = []
    for index in range(len(robot.ticks) - 1):
        tick = robot.go_to(index)
        modes.append(controller.tick(tick.slot, tick.command).mode.value)
        if tick.sent is None:
            assert index not in robot.sent
        else:
            np.testing.assert_array_equal(robot.sent[index].q, tick.sent)
    assert modes == [tick.mode for tick in robot.ticks[:-1]]
    assert modes[-1] == Mode.POLICY.value
    controller.close()


def test_its_clock_walks_through_the_log(bundle_dir, log):
    robot = ReplayRobot(log, load_bundle(bundle_dir))
    robot.sleep_until(robot.ticks[5].slot.start_ns)
    assert robot.tick is robot.ticks[5]
    assert robot.read() is robot.ticks[5].state
    assert robot.now_ns() >= robot.read().stamp_ns
    robot.sleep_until(10**15)
    assert robot.tick is robot.ticks[-1]
    robot.damp()
    robot.stop()


def test_a_log_with_missing_ticks_is_not_replayed_past_them(bundle_dir, log, tmp_path, monkeypatch):
    bundle, read = load_bundle(bundle_dir), ReplayRobot.__init__

    def read_without_some(self, *args):
        read(self, *args)
        del self.ticks[60:63]

    monkeypatch.setattr(ReplayRobot, "__init__", read_without_some)
    slot = ReplayRobot(log, bundle).ticks[60].slot.index
    with pytest.raises(LogError, match=f"3 ticks are missing before slot {slot} "):
        replay(log, bundle, OnnxRuntime(bundle))
    made = load_bundle(record_golden(log, bundle, tmp_path / "measured"))
    before = [tick.obs is not None for tick in ReplayRobot(log, bundle).ticks[:60]].count(True)
    assert made.golden.ticks == before


def test_a_log_of_another_robot_is_refused(folder, log):
    for joint in folder.manifest["joints"]:
        joint["name"] = joint["name"].replace("FL", "LF")
    bundle = load_bundle(folder.seal())
    with pytest.raises(RobotError, match="joints are not those of the bundle"):
        replay(log, bundle, OnnxRuntime(bundle))


def test_a_log_without_a_policy_says_so(bundle_dir, fake_robot, tmp_path):
    robot = fake_robot()
    robot.fault = lambda state: replace(state, q=state.q + 0.8)
    path = tmp_path / "short.mcap"
    run(bundle_dir, (0.3, 0.0, 0.0), 1.0, path, robot, config=QUICK)
    bundle = load_bundle(bundle_dir)
    with pytest.raises(LogError, match="the policy never ran in it"):
        replay(path, bundle, OnnxRuntime(bundle))
