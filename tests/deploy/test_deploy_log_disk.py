"""Disks that are full, slow or broken while a robot runs."""

import errno
import os
import subprocess
import threading

import numpy as np
import pytest
from deploy import Controller, LogError, OnnxRuntime, load_bundle, report, run
from deploy.control.schedule import Slot
from deploy.logs import writer as writing
from deploy.logs.messages import Sample
from deploy.logs.metadata import RunInfo
from deploy.logs.reading import read_log
from deploy.logs.recovery import recover
from deploy.logs.storage import ReservedFile

COMMAND = (0.3, 0.0, 0.0)


class Disk:
    """A raw file on a disk with room for `room` bytes, and `freed` more once the reserve is gone."""

    def __init__(self, raw, reserve, room, freed, code=errno.ENOSPC):
        self.raw, self.reserve, self.room, self.freed, self.code = raw, reserve, room, freed, code
        self.written = 0

    def write(self, data):
        left = self.room + (0 if self.reserve.exists() else self.freed) - self.written
        if left <= 0:
            raise OSError(self.code, os.strerror(self.code))
        count = self.raw.write(data[:left])  # a full disk takes a part
        self.written += count
        return count

    def __getattr__(self, name):
        return getattr(self.raw, name)


@pytest.fixture
def disk(monkeypatch):
    """Puts logs onto a small disk."""

    def limit(room, freed, code=errno.ENOSPC):
        def opened(path):
            file = ReservedFile(path, reserve_bytes=1000)
            file._file = Disk(file._file, path.with_name(path.name + ".reserve"), room, freed, code)
            return file

        monkeypatch.setattr(writing, "ReservedFile", opened)

    return limit


def test_full_disk_ends_the_run_and_the_log_is_complete(disk, bundle_dir, tmp_path):
    disk(room=90_000, freed=1_000_000)
    log = tmp_path / "full.mcap"
    summary = run(bundle_dir, COMMAND, duration=30.0, log=log)
    assert summary.reason.startswith("log: no space left on the disk")
    assert not summary.completed
    assert not summary.fell
    assert 0 < summary.ticks < 500
    assert report(log) == summary
    assert [path.name for path in tmp_path.iterdir()] == ["full.mcap"]
    assert read_log(log).metadata["closed"]["ticks"] == len(read_log(log).trace.time)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_disk_without_any_room_leaves_a_recoverable_log(disk, bundle_dir, fake_robot, tmp_path, code):
    disk(room=60_000, freed=0, code=code)
    robot = fake_robot()
    with pytest.raises(LogError, match=r"deploy recover .*full\.partial\.mcap"):
        run(bundle_dir, COMMAND, duration=30.0, log=tmp_path / "full.mcap", robot=robot)
    assert robot.damped >= 1
    assert robot.stopped == 1
    assert len(robot.sent) < 500
    result = recover(tmp_path / "full.partial.mcap")
    assert result.damaged_bytes == 0
    assert report(result.out).ticks > 0
    assert not (tmp_path / "full.partial.mcap.reserve").exists()


def test_disk_that_fills_up_for_real(bundle_dir, tmp_path, monkeypatch):
    """A file system of 512 kB, where this user may mount one."""
    mount = tmp_path / "small"
    mount.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", mount], capture_output=True)
    if done.returncode:
        pytest.skip("may not mount a file system")
    try:
        monkeypatch.setattr(writing, "ReservedFile", lambda path: ReservedFile(path, reserve_bytes=256 * 1024))
        summary = run(bundle_dir, COMMAND, duration=30.0, log=mount / "full.mcap")
        assert summary.reason.startswith("log: no space left")
        assert report(mount / "full.mcap") == summary
    finally:
        subprocess.run(["umount", mount], check=True)


def test_no_room_for_the_reserve_is_said_before_anything_moves(bundle_dir, fake_robot, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    robot = fake_robot()
    with pytest.raises(LogError, match="free space or choose another path"):
        run(bundle_dir, COMMAND, duration=1.0, log=tmp_path / "a.mcap", robot=robot)
    assert robot.sent == []
    assert list(tmp_path.iterdir()) == []


def test_slow_disk_delays_nobody(bundle_dir, fake_robot, tmp_path, monkeypatch):
    """While the disk hangs, ticks queue up, then are left out and counted."""
    monkeypatch.setitem(writing.QUEUE_TICKS, True, 20)
    bundle = load_bundle(bundle_dir)
    info = RunInfo("b", bundle.sha256, "fake", {}, 14.0, 50.0, COMMAND, 1.0, 0, "0")
    robot = fake_robot()
    controller = Controller(bundle, robot, OnnxRuntime(bundle))
    released = threading.Event()
    with writing.LogWriter(tmp_path / "slow.mcap", bundle, info, realtime=True) as log:
        write = log._file.write
        log._file.write = lambda data: (released.wait(30), write(data))[1]
        for index in range(100):
            robot.clock.time = index * 20_000_000
            tick = controller.tick(Slot(index, robot.clock.time, robot.clock.time, False, 0), np.array(COMMAND))
            log.write(Sample(tick))
        assert not released.is_set()
        assert 100 - 20 - 2 * writing.FLUSH_TICKS <= log.dropped <= 80
        released.set()
        log.drain()
        assert log.failure is None
    read = read_log(tmp_path / "slow.mcap")
    assert read.metadata["closed"] == {"ticks": 100 - log.dropped, "dropped": log.dropped}
    assert len(read.trace.time) == 100 - log.dropped


def test_a_bug_in_the_writing_thread_stops_the_robot_too(bundle_dir, fake_robot, tmp_path, monkeypatch):
    def broken(self, sample):
        raise ZeroDivisionError("bug")

    monkeypatch.setattr(writing.LogWriter, "_add", broken)
    robot = fake_robot()
    with pytest.raises(LogError, match="bug"):
        run(bundle_dir, COMMAND, duration=10.0, log=tmp_path / "a.mcap", robot=robot)
    assert robot.damped >= 1
    assert len(robot.sent) < 100
