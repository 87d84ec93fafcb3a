"""Logs through real readers; numbers recomputed from what they read."""

import json
import math

import numpy as np
import pytest
from deploy import DeployError, LogError, load_bundle, report, run
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader


@pytest.fixture(scope="module")
def walk(bundle_dir, tmp_path_factory):
    """A log of four seconds and its summary."""
    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    return path, run(bundle_dir, (0.3, 0.0, 0.0), duration=4.0, log=path)


@pytest.fixture(scope="module")
def topics(walk):
    """Every message, decoded by rosbags from the schemas in the file: topic -> [(time, message)]."""
    found = {}
    with AnyReader([walk[0]]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def payloads(path):
    with path.open("rb") as stream:
        return [
            (r.channel_id, r.log_time, r.publish_time, r.sequence, r.data)
            for r in StreamReader(stream, validate_crcs=True).records
            if isinstance(r, Message)
        ]


def test_walks(walk):
    summary = walk[1]
    assert summary.completed
    assert not summary.fell
    assert summary.ticks == 200
    assert summary.distance_m > 0.5


def test_mcap_itself_accepts_the_file(walk):
    """Chunk CRCs hold, statistics agree with a recount, profile and attachments are there."""
    path, _ = walk
    counted = len(payloads(path))
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        header = reader.get_header()
        attachments = {a.name: a.data for a in reader.iter_attachments()}
    assert summary.statistics.message_count == counted
    assert summary.statistics.chunk_count > 5  # flushed on the way
    assert header.profile == "ros2"
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert set(attachments) == {"robot.urdf", "manifest.json", "scene.xml"}


def test_attachments_and_metadata(walk, bundle_dir):
    path, summary = walk
    with path.open("rb") as stream:
        reader = make_reader(stream)
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert attachments["robot.urdf"] == (bundle_dir / "robot.urdf").read_bytes()
    assert attachments["manifest.json"] == (bundle_dir / "manifest.json").read_bytes()
    assert json.loads(metadata["run"]["bundle_sha256"]) == load_bundle(bundle_dir).sha256
    assert json.loads(metadata["run"]["design"]) == {"thigh": 1.0, "calf": 1.1}
    assert json.loads(metadata["run"]["command"]) == [0.3, 0.0, 0.0]
    assert json.loads(metadata["result"]["distance_m"]) == summary.distance_m


def test_messages_hold_what_happened(topics, bundle_dir):
    bundle = load_bundle(bundle_dir)
    ticks = len(topics["/joint_states"])
    assert {len(topics[t]) for t in ("/imu", "/cmd_vel", "/power", "/timing", "/controller")} == {ticks}
    assert topics["/robot_description"][0][1].data == (bundle_dir / "robot.urdf").read_text()
    modes = [m.mode for _, m in topics["/controller"]]
    assert len(topics["/joint_commands"]) == sum(mode not in ("passive", "damp") for mode in modes)
    assert [m for i, m in enumerate(modes) if i == 0 or m != modes[i - 1]] == [
        "passive",
        "stand_up",
        "ready",
        "ramp_in",
        "policy",
        "damp",
    ]
    assert topics["/controller"][-1][1].reason == "finished"
    assert len(topics["/policy/action"]) == sum(mode in ("ramp_in", "policy") for mode in modes)
    for index, (time, message) in enumerate(topics["/timing"]):
        assert (message.tick, message.due_ns, time) == (index, index * 20_000_000, index * 20_000_000)
    for _, message in topics["/cmd_vel"]:
        twist = message.twist
        assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.3, 0.0, 0.0)
    time, state = topics["/joint_states"][-1]
    assert tuple(state.name) == bundle.joint_names
    assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == time


def test_target_follows_from_the_logged_action(topics, bundle_dir):
    """/joint_commands = offset + 0.25 * /policy/action under full control, across two encodings."""
    bundle = load_bundle(bundle_dir)
    full = {t for t, m in topics["/controller"] if m.mode == "policy"}
    actions = {t: m.data for t, m in topics["/policy/action"] if t in full}
    commands = {t: m.position for t, m in topics["/joint_commands"]}
    assert len(actions) == 200
    for time, action in actions.items():
        target = bundle.per_joint("target_offset") + 0.25 * action
        np.testing.assert_allclose(
            commands[time], np.clip(target, bundle.per_joint("lower"), bundle.per_joint("upper")), atol=1e-6
        )


def test_effort_is_the_torque_of_the_previous_command_at_this_instant(topics, bundle_dir):
    """Physics runs the servo between ticks, so the torque at a tick obeys the law with the last target."""
    states, commands = dict(topics["/joint_states"]), dict(topics["/joint_commands"])
    full = [t for t, m in topics["/controller"] if m.mode == "policy"]
    for time in full:
        before, state = commands[time], states[time + 20_000_000]
        law = 80.0 * (before.position - state.position) - 2.0 * state.velocity
        np.testing.assert_allclose(state.effort, np.clip(law, -30, 30), atol=1e-9)


def test_power_agrees_with_joint_states(topics):
    for (_, power), (_, state) in zip(topics["/power"], topics["/joint_states"], strict=True):
        joint = [w * t for w, t in zip(state.velocity, state.effort, strict=True)]
        np.testing.assert_allclose(power.joint_power_w, joint, atol=1e-12)
        assert power.pos_w == pytest.approx(math.fsum(max(p, 0) for p in joint))
        assert power.net_w == pytest.approx(math.fsum(joint), abs=1e-12)
        assert power.peak_w >= 0


def test_eq10_recomputed_from_the_log_alone(walk, topics):
    """The double sum over /joint_states during full control, in plain Python."""
    _, summary = walk
    full = {t for t, m in topics["/controller"] if m.mode == "policy"}
    total = 0.0
    for time, state in topics["/joint_states"]:
        if time in full:
            total += sum(max(w * t, 0.0) for w, t in zip(state.velocity, state.effort, strict=True))
    assert summary.eq10_w_ticks == pytest.approx(-total, rel=1e-12)
    assert summary.energy_j_50hz == pytest.approx(total / 50, rel=1e-12)
    energy = {t: m.energy_pos_j for t, m in topics["/power"]}
    spent = energy[max(full) + 20_000_000] - energy[min(full)]
    assert summary.energy_j_physics == pytest.approx(spent, rel=1e-12)
    distance, mass = summary.distance_m, 14.0
    assert summary.cost_of_transport == pytest.approx(spent / (mass * 9.81 * distance))


def test_distance_and_speed_from_ground_truth(walk, topics):
    """The trot goes straight enough that displacement, way and speed times time agree."""
    _, summary = walk
    full = [t for t, m in topics["/controller"] if m.mode == "policy"]
    odometry = dict(topics["/ground_truth"])
    start, end = (odometry[t].pose.pose.position for t in (full[0], full[-1] + 20_000_000))
    assert summary.displacement_m == pytest.approx(math.hypot(end.x - start.x, end.y - start.y))
    assert summary.distance_m == pytest.approx(summary.displacement_m, rel=0.05)
    assert summary.mean_speed == pytest.approx(summary.distance_m / 4.0)
    late = [odometry[t].twist.twist.linear.x for t in full[100:]]
    assert summary.tracking_error == pytest.approx(np.abs(np.array(late) - 0.3).mean())
    assert summary.commanded_m == pytest.approx(1.2)


def test_report_reads_back_the_same_summary(walk):
    path, summary = walk
    assert report(path) == summary


def test_two_runs_are_identical_to_the_byte(bundle_dir, tmp_path):
    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap", tmp_path / "c.mcap"]
    for path, seed in zip(logs, (3, 3, 4), strict=True):
        run(bundle_dir, (0.3, 0.0, 0.0), duration=0.4, log=path, seed=seed)
    first, second, other = map(payloads, logs)
    assert first == second
    assert first != other


def test_order_of_actuators_does_not_matter(folder, make_scene, bundle_dir):
    """The same robot with its actuators listed backwards walks the same way."""
    names = tuple(joint["name"] for joint in folder.manifest["joints"])
    folder.files["scene.xml"] = make_scene(order=names[::-1]).encode()
    summary = run(folder.seal(), (0.3, 0.0, 0.0), duration=0.4)
    reference = run(bundle_dir, (0.3, 0.0, 0.0), duration=0.4)
    assert summary.displacement_m == pytest.approx(reference.displacement_m, rel=1e-6)
    assert summary.eq10_w_ticks == pytest.approx(reference.eq10_w_ticks, rel=1e-6)


def test_a_fall_is_a_fall(folder):
    """A robot whose servos are too weak to hold it sinks to the ground before the policy has control."""
    scene = folder.files["scene.xml"].decode().replace('forcerange="-30.0 30.0"', 'forcerange="-1 1"')
    folder.files["scene.xml"] = scene.encode()
    for joint in folder.manifest["joints"]:
        joint["torque_limit"] = 1.0
    summary = run(folder.seal(), (0.3, 0.0, 0.0), duration=10.0)
    assert summary.fell
    assert not summary.completed
    assert "over its feet" in summary.reason
    assert summary.ticks == 0
    assert summary.distance_m is None
    assert summary.energy_j_50hz == 0.0


@pytest.mark.parametrize("share", [0.001, 0.1, 0.3, 0.7, 0.9, 0.98, 0.99, 0.995, 0.9999])
def test_truncated_log_says_so(walk, tmp_path, share):
    data = walk[0].read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(LogError, match=r"torn\.mcap: torn or altered log"):
        report(torn)


def test_flipped_byte_in_a_chunk_says_so(walk, tmp_path):
    data = bytearray(walk[0].read_bytes())
    data[len(data) // 2] ^= 0x10
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    with pytest.raises(LogError, match=r"bad\.mcap: torn or altered log"):
        report(bad)


def test_what_is_no_log(tmp_path):
    with pytest.raises(LogError, match="no such log"):
        report(tmp_path / "nothing.mcap")
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(LogError, match=r"empty\.mcap"):
        report(tmp_path / "empty.mcap")


def test_log_of_something_else(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        writer.finish()
    with pytest.raises(LogError, match=r"foreign\.mcap"):
        report(path)


def test_log_that_cannot_be_written(bundle_dir, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot write the log"):
        run(bundle_dir, (0.3, 0.0, 0.0), duration=0.1, log=tmp_path / "file" / "a.mcap")
    with pytest.raises(LogError, match=r"must end in \.mcap"):
        run(bundle_dir, (0.3, 0.0, 0.0), duration=0.1, log=tmp_path / "a.bag")


def test_older_log_stays_until_the_new_one_is_complete(bundle_dir, fake_robot, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"older")
    robot = fake_robot()
    seen = []
    robot.fault = lambda state: (seen.append(path.read_bytes()), state)[1]
    run(bundle_dir, (0.3, 0.0, 0.0), duration=0.1, log=path, robot=robot)
    assert set(seen) == {b"older"}
    assert len(payloads(path)) > 100
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("command", [(1.5, 0, 0), (0, 0, -2.0), (float("nan"), 0, 0)])
def test_command_outside_of_training(bundle_dir, command):
    with pytest.raises(DeployError, match="trained for"):
        run(bundle_dir, command)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("inf"), float("nan")])
def test_senseless_duration(bundle_dir, duration):
    with pytest.raises(DeployError, match="duration"):
        run(bundle_dir, (0.3, 0.0, 0.0), duration=duration)
