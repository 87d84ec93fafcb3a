"""Policies that see: two networks, fixed latency, and a depth encoder that is early, on time, late or silent."""

import io
import threading
from dataclasses import replace

import numpy as np
import pytest
from deploy import BundleError, Controller, ControllerConfig, OnnxRuntime, RobotError, check_golden, load_bundle, run
from deploy.control.controller import Mode
from deploy.control.schedule import Schedule
from deploy.interfaces import DepthFrame, RobotState
from deploy.policy.perception import Perception
from deploy.policy.tick import Policy

QUICK = ControllerConfig(passive_s=0.04, stand_up_s=0.1, hold_s=0.06, ready_timeout_s=0.1, ramp_in_s=0.08)
START, TICK = 11, 20_000_000
"""Ticks until the policy starts, and their period in ns."""
COMMAND = np.array([0.3, 0.0, 0.0])


@pytest.fixture
def bundle(seeing_dir):
    return load_bundle(seeing_dir)


def test_golden_trace_of_two_networks(bundle):
    """Computed in float64 from the rule of the manifest, with a reset in the middle."""
    result = check_golden(bundle, OnnxRuntime(bundle))
    assert 0 < result.terrain < 1e-6
    assert 0 < result.action < 1e-6


@pytest.mark.parametrize("latency", [4, 6])
def test_golden_trace_knows_the_latency(seeing_folder, latency):
    seeing_folder.manifest["depth"]["latency_ticks"] = latency
    bundle = load_bundle(seeing_folder.seal())
    with pytest.raises(BundleError, match=rf"tick {min(latency, 5)}: action differs"):
        check_golden(bundle, OnnxRuntime(bundle))


@pytest.mark.parametrize("missing", ["depth", "depth_due", "terrain", "heading"])
def test_golden_trace_without_what_was_seen(seeing_folder, pack, missing):
    with np.load(io.BytesIO(seeing_folder.files["golden.npz"])) as archive:
        trace = {name: archive[name] for name in archive if name != missing}
    seeing_folder.files["golden.npz"] = pack(trace)
    bundle = load_bundle(seeing_folder.seal())
    with pytest.raises(BundleError, match="not a golden trace"):
        check_golden(bundle, OnnxRuntime(bundle))


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (
            ("depth", "outputs", "terrain"),
            [1, 5],
            r"policy input terrain is \[1, 4\], the depth encoder gives \[1, 5\]",
        ),
        (("depth", "inputs", "depth"), [1, 6, 9], "the image is"),
        (("depth", "inputs", "obs"), [1, 44], "the terms make"),
        (("depth", "camera", "near"), 2.0, "not below far"),
        (("depth", "file"), "other.onnx", "other.onnx is used but not listed"),
        (("depth", "torchscript"), "eye.ts.pt", "eye.ts.pt is used but not listed"),
    ],
)
def test_contradiction_between_policy_and_eye(seeing_folder, path, value, words):
    parent = seeing_folder.manifest
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    with pytest.raises(BundleError, match=words):
        load_bundle(seeing_folder.seal())


def test_a_policy_that_sees_needs_an_eye(seeing_folder):
    del seeing_folder.manifest["depth"]
    with pytest.raises(BundleError, match="policy input terrain: nothing gives it"):
        load_bundle(seeing_folder.seal())


def image_at(tick):
    return np.random.default_rng((7, tick + 100)).uniform(0.2, 1.9, (6, 8)).astype(np.float32)


def frame_at(tick):
    return DepthFrame(stamp_ns=tick * TICK, seq=tick, image_m=image_at(tick))


class Slow:
    """A runtime whose depth encoder answers at the tick told, or not before it is let go."""

    def __init__(self, bundle):
        self.inner = OnnxRuntime(bundle)
        self.gates = {}
        self.calls = 0

    def reset(self):
        self.inner.reset()

    def step(self, obs, seen=None):
        return self.inner.step(obs, seen)

    def see(self, image, obs):
        gate = self.gates.setdefault(self.calls, threading.Event())
        self.calls += 1
        assert gate.wait(10)
        return self.inner.see(image, obs)

    def open(self, call):
        self.gates.setdefault(call, threading.Event()).set()


def walk(bundle, ticks, network_ticks=0, camera_ticks=0, wait=True, stop_at=None):
    """Actions, ticks of the images in use and perception of an episode.

    Images are there `camera_ticks` after their tick, and the network answers `network_ticks` after that.
    """
    runtime = Slow(bundle)
    policy = Policy(bundle, runtime, wait=wait)
    rng = np.random.default_rng(3)
    actions, used = [], []
    opened = {}
    for tick in range(ticks):
        state = RobotState(
            stamp_ns=tick * TICK,
            seq=tick,
            q=bundle.per_joint("stance") + 0.1 * rng.standard_normal(12),
            dq=rng.standard_normal(12),
            tau=np.zeros(12),
            quat_wxyz=np.array([1.0, 0, 0, 0]),
            gyro=rng.standard_normal(3),
            acc=np.array([0, 0, 9.81]),
        )
        for call, at in opened.items():
            if at == tick:
                runtime.open(call)
                wait_done(policy.perception, call)
        shown = tick - camera_ticks
        lost = shown < 0 or (stop_at is not None and shown > stop_at)

        def camera(shown=shown, lost=lost):
            return None if lost else frame_at(shown)

        before = len(opened)
        if network_ticks == 0:
            runtime.open(before)
        step = policy.step(state, COMMAND, camera, tick * TICK)
        if step.picture is not None:
            opened[before] = tick + network_ticks
            if network_ticks == 0:
                wait_done(policy.perception, before)
        actions.append(step.action)
        used.append(step.seen.tick)
    for call in range(ticks):
        runtime.open(call)
    policy.close()
    return np.array(actions), used, policy.perception


def wait_done(perception, call):
    """Until the answer of the worker has arrived."""
    for _, future in list(perception._under_way):
        if not future.done():
            future.result(10)
            return


EXPECTED = [-1] * 5 + [0] * 5 + [5] * 5 + [10] * 5


def test_what_is_seen_is_used_from_the_latency_on(bundle):
    _, used, perception = walk(bundle, 20)
    assert used == EXPECTED
    assert (perception.overdue, perception.missed) == (0, 0)


@pytest.mark.parametrize("wait", [True, False])
@pytest.mark.parametrize(("network", "camera"), [(1, 0), (4, 0), (0, 1), (0, 4), (2, 2), (5, 0)])
def test_early_or_late_within_the_latency_gives_identical_actions(bundle, network, camera, wait):
    """In virtual time and in real time, where nothing waits for the network."""
    actions, used, _ = walk(bundle, 20)
    others, also_used, perception = walk(bundle, 20, network, camera, wait)
    assert also_used == used
    np.testing.assert_array_equal(others, actions)
    assert (perception.overdue, perception.missed) == (0, 0)


def test_an_image_of_another_moment_is_another_one(bundle):
    """The test above could not fail if the images did not matter."""
    actions, _, _ = walk(bundle, 20)
    others, _, _ = walk(bundle, 20, stop_at=-1)
    np.testing.assert_array_equal(others[:5], actions[:5])
    assert np.abs(others[5:] - actions[5:]).max(axis=1).min() > 1e-3


def test_too_late_is_counted_and_the_old_stays_in_use(bundle):
    _, used, perception = walk(bundle, 20, network_ticks=7, wait=False)
    assert used == [-1] * 7 + [0] * 5 + [5] * 5 + [10] * 3
    assert perception.overdue == 2 * 3
    assert perception.missed == 0


def test_a_camera_later_than_the_latency_is_counted(bundle):
    _, used, perception = walk(bundle, 20, camera_ticks=7)
    assert used == [-1] * 7 + [0] * 5 + [5] * 5 + [10] * 3
    assert perception.overdue == 2 * 3


def test_an_image_from_before_its_tick_is_not_taken(bundle):
    """A camera that repeats an old frame gives none."""
    perception = Perception(OnnxRuntime(bundle), bundle.depth, TICK)
    obs = np.zeros(45, np.float32)
    old = frame_at(3)
    for tick in range(10, 30):
        seen, picture = perception.step(obs, lambda: old, tick * TICK)
        assert picture is None
        assert seen.tick == -1
    assert perception.missed == 1
    fresh = [perception.step(obs, lambda: frame_at(30), tick * TICK)[1] for tick in range(30, 35)]
    assert [picture is not None for picture in fresh] == [True, False, False, False, False]
    assert fresh[0].tick == 20
    perception.close()


def test_images_are_clipped_and_scaled_by_the_rule(bundle):
    perception = Perception(OnnxRuntime(bundle), bundle.depth, TICK)
    depth = np.full((6, 8), 1.0, np.float32)
    depth[0, :4] = [0.0, np.nan, np.inf, 5.0]
    depth[1, 0] = 0.5
    _, picture = perception.step(np.zeros(45, np.float32), lambda: DepthFrame(0, 0, depth), 0)
    np.testing.assert_array_equal(picture.image[0, :4], 0.5)
    assert picture.image[1, 0] == -0.25
    assert picture.image[5, 5] == 0.0
    perception.close()


def test_a_prepared_image_of_another_size_is_refused(bundle):
    perception = Perception(OnnxRuntime(bundle), bundle.depth, TICK)
    frame = DepthFrame(0, 0, np.zeros((5, 8), np.float32), prepared=True)
    with pytest.raises(RobotError, match=r"prepared image has shape \(5, 8\)"):
        perception.step(np.zeros(45, np.float32), lambda: frame, 0)
    perception.close()


@pytest.fixture
def drive(bundle, fake_robot):
    """A controller on a fake robot with a camera of 50 Hz; `drive(ticks)` runs it and returns the ticks."""

    class Drive:
        def __init__(self):
            self.robot = fake_robot()
            self.robot.eye = lambda time_ns: frame_at(time_ns // TICK)
            self.controller = Controller(bundle, self.robot, OnnxRuntime(bundle), QUICK)
            self.schedule = Schedule(self.robot.clock, TICK)

        def __call__(self, ticks):
            return [self.controller.tick(self.schedule.wait(), COMMAND) for _ in range(ticks)]

    made = Drive()
    yield made
    made.controller.close()


def test_a_policy_that_sees_runs_behind_the_guards(drive):
    ticks = drive(START + 19)
    assert ticks[-1].mode is Mode.POLICY
    assert [tick.step.seen.tick for tick in ticks[START - 1 :]] == EXPECTED
    pictures = [tick.step.picture for tick in ticks[START - 1 :]]
    assert [picture.tick for picture in pictures if picture] == [0, 5, 10, 15]
    assert pictures[5].stamp_ns == (START - 1 + 5) * TICK


def silent(robot, since):
    """The camera stops: its last frame stays."""
    robot.eye = lambda time_ns: frame_at(min(time_ns // TICK, since))


def test_depth_that_stops_damps(drive):
    """The last image may be used for period, latency and 0.3 s: 500 ms."""
    drive(START + 9)
    silent(drive.robot, START - 1 + 5)
    ticks = drive(40)
    damped = next(i for i, tick in enumerate(ticks) if tick.mode is Mode.DAMP)
    assert "depth: image in use is 520 ms old, limit 500 ms" in ticks[damped].reason
    assert START + 9 + damped - (START - 1 + 5) == 26
    assert {tick.mode for tick in ticks[damped:]} == {Mode.DAMP}


def test_depth_that_never_comes_damps(drive):
    drive(START - 2)
    drive.robot.eye = lambda time_ns: None
    ticks = drive(20)
    assert ticks[-1].mode is Mode.DAMP
    assert "start envelope: depth: no frame from the camera" in ticks[-1].reason
    assert not any(tick.step for tick in ticks)


def test_a_camera_that_measures_nothing_damps(drive):
    drive(START + 4)
    drive.robot.eye = lambda time_ns: replace(frame_at(time_ns // TICK), image_m=np.zeros((6, 8), np.float32))
    ticks = drive(40)
    assert ticks[-1].mode is Mode.DAMP
    assert "depth: image in use is" in ticks[-1].reason
    assert "every pixel is 0" in ticks[-1].reason


@pytest.mark.parametrize("ticks", [START - 2, START + 9])
def test_a_camera_that_refuses_damps(drive, ticks):
    """Before the policy starts and after."""

    def unplugged(time_ns):
        raise RobotError("no depth camera; check the cable")

    drive(ticks)
    drive.robot.eye = unplugged
    last = drive(6)[-1]
    assert (last.mode, last.reason) == (Mode.DAMP, "robot: no depth camera; check the cable")


def test_frames_of_another_camera_damp(drive):
    drive(START + 9)
    drive.robot.eye = lambda time_ns: replace(frame_at(time_ns // TICK), image_m=np.ones((30, 31), np.float32))
    last = drive(6)[-1]
    assert last.mode is Mode.DAMP
    assert "its frames are 31 x 30 px" in last.reason


@pytest.mark.parametrize("age", [11, -1])
def test_a_stale_frame_does_not_let_the_policy_in(drive, age):
    drive(START - 2)
    drive.robot.eye = lambda time_ns: frame_at(time_ns // TICK - age)
    ticks = drive(20)
    assert ticks[-1].mode is Mode.DAMP
    assert f"the latest frame is {20 * age} ms old" in ticks[-1].reason


def test_a_hole_in_the_stream_is_survived(drive):
    drive(START + 9)
    silent(drive.robot, START - 1 + 5)
    drive(10)
    drive.robot.eye = lambda time_ns: frame_at(time_ns // TICK)
    assert {tick.mode for tick in drive(30)} == {Mode.POLICY}


def test_it_walks_in_mujoco_and_sees_the_ground(seeing_dir, tmp_path):
    samples = []
    summary = run(seeing_dir, (0.3, 0.0, 0.0), 1.0, None, on_tick=samples.append)
    assert summary.completed, summary.reason
    pictures = [s.tick.step.picture for s in samples if s.tick.step and s.tick.step.picture]
    assert len(pictures) == 12
    # the camera is about 0.33 m above a plane, its lowest rays meet it: depth = height / tan of their angle
    lowest = pictures[0].image[-1].mean()
    assert -0.5 < lowest < 0.5
    assert (np.diff(pictures[0].image.mean(axis=1)) <= 0).all()
