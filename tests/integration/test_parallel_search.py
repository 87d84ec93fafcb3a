"""Trials beside one another: the same study up to their order, and a dead worker costs one attempt."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import codesign_bo
import psutil
import pytest
from rich.console import Console

from legged_codesign import machines, pipeline
from legged_codesign.machines import Machines
from legged_codesign.presets import preset
from legged_codesign.run_folder import Files
from legged_codesign.search import BodySearch
from legged_codesign.stages import RunError

EXECUTORS = ["local", pytest.param("ray", marks=pytest.mark.slow), pytest.param("slurm", marks=pytest.mark.slow)]


def needs(executor: str) -> None:
    """Skip without the executor's library, or without its cluster."""
    if executor == "ray":
        pytest.importorskip("ray")
    if executor == "slurm" and subprocess.run(["which", "sbatch"], capture_output=True).returncode:
        pytest.skip("no Slurm here")


def trials(folder: Path) -> list[dict[str, Any]]:
    return json.loads((folder / "trials.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("executor", EXECUTORS)
def test_same_study_as_one_after_the_other(executor: str, finished_return, run_smoke: Callable, tmp_path: Path) -> None:
    """Trials before the Gaussian process do not depend on what comes back first."""
    needs(executor)
    options = ("--objective", "return", "--executor", executor, "--workers", "2", "--cpus", "1")
    both = run_smoke(tmp_path / "run", *options)
    assert both.code == 0, both.output
    mine, alone = trials(both.folder), trials(finished_return.folder)
    assert [t["trial"] for t in mine] == [t["trial"] for t in alone]
    for ours, theirs in zip(mine[:3], alone[:3], strict=True):
        assert (ours["params"], ours["seed"]) == (theirs["params"], theirs["seed"])
        assert ours["result"]["mean"] == pytest.approx(theirs["result"]["mean"], rel=1e-6)


@pytest.fixture
def start(smoke_command: Callable, tmp_path: Path) -> Iterator[Callable[..., psutil.Popen]]:
    """Starts runs; none outlives its test."""
    begun: list[psutil.Popen] = []

    def begin(*options: str) -> psutil.Popen:
        with (tmp_path / "output.txt").open("w") as output:
            process = psutil.Popen(
                smoke_command(tmp_path / "run", *options), stdout=output, stderr=subprocess.STDOUT, env=os.environ
            )
        begun.append(process)
        return process

    yield begin
    for process in begun:
        if process.is_running():
            for child in process.children(recursive=True):
                child.kill()
            process.kill()


@pytest.mark.slow
def test_a_worker_killed_in_mid_trial_costs_one_attempt(start: Callable, tmp_path: Path) -> None:
    needs("ray")
    run = start("--objective", "return", "--executor", "ray", "--workers", "2", "--cpus", "1")
    worker_of(run, tmp_path / "run" / "trials" / "0000").send_signal(signal.SIGKILL)
    assert run.wait(timeout=500) == 0, (tmp_path / "output.txt").read_text()
    with codesign_bo.open_study(tmp_path / "run" / "study.sqlite") as study:
        attempts = [attempt for attempt in study.attempts() if attempt.repeat is None]
        assert [(attempt.trial, attempt.attempt) for attempt in attempts if attempt.attempt > 1] == [(0, 2)]
        assert len(attempts) == len(study.trials()) + 1
        assert all(trial.ok for trial in study.trials())


def test_failed_bodies_are_tried_again_and_the_others_kept(hand_made, go2) -> None:
    """With the stages that had ended with them."""
    hand_made.search(0.3, None, 0.2)
    hand_made.finish("search", "confirm")
    config = preset("laptop")
    config = replace(config, search=replace(config.search, initial=20))
    screen = Console(file=io.StringIO())
    BodySearch(config, Files(hand_made.folder), go2, Machines(), screen).retry_failed()
    with codesign_bo.open_study(hand_made.folder / "study.sqlite") as study:
        assert [t.result is not None for t in study.trials()] == [True, False, True]
    assert not list(hand_made.stages.glob("*.json"))
    assert "1 failed" in screen.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]


def test_machines_that_are_too_small_are_refused_before_the_pre_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def small(*_: object, **__: object) -> None:
        raise codesign_bo.ExecutorError("an evaluation needs 64 CPU, and no node has that")

    monkeypatch.setattr(machines, "RayExecutor", small)
    with pytest.raises(RunError, match="needs 64 CPU"):
        pipeline.run(preset("smoke"), tmp_path, Console(file=io.StringIO()), Machines("ray", cpus=64))
    assert not (tmp_path / "pretrain").exists()


def worker_of(run: psutil.Popen, folder: Path) -> psutil.Process:
    """Ray's worker that has begun the trial in `folder`: the parent of the process that evaluates it."""
    for _ in range(1200):
        for child in run.children(recursive=True) if (folder / "stdout.txt").exists() else ():
            with contextlib.suppress(psutil.Error):
                if folder / "stdout.txt" in {Path(file.path) for file in child.open_files()} and "spawn_main" in str(
                    child.cmdline()
                ):
                    return child.parents()[0]
        time.sleep(0.1)
    raise AssertionError(f"no worker began on {folder}")
