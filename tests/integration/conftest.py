"""Fixtures of the integration tests: the `codesign` command, one finished smoke run, a body and a policy."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch
import yaml
from codesign_bo import BoxSpace, EvalResult, Study
from locorl import Policy, TrainConfig, Trainer
from locorl.providers import find_factory
from morphgen import BodyFactory

from legged_codesign import cli

# small networks: threads that wait for each other cost more than they do
os.environ.setdefault("OMP_NUM_THREADS", "1")
torch.set_num_threads(1)

LAST_START = ("log.txt", "progress.json", "prediction.json")
SMOKE = ("run", "--preset", "smoke", "--folder")


@dataclass(frozen=True)
class Finished:
    """A `codesign run --preset smoke` that nothing disturbed: its folder, exit code and output."""

    folder: Path
    code: int
    output: str


def command(folder: Path, *options: str) -> list[str]:
    """The smoke run over `folder` as a command line."""
    return [sys.executable, "-c", "from legged_codesign.cli import main; main()", *SMOKE, str(folder), *options]


@pytest.fixture(scope="session")
def smoke_command() -> Callable[..., list[str]]:
    return command


@pytest.fixture(scope="session")
def run_smoke() -> Callable[..., Finished]:
    """Run the smoke preset over a folder in a process of its own, to its end."""

    def run(folder: Path, *options: str) -> Finished:
        done = subprocess.run(
            command(folder, *options),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=500,
            env={**os.environ, "COLUMNS": "200"},
        )
        return Finished(folder, done.returncode, done.stdout)

    return run


@pytest.fixture(scope="session")
def finished(run_smoke: Callable[..., Finished], tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """One undisturbed smoke run for all tests; they must not change its folder."""
    return run_smoke(tmp_path_factory.mktemp("runs") / "smoke")


@pytest.fixture(scope="session")
def finished_return(run_smoke: Callable[..., Finished], tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The same for `--objective return`: its scores tell bodies apart even where none can walk yet."""
    return run_smoke(tmp_path_factory.mktemp("runs") / "return", "--objective", "return")


@pytest.fixture
def codesign(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """The `codesign` command within this process: arguments -> exit code, output."""

    def call(*arguments: str | Path) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["codesign", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = int(end.code or 0)
        captured = capsys.readouterr()
        return code, captured.out + captured.err

    return call


@pytest.fixture
def snapshot() -> Callable[[Path], dict[str, str]]:
    """Name -> hash of every file in a folder, without SQLite's scratch files, locks and notes on the last start."""

    def take(folder: Path) -> dict[str, str]:
        return {
            str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and not path.name.endswith(("-wal", "-shm", ".lock", *LAST_START))
        }

    return take


@pytest.fixture(scope="session")
def go2() -> BodyFactory:
    """Go2 as an installed package provides it."""
    return find_factory("go2")  # pyright: ignore[reportReturnType]


@pytest.fixture(scope="session")
def design() -> np.ndarray:
    """A feasible body that differs from the nominal one in every parameter."""
    return np.array([0.9, 1.1, 1.05, 1.2])


@pytest.fixture(scope="session")
def untrained(go2: BodyFactory) -> Policy:
    """A policy with random weights."""
    return Trainer(go2, TrainConfig(num_envs=2, iterations=1, seed=3)).policy()


class HandMade:
    """A run folder as a run would leave it when it is killed at a given moment."""

    CONFIG: ClassVar = {
        "preset": "laptop",
        "task": "flat",
        "robot": "go2",
        "objective": "cost-of-transport",
        "search": {"trials": 4, "confirm": 1, "repeats": 2},
        "pretrain": {"iterations": 5},
        "distil": {"depth": False, "adapt": None, "imitation": {"iterations": 8}},
    }
    STAGES = ("pretrain", "screen", "search", "confirm", "distil", "compare", "export", "deploy", "report")

    def __init__(self, folder: Path) -> None:
        """Bind a run to the folder."""
        self.folder, self.stages = folder, folder / "stages"
        self.stages.mkdir(parents=True)
        (folder / ".lock").touch()
        (folder / "config.yaml").write_text(yaml.safe_dump({"config": self.CONFIG, "robot_sha256": None}))

    def finish(self, *names: str, seconds: float = 10.0) -> None:
        """Mark stages as done."""
        for name in names:
            (self.stages / f"{name}.json").write_text('{"fingerprint": "x"}')
            with (self.folder / "metrics.jsonl").open("a") as file:
                file.write(json.dumps({"stage": name, "seconds": seconds}) + "\n")

    def enter(self, stage: str, ago: float = 60.0) -> None:
        """Begin a stage `ago` seconds ago."""
        content = {"stage": stage, "since": time.time() - ago, "command": "codesign run --preset laptop"}
        (self.stages / "progress.json").write_text(json.dumps(content))

    def search(self, *costs: float | None, begun: bool = False) -> None:
        """Finish trials with these costs of transport, None for a body that cannot be evaluated; begin one more."""
        space = BoxSpace.box(
            ["front_thigh", "front_shank", "hind_thigh", "hind_shank"], [0.6] * 4, [1.4] * 4, [1.0] * 4
        )
        with Study(space, self.folder / "study.sqlite", seed=0, n_init=20) as study:
            for cost in costs:
                (request,) = study.ask(1)
                if cost is None:
                    result = EvalResult(float("nan"), n=0, status="infeasible", message="has no stance")
                else:
                    result = EvalResult(-cost, 0.01, 8, {"tracking_error": 0.05}, ((100.0, 0.1), (200.0, 0.2)))
                study.tell(request.trial, result)
            if begun:
                study.ask(1)


@pytest.fixture
def hand_made(tmp_path: Path) -> HandMade:
    """A run that is bound to its folder and has done nothing."""
    return HandMade(tmp_path / "runs" / "mine")
