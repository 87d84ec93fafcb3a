"""Kill a run anywhere, start the same command again: the same result as a run that nothing disturbed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

RETURN = ("--objective", "return")
SAME = ("trials.json", "choice.json", "best.urdf", "screening.json")


Start = Callable[[list[str]], "Started"]


class Started:
    """A run in a process group of its own, as a terminal makes one."""

    def __init__(self, arguments: list[str], log: Path) -> None:
        self.log = log
        with log.open("wb") as file:
            self.process = subprocess.Popen(
                arguments,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                # a test session started in the background hands down an ignored Ctrl-C
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            )

    def wait_for(self, path: Path) -> None:
        """Wait until the run has written `path`."""
        while not path.exists():
            assert self.process.poll() is None, f"ended without {path}: {self.log.read_text()}"
            time.sleep(0.02)

    def wait_for_stage(self, folder: Path, stage: str) -> None:
        """Wait until the run is in a stage."""
        progress, text = folder / "stages" / "progress.json", ""
        while f'"{stage}"' not in text:
            assert self.process.poll() is None, f"ended without stage {stage}: {self.log.read_text()}"
            time.sleep(0.01)
            with suppress(FileNotFoundError):
                text = progress.read_text()

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the run and all its children."""
        os.killpg(self.process.pid, number)

    def kill(self) -> None:
        """Kill -9, unless it has ended."""
        if self.process.poll() is None:
            self.send(signal.SIGKILL)
            self.process.wait()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts runs; none outlives its test."""
    runs: list[Started] = []

    def begin(arguments: list[str]) -> Started:
        runs.append(Started(arguments, tmp_path / "output.txt"))
        return runs[-1]

    yield begin
    for run in runs:
        run.kill()


def deployed(folder: Path) -> dict[str, object]:
    """What the student did; the bundle's hash is left out, since its manifest has a date."""
    rollout = json.loads((folder / "rollout.json").read_text())
    del rollout["bundle_sha256"]
    return rollout


def test_the_comparison_can_fail(finished_return) -> None:
    """Were all scores alike, a resumed run would look like the first whatever it did."""
    assert finished_return.code == 0, finished_return.output
    trials = json.loads((finished_return.folder / "trials.json").read_text())
    assert len({t["result"]["mean"] for t in trials}) == len(trials)


@pytest.mark.parametrize(
    ("appears", "not_yet"),
    [
        pytest.param("trials/0001/result.json", "trials.json", id="search"),
        pytest.param("pretrain/checkpoint.pt", "screening.json", id="pretrain", marks=pytest.mark.slow),
        pytest.param("trials/0000/confirm/00/result.json", "choice.json", id="confirm", marks=pytest.mark.slow),
        pytest.param("student/student/checkpoint.pt", "bundle", id="distil", marks=pytest.mark.slow),
        pytest.param("rollout.partial.mcap", "rollout.json", id="deploy", marks=pytest.mark.slow),
        pytest.param("stages/deploy.json", "report.html", id="report", marks=pytest.mark.slow),
    ],
)
def test_kill_and_resume(
    appears: str,
    not_yet: str,
    start: Start,
    finished_return,
    run_smoke: Callable,
    smoke_command: Callable,
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    run = start(smoke_command(folder, *RETURN))
    run.wait_for(folder / appears)
    run.kill()
    assert not (folder / not_yet).exists(), "killed too late to prove anything"

    resumed = run_smoke(folder, *RETURN)
    assert resumed.code == 0, resumed.output
    for name in SAME:
        assert (folder / name).read_text() == (finished_return.folder / name).read_text(), name
    assert deployed(folder) == deployed(finished_return.folder)
    assert (folder / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["screen", "compare", "export"])
def test_kill_within_a_stage_and_resume(
    stage: str, start: Start, finished_return, run_smoke: Callable, smoke_command: Callable, tmp_path: Path
) -> None:
    """Stages that leave nothing behind before they end."""
    folder = tmp_path / "run"
    run = start(smoke_command(folder, *RETURN))
    run.wait_for_stage(folder, stage)
    run.kill()
    assert not (folder / "student" / "stages" / f"{stage}.json").exists()
    assert not (folder / "stages" / f"{stage}.json").exists(), "killed too late to prove anything"
    resumed = run_smoke(folder, *RETURN)
    assert resumed.code == 0, resumed.output
    for name in SAME:
        assert (folder / name).read_text() == (finished_return.folder / name).read_text(), name
    assert deployed(folder) == deployed(finished_return.folder)


@pytest.mark.slow
def test_killed_again_and_again(
    start: Start, finished_return, run_smoke: Callable, smoke_command: Callable, tmp_path: Path
) -> None:
    """Each life of the run is 4 s longer than the one before."""
    folder, seconds, lives = tmp_path / "run", 4.0, 0
    while not (folder / "choice.json").exists():
        run = start(smoke_command(folder, *RETURN))
        with suppress(subprocess.TimeoutExpired):
            run.process.wait(seconds)
        run.kill()
        seconds, lives = seconds + 4.0, lives + 1
    assert lives > 1
    assert run_smoke(folder, *RETURN).code == 0
    for name in SAME:
        assert (folder / name).read_text() == (finished_return.folder / name).read_text(), name


def test_ctrl_c_says_how_to_go_on(start: Start, smoke_command: Callable, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run = start(smoke_command(folder))
    run.wait_for(folder / "pretrain" / "config.json")
    run.send(signal.SIGINT)
    assert run.process.wait(60) == 130
    output = run.log.read_text()
    assert "the same command goes on from here" in output
    assert "Traceback" not in output
    assert (folder / "config.yaml").exists()
    assert not (folder / "stages" / "search.json").exists()
