"""Logs in the hands of others: rosbag2 folders, and the TypeScript reader."""

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from deploy import LogError, run
from deploy.cli import main
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

PACKAGES = (
    "@mcap/core@^2.2.0",
    "@mcap/support@^1.1.0",
    "@foxglove/rosmsg@^5.0.4",
    "@foxglove/rosmsg2-serialization@^3.0.0",
)


@pytest.fixture(scope="module")
def log(seeing_dir, tmp_path_factory):
    """A log with everything in it: a seeing robot in simulation."""
    path = tmp_path_factory.mktemp("readers") / "walk.mcap"
    run(seeing_dir, (0.3, 0.0, 0.0), duration=0.6, log=path)
    return path


def raw(paths):
    with AnyReader(paths) as reader:
        return [(c.topic, c.msgtype, time, bytes(data)) for c, time, data in reader.messages()]


def test_every_topic_decodes(log):
    """All messages, by rosbags, from the schemas in the file."""
    with AnyReader([log]) as reader:
        counts = Counter()
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
    assert {"/depth/image", "/policy/terrain", "/policy/heading", "/robot_description"} <= counts.keys()
    assert counts["/joint_states"] == counts["/power"] == counts["/timing"]


def test_depth_in_the_log_is_what_entered_the_network(log, seeing_dir):
    """Image stamps lie on ticks a period apart, values in the range of the rule."""
    manifest = json.loads((seeing_dir / "manifest.json").read_text())["depth"]
    with AnyReader([log]) as reader:
        images = []
        timing = {}
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/depth/image":
                images.append((time, message))
            elif connection.topic == "/timing":
                timing[time] = message
    shape = (manifest["image"]["rows"], manifest["image"]["columns"])
    ticks = [timing[time].picture_tick for time, _ in images]
    assert np.diff(ticks).tolist() == [manifest["period_ticks"]] * (len(ticks) - 1)
    for time, message in images:
        assert (message.height, message.width, message.encoding) == (*shape, "32FC1")
        pixels = np.frombuffer(message.data.tobytes(), "<f4")
        assert pixels.min() >= -0.5
        assert pixels.max() <= 0.5
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec <= time
    used = {message.seen_tick for message in timing.values()}
    assert used <= {-1, *ticks}
    assert len(used) > 2


def test_rosbag2_folder(log, tmp_path, capsys):
    bag = tmp_path / "bag"
    main(["export", str(log), "-o", str(bag)])
    assert "messages" in capsys.readouterr().out
    assert sorted(raw([bag])) == sorted(raw([log]))
    with Reader(bag) as reader:
        assert reader.message_count == len(raw([log]))
        latched = next(c for c in reader.connections if c.topic == "/robot_description")
        assert latched.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    told = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    assert told["storage_identifier"] == "mcap"
    assert json.loads(told["custom_data"]["run"])["command"] == [0.3, 0.0, 0.0]
    assert {path.name for path in bag.iterdir()} >= {"metadata.yaml", "robot.urdf", "manifest.json"}


def test_what_cannot_be_exported(log, tmp_path):
    from deploy.logs.export import export_rosbag2

    (tmp_path / "there").mkdir()
    with pytest.raises(LogError, match="exists"):
        export_rosbag2(log, tmp_path / "there")
    with pytest.raises(LogError, match="no such log"):
        export_rosbag2(tmp_path / "nothing.mcap", tmp_path / "bag")
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(log.read_bytes()[:-100])
    with pytest.raises(LogError, match="deploy recover"):
        export_rosbag2(torn, tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


@pytest.mark.slow
def test_typescript_reader(log, tmp_path):
    """@mcap/core reads the file by its index, @foxglove/rosmsg2-serialization decodes every message."""
    if shutil.which("npm") is None:
        pytest.skip("no node here")
    shutil.copy(Path(__file__).parent / "node" / "read_log.mjs", tmp_path)
    install = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--silent", *PACKAGES]
    try:
        subprocess.run(install, cwd=tmp_path, check=True, capture_output=True, timeout=300)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
        pytest.skip("npm cannot install the reader here")
    done = subprocess.run(["node", "read_log.mjs", str(log)], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stdout)
    with AnyReader([log]) as reader:
        counts, positions, last = Counter(), 0.0, {}
        for connection, _, data in reader.messages():
            message = last[connection.topic] = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == "/joint_states":
                positions += message.position.sum()
    assert read["profile"] == "ros2"
    assert read["counts"] == counts
    assert read["positions"] == pytest.approx(positions, rel=1e-12)
    assert read["energy"] == last["/power"].energy_pos_j
    assert read["names"] == last["/joint_states"].name
    assert read["reason"] == "finished"
    assert read["depth"] == [last["/depth/image"].height, last["/depth/image"].width]
    assert set(read["attachments"]) == {"robot.urdf", "manifest.json", "scene.xml"}
    assert {"run", "policy", "provenance", "result", "closed"} <= set(read["metadata"])
