"""Torn, altered and killed logs: what comes back is bitwise what was written, and the losses are named."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from deploy import LogError, report, run
from deploy.logs.recovery import recover
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

CHUNK_TICKS = 10


@pytest.fixture(scope="module")
def intact(bundle_dir, tmp_path_factory):
    """An intact log and the bytes of its messages, in order."""
    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    run(bundle_dir, (0.3, 0.0, 0.0), duration=0.3, log=path)
    return path, messages(path)


def messages(path):
    with path.open("rb") as stream:
        found = [r for r in StreamReader(stream, validate_crcs=True).records if isinstance(r, Message)]
    return [(r.channel_id, r.log_time, r.sequence, r.data) for r in found]


def ticks(payloads):
    return {time for _, time, _, _ in payloads}


def recovered(data, folder):
    """Recover these bytes; the result and the messages of the copy."""
    source = folder / "damaged.mcap"
    source.write_bytes(data)
    result = recover(source, folder / "copy.mcap")
    assert source.read_bytes() == data
    kept = messages(folder / "copy.mcap")
    assert result.messages == len(kept)
    assert result.ticks == len(ticks(kept))
    return result, kept


def test_intact_log_is_kept_whole(intact, tmp_path):
    path, original = intact
    result, kept = recovered(path.read_bytes(), tmp_path)
    assert kept == original
    assert (result.ticks_lost, result.gaps, result.lost, result.damaged_bytes) == (0, (), (), 0)
    assert report(tmp_path / "copy.mcap") == report(path)
    for name in ("robot.urdf", "manifest.json"):
        assert attachment(tmp_path / "copy.mcap", name) == attachment(path, name)


def attachment(path, name):
    with path.open("rb") as stream:
        return next(a.data for a in make_reader(stream).iter_attachments() if a.name == name)


def test_any_flipped_byte_costs_one_chunk_at_most(intact, tmp_path):
    """Flips all over the file: framing, chunks, metadata, attachments, index, both ends."""
    path, original = intact
    data = path.read_bytes()
    total = len(ticks(original))
    whole = 0
    positions = {*np.linspace(0, len(data) - 1, 25).astype(int), 0, 8, 9, 10, len(data) - 1, len(data) - 9}
    positions |= {data.index(b"zstd") + offset for offset in (-38, -37, -30, -20, -8, -4, 0, 4, 12)}
    for position in sorted(int(p) for p in positions):
        flipped = bytearray(data)
        flipped[position] ^= 0x41
        result, kept = recovered(bytes(flipped), tmp_path)
        present = ticks(kept)
        assert kept == [m for m in original if m[1] in present], position
        missing = total - len(present)
        assert missing <= CHUNK_TICKS, position
        assert result.ticks_lost in (missing, None), position
        assert (missing > 0) <= bool(result.gaps), position
        whole += missing == 0 and result.ticks_lost == 0
        if position % 7 == 0:
            report(tmp_path / "copy.mcap")
    assert 0 < whole < len(positions)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8, 0.97, 0.999])
def test_truncated_log(intact, tmp_path, share):
    path, original = intact
    data = path.read_bytes()
    result, kept = recovered(data[: int(share * len(data))], tmp_path)
    assert kept == original[: len(kept)]
    assert len(ticks(kept)) % CHUNK_TICKS == 0 or len(kept) == len(original)
    summary = report(tmp_path / "copy.mcap")
    if len(kept) < len(original):
        assert result.ticks_lost is None
        assert "not closed" in " ".join(result.sentences())
        assert not summary.completed
        assert "log ends" in summary.reason


def test_losses_are_named(intact, tmp_path):
    path, original = intact
    data = path.read_bytes()
    flipped = bytearray(data)
    flipped[data.index(b'<robot name="box"')] ^= 1  # the attached URDF
    third = [i for i in range(len(data)) if data.startswith(b"\x04\0\0\0zstd", i)][2]
    flipped[third + 100] ^= 1
    result, kept = recovered(bytes(flipped), tmp_path)
    lost = sorted(ticks(original) - ticks(kept))
    assert len(lost) == CHUNK_TICKS
    (gap,) = result.gaps
    assert gap.after_s == pytest.approx((lost[0] - 20_000_000) * 1e-9)
    assert gap.before_s == pytest.approx((lost[-1] + 20_000_000) * 1e-9)
    text = " ".join(result.sentences())
    assert f"Lost: 10 of {len(ticks(original))} ticks" in text
    assert "attachment robot.urdf" in text
    with (tmp_path / "copy.mcap").open("rb") as stream:
        told = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}["recovery"]
    assert json.loads(told["ticks_lost"]) == 10


def test_lost_definitions_come_from_the_package(intact, tmp_path):
    """The first chunk carries the schemas; rosbags decodes the rest all the same."""
    path, original = intact
    flipped = bytearray(path.read_bytes())
    flipped[flipped.index(b"zstd") + 60] ^= 1
    _, kept = recovered(bytes(flipped), tmp_path)
    assert ticks(original) - ticks(kept) == set(sorted(ticks(original))[:CHUNK_TICKS])
    with AnyReader([tmp_path / "copy.mcap"]) as reader:
        decoded = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/joint_states"]
    assert len(decoded) == len(ticks(kept))
    assert decoded[0].name[0] == "FL_hip_joint"


def test_definitions_of_another_version_are_not_guessed(intact, tmp_path):
    path, _ = intact
    flipped = bytearray(path.read_bytes().replace(b"legged-deploy 0.", b"legged-deploy 9.", 1))
    flipped[flipped.index(b"zstd") + 60] ^= 1
    with pytest.raises(LogError, match="version of legged-deploy that wrote it"):
        recovered(bytes(flipped), tmp_path)


def test_what_cannot_be_recovered(intact, tmp_path):
    with pytest.raises(LogError, match="no such log"):
        recover(tmp_path / "nothing.mcap")
    (tmp_path / "noise.mcap").write_bytes(np.random.default_rng(0).bytes(10_000))
    with pytest.raises(LogError, match="nothing to recover"):
        recover(tmp_path / "noise.mcap")
    with pytest.raises(LogError, match="choose another file"):
        recover(intact[0], intact[0])
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError, match="cannot write"):
        recover(intact[0], tmp_path / "file" / "copy.mcap")


KILLED = """
import os, sys, time
import numpy as np
sys.path.insert(0, {tests!r})
from conftest import FakeRobot
from deploy import Controller, OnnxRuntime, load_bundle
from deploy.control.schedule import Slot
from deploy.logs.messages import Sample
from deploy.logs.metadata import RunInfo
from deploy.logs.writer import LogWriter

bundle, robot = load_bundle({bundle!r}), FakeRobot()
info = RunInfo("b", bundle.sha256, "fake", {{}}, 14.0, 50.0, (0.3, 0.0, 0.0), 60.0, 0, "0.1.0")
controller = Controller(bundle, robot, OnnxRuntime(bundle))
with LogWriter({log!r}, bundle, info, realtime=True) as log:
    for index in range(3000):
        now = robot.clock.time = index * 20_000_000
        log.write(Sample(controller.tick(Slot(index, now, now, False, 0), np.array([0.3, 0.0, 0.0]))))
        os.write(1, b"%d\\n" % now)
        time.sleep(0.02)
"""


def test_kill_9_loses_half_a_second_at_most(bundle_dir, tmp_path):
    """A process that logs in real time is killed in the middle; its own count of ticks is the truth."""
    log = tmp_path / "killed.mcap"
    script = KILLED.format(tests=str(Path(__file__).parent), bundle=str(bundle_dir), log=str(log))
    done = []
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        while len(done) < 73:
            line = process.stdout.readline()
            assert line, "the process ended by itself"
            done.append(int(line))
        os.kill(process.pid, signal.SIGKILL)
        done += [int(line) for line in process.stdout.read().split()]
    assert not log.exists()
    with pytest.raises(LogError, match="torn or altered"):
        report(tmp_path / "killed.partial.mcap")
    result = recover(tmp_path / "killed.partial.mcap")
    assert result.out == str(tmp_path / "killed.recovered.mcap")
    kept = sorted(ticks(messages(Path(result.out))))
    assert kept == done[: len(kept)]
    assert done[-1] - kept[-1] < 500_000_000
    assert report(result.out).reason == "log ends while the robot was running"


def test_next_run_keeps_what_a_killed_one_left(bundle_dir, tmp_path):
    left = tmp_path / "a.partial.mcap"
    left.write_bytes(b"witness")
    run(bundle_dir, (0.3, 0.0, 0.0), duration=0.1, log=tmp_path / "a.mcap")
    assert (tmp_path / "a.partial-1.mcap").read_bytes() == b"witness"
    assert not left.exists()
