"""Where trials run, and what a trial takes along."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest
from codesign_bo import EvalRequest
from codesign_bo.executors import LocalExecutor, SlurmExecutor

from legged_codesign import machines
from legged_codesign.machines import Machines
from legged_codesign.presets import preset
from legged_codesign.stages import RunError
from legged_codesign.trial import FineTuneAndScore


def test_one_worker_here_needs_no_executor(tmp_path: Path) -> None:
    with Machines().open(tmp_path) as executor:
        assert executor is None
    assert Machines().threads is None


def test_workers_share_the_cores() -> None:
    cores = len(os.sched_getaffinity(0))
    assert Machines(workers=2).threads == max(1, cores // 2)
    assert Machines(workers=64).threads == 1
    assert Machines(workers=2, cpus=3).threads == 3


def test_local_workers_are_processes(tmp_path: Path) -> None:
    with Machines(workers=2).open(tmp_path) as executor:
        assert isinstance(executor, LocalExecutor)
        assert executor.slots == 2


def test_a_cluster_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise ConnectionError("head node 10.0.0.1 does not answer")

    monkeypatch.setattr(machines, "RayExecutor", gone)
    with pytest.raises(RunError, match=r"ray.*10\.0\.0\.1.*another executor"), Machines("ray").open(tmp_path):
        pass


def test_slurm_gets_the_jobs_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    class Jobs(SlurmExecutor):
        def __init__(self, slots: int, folder: Path, timeout_min: int, **more: object) -> None:
            asked.append((slots, folder, timeout_min, more))

        def close(self) -> None:
            pass

    monkeypatch.setattr(machines, "SlurmExecutor", Jobs)
    with Machines("slurm", workers=8, cpus=4, gpus=1, hours=2.5, partition="gpu").open(tmp_path):
        pass
    wanted = {"cpus_per_task": 4, "slurm_partition": "gpu", "gpus_per_node": 1}
    assert asked == [(8, (tmp_path / "slurm").resolve(), 150, wanted)]


@pytest.mark.parametrize("wrong", [{"workers": 0}, {"cpus": 0}, {"gpus": -1.0}, {"hours": 0.0}])
def test_impossible_machines(wrong: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Machines(**wrong)


def test_a_trial_can_be_sent_elsewhere(untrained, tmp_path: Path) -> None:
    """The same trial in this process and from a pickle gives the same result."""
    callback = FineTuneAndScore(preset("smoke", "return"), untrained, threads=1)
    assert callback.factory.name == "go2"
    sent = pickle.loads(pickle.dumps(callback))
    params = dict.fromkeys(callback.factory.space.names, 1.0)

    def request(name: str) -> EvalRequest:
        folder = tmp_path / name
        folder.mkdir()
        return EvalRequest(trial=0, attempt=1, params=params, seed=5, fidelity=1.0, workdir=folder, deadline=None)

    here, there = callback(request("here")), sent(request("there"))
    assert here.mean == there.mean
    assert dict(here.extras) == dict(there.extras)
    assert (tmp_path / "there" / "policy.pt").is_file()
