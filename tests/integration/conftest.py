"""Fixtures of the integration tests: the `codesign` command, one finished smoke run, a body and a policy."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from locorl import Policy, TrainConfig, Trainer
from locorl.providers import find_factory
from morphgen import BodyFactory

from legged_codesign import cli

# small networks: threads that wait for each other cost more than they do
os.environ.setdefault("OMP_NUM_THREADS", "1")
torch.set_num_threads(1)

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
    """Name -> hash of every file in a folder, SQLite's scratch files and locks left out."""

    def take(folder: Path) -> dict[str, str]:
        return {
            str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and not path.name.endswith(("-wal", "-shm", ".lock"))
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
