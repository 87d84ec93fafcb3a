"""Stages: skipped when nothing changed, redone when something did; locks; atomic files."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from legged_codesign.stages import RunError, Stage, locked, run_stages, write_bytes, write_text


class Pipe:
    """Two stages over a folder: `double` reads in.txt, `count` reads what `double` wrote."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.source, self.middle, self.last = folder / "in.txt", folder / "middle.txt", folder / "last.txt"
        self.source.write_text("ab")
        self.settings: dict[str, Any] = {"times": 2}
        self.done: list[str] = []

    def double(self) -> None:
        self.done.append("double")
        write_text(self.middle, self.source.read_text() * self.settings["times"])

    def count(self) -> None:
        self.done.append("count")
        write_text(self.last, str(len(self.middle.read_text())))

    def run(self) -> list[str]:
        """Run what there is to do; returns the stages that worked."""
        self.done.clear()
        stages = (
            Stage("double", self.settings, [self.source], [self.middle], self.double),
            Stage("count", {}, [self.middle], [self.last], self.count),
        )
        self.console = Console(file=io.StringIO(), width=200)
        run_stages(self.folder, stages, self.console)
        return list(self.done)

    @property
    def printed(self) -> str:
        return self.console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]


@pytest.fixture
def pipe(tmp_path: Path) -> Pipe:
    return Pipe(tmp_path)


def test_first_run_does_everything_in_order(pipe: Pipe) -> None:
    assert pipe.run() == ["double", "count"]
    assert pipe.last.read_text() == "4"
    assert "1/2 double" in pipe.printed
    rows = [json.loads(line) for line in (pipe.folder / "metrics.jsonl").read_text().splitlines()]
    assert [row["stage"] for row in rows] == ["double", "count"]


def test_second_run_does_nothing(pipe: Pipe) -> None:
    pipe.run()
    assert pipe.run() == []
    assert pipe.printed.count("unchanged, skipped") == 2


def test_new_input_redoes_what_depends_on_it(pipe: Pipe) -> None:
    pipe.run()
    pipe.source.write_text("abc")
    assert pipe.run() == ["double", "count"]
    assert pipe.last.read_text() == "6"


def test_touched_input_with_the_same_bytes_does_not(pipe: Pipe) -> None:
    pipe.run()
    os.utime(pipe.source, (1, 1))
    assert pipe.run() == []


def test_new_settings_redo(pipe: Pipe) -> None:
    pipe.run()
    pipe.settings = {"times": 3}
    assert pipe.run() == ["double", "count"]
    assert pipe.last.read_text() == "6"


def test_a_redone_stage_with_the_same_output_stops_there(pipe: Pipe) -> None:
    pipe.run()
    pipe.middle.unlink()
    assert pipe.run() == ["double"]


def test_missing_output_redoes(pipe: Pipe) -> None:
    pipe.run()
    pipe.last.unlink()
    assert pipe.run() == ["count"]


def test_altered_intermediate_file_redoes_what_reads_it(pipe: Pipe) -> None:
    pipe.run()
    pipe.middle.write_text("abcdefg")
    assert pipe.run() == ["count"]
    assert pipe.last.read_text() == "7"


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"fingerprint": 3}'])
def test_broken_marker_redoes(pipe: Pipe, damage: str) -> None:
    pipe.run()
    (pipe.folder / "stages" / "count.json").write_text(damage)
    assert pipe.run() == ["count"]


def test_interrupted_stage_is_done_again(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        write_text(pipe.last, "half")
        raise KeyboardInterrupt

    monkeypatch.setattr(pipe, "count", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pipe.run()
    monkeypatch.undo()
    assert pipe.run() == ["count"]
    assert pipe.last.read_text() == "4"


def test_a_stage_that_leaves_no_output_is_an_error(tmp_path: Path) -> None:
    stage = Stage("idle", {}, [], [tmp_path / "nothing.txt"], lambda: None)
    with pytest.raises(RunError, match=r"'idle' did not write .*nothing\.txt"):
        run_stages(tmp_path, [stage], Console(file=io.StringIO()))
    assert not (tmp_path / "stages" / "idle.json").exists()


# ---------------------------------------------------------------- locks


@contextmanager
def held_by_another_process(folder: Path) -> Iterator[subprocess.Popen[str]]:
    code = (
        "import fcntl, sys; file = open(sys.argv[1] + '/.lock', 'w'); fcntl.flock(file, fcntl.LOCK_EX)\n"
        "print('held', flush=True); sys.stdin.read()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", code, str(folder)], **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_lock_refuses_a_folder_in_use_until_its_holder_is_gone(tmp_path: Path) -> None:
    with held_by_another_process(tmp_path) as process:
        with pytest.raises(RunError, match=f"another run is using {tmp_path}"), locked(tmp_path):
            pass
        process.kill()
        process.wait()
        with locked(tmp_path):
            pass


def test_lock_refuses_a_second_holder_in_this_process(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(RunError, match="another run"), locked(tmp_path):
        pass


def test_lock_is_free_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), locked(tmp_path):
        raise ZeroDivisionError
    with locked(tmp_path):
        pass


def test_lock_makes_the_folder(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()


def test_lock_on_a_path_under_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RunError, match="cannot write to the run folder"), locked(tmp_path / "file" / "run"):
        pass


@pytest.mark.skipif(os.geteuid() == 0, reason="permissions do not bind root")
def test_lock_on_a_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(RunError, match="cannot write to the run folder"), locked(tmp_path / "run"):
            pass
    finally:
        tmp_path.chmod(0o700)


# ---------------------------------------------------------------- files


def test_write_replaces(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.bin"
    write_bytes(path, b"old")
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in path.parent.iterdir()] == ["file.bin"]
    assert path.stat().st_mode & 0o777 == 0o644


def test_write_text_is_utf8(tmp_path: Path) -> None:
    write_text(tmp_path / "t.txt", "γ_reg")
    assert (tmp_path / "t.txt").read_bytes() == "γ_reg".encode()


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_failed_write_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    path = tmp_path / "file.bin"
    write_bytes(path, b"old")

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, call, full)
    with pytest.raises(OSError, match="No space"):
        write_bytes(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.bin"], "a temporary file was left behind"


def test_write_is_complete_or_absent_at_every_instant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When the file takes its name, all of its bytes are there already."""
    path, seen = tmp_path / "file.bin", []
    replace = os.replace

    def watch(source: str, target: Path) -> None:
        assert not path.exists()
        seen.append(Path(source).read_bytes())
        assert Path(source).parent == Path(target).parent, "another file system would make it a copy"
        replace(source, target)

    monkeypatch.setattr(os, "replace", watch)
    write_bytes(path, b"x" * 100_000)
    assert seen == [b"x" * 100_000]
