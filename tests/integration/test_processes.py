"""A pre-training by several processes ends with its run, however that ends."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from locorl.training.metrics import read_metrics

from legged_codesign.presets import preset
from legged_codesign.run_folder import Files, bind

RUN = """
import sys
from pathlib import Path
from legged_codesign.pretrain import pretrain
from legged_codesign.run_folder import Files, read_config

files = Files(Path(sys.argv[1]))
pretrain(read_config(files.folder), files, processes=2)
"""
ITERATIONS = 60


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run that has not begun, with a short pre-training of few robots."""
    smoke = preset("smoke")
    short = replace(smoke.pretrain, num_envs=8, iterations=ITERATIONS, save_every=3)
    bind(tmp_path / "run", replace(smoke, pretrain=short))
    return tmp_path / "run"


@pytest.mark.slow
def test_a_killed_run_takes_its_processes_along_and_goes_on(folder: Path) -> None:
    command = [sys.executable, "-c", RUN, str(folder)]
    run = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    family: list[psutil.Process] = []
    try:
        until(lambda: (folder / "pretrain" / "checkpoint.pt").exists(), 300)
        family = run.children(recursive=True)
        assert sum("legged_codesign.pretrain" in " ".join(each.cmdline()) for each in family) >= 3  # torchrun and two
        run.kill()
        run.wait()
        until(lambda: not any(map(runs, family)), 60)
        before = len(read_metrics(folder / "pretrain" / "metrics.jsonl"))
        assert before < ITERATIONS, "killed too late to prove anything"
    finally:
        for process in [run, *family]:
            if runs(process):
                process.kill()

    subprocess.run(command, check=True, capture_output=True, timeout=300)
    rows = read_metrics(folder / "pretrain" / "metrics.jsonl")
    assert [row["iteration"] for row in rows] == list(range(1, ITERATIONS + 1))
    assert Files(folder).generalist.is_file()


def runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def until(condition, seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)
