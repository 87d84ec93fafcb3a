"""The predicted cost of a run against what runs take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import distill
import numpy as np
import pytest
from locorl import LeggedEnv, SimulatorConfig, TaskConfig
from locorl.adapters.student import StudentEnv

from legged_codesign.config import DistilConfig
from legged_codesign.machines import Machines
from legged_codesign.predict import memory_gb, predict, speedup, student_data
from legged_codesign.presets import preset

CPU, GPU = SimulatorConfig(), SimulatorConfig("warp", "cuda")


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
def test_the_disk_of_a_finished_run(finished, go2) -> None:
    assert finished.code == 0, finished.output
    assert predict(preset("smoke"), go2).disk_gb == pytest.approx(1e-9 * size(finished.folder), rel=0.5)


def test_checkpoints_count(go2) -> None:
    """A pre-training leaves two, each with the policy and twice its size for the optimiser."""
    smoke = preset("smoke")
    with_one = predict(smoke, go2).disk_gb - predict(replace(smoke, from_scratch=False), go2).disk_gb
    assert with_one == pytest.approx(2 * 1.66e-3 + 0.48e-3, rel=0.2)


def test_what_a_student_learns_from_is_as_large_as_its_checkpoint(go2, untrained, tmp_path: Path) -> None:
    """Weights and optimiser aside, which are those of the same student with a tenth of the data."""
    env = StudentEnv(LeggedEnv(go2, np.ones((8, 4)), TaskConfig()))

    def config(rollouts: int) -> DistilConfig:
        train = distill.TrainConfig(iterations=1, rollout_steps=10, segment=1, updates=1, batch=8)
        return DistilConfig(robots=8, imitation=replace(train, ring_rollouts=rollouts))

    def measured(rollouts: int) -> int:
        folder = tmp_path / str(rollouts)
        distill.train(env, untrained, folder, config(rollouts).imitation, progress=False)
        return (folder / "checkpoint.pt").stat().st_size

    def predicted(rollouts: int) -> float:
        return student_data(config(rollouts), env.group_dims["proprio"], untrained.latent_dim, 50.0)

    assert predicted(50) - predicted(5) == pytest.approx(measured(50) - measured(5), rel=0.02)


@pytest.fixture
def eight(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with eight cores."""
    for place in ("predict", "machines"):
        monkeypatch.setattr(f"legged_codesign.{place}.available_cores", lambda: 8)


@pytest.mark.usefixtures("eight")
def test_workers_on_one_machine_share_its_cores() -> None:
    assert speedup(Machines(), CPU) == 1.0
    assert speedup(Machines(workers=4), CPU) == 1.0
    assert speedup(Machines(workers=4, cpus=8), CPU) == 1.0
    assert speedup(Machines(workers=2, cpus=1), CPU) == 0.25
    assert speedup(Machines("ray", workers=4, cpus=8), CPU) == 4.0
    assert speedup(Machines("slurm", workers=4, cpus=4), CPU) == 2.0
    assert speedup(Machines(workers=4), GPU) == 1.0
    assert speedup(Machines(workers=4, gpus=1), GPU) == 4.0
    assert speedup(Machines("ray", workers=4, gpus=1), GPU) == 4.0


def test_workers_on_one_machine_share_its_memory() -> None:
    alone = memory_gb(Machines(), 1.0, 2e9, 5e8)
    assert alone == pytest.approx(3.3)
    assert memory_gb(Machines(workers=3), 1.0, 2e9, 5e8) == pytest.approx(1.0 + 3 * 3.0 + 0.3)
    assert memory_gb(Machines("slurm", workers=3), 1.0, 2e9, 5e8) == pytest.approx(1.0 + 0.5 + 0.3)
    assert memory_gb(Machines(workers=3), 1.0, 2e9, 5e10) == pytest.approx(1.0 + 50.0 + 0.3)
