"""Two processes with half the robots each do what one does with all of them."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from locorl import PPO, PPOConfig
from locorl.learning.distributed import Processes, mean_and_std
from locorl_target import TargetEnv, make_ppo

ROBOTS = 8
CONFIG = PPOConfig(steps=6, epochs=4, minibatches=1)


def filled(robots: slice, group: Processes | None, seed: int) -> PPO:
    """PPO with the rollout of `robots` among all, from a random stream of its own."""
    torch.manual_seed(0)
    whole, env = make_ppo(CONFIG, ROBOTS), TargetEnv(ROBOTS)
    whole.collect(env, env.observe())
    mine = make_ppo(CONFIG, len(range(ROBOTS)[robots]), seed, group=group)
    for name in ("action", "mean", "log_prob", "value", "advantage", "target"):
        setattr(mine.rollout, name, getattr(whole.rollout, name)[:, robots].contiguous())
    for name, values in whole.rollout.obs.items():
        mine.rollout.obs[name][:] = values[:, robots]
    return mine


def half(folder: Path) -> None:
    """What one of two processes does."""
    group = Processes.from_environment()
    assert group is not None
    assert (group.size, group.first) == (2, group.rank == 0)
    assert group.share(8) == 4
    rank = group.rank
    # weights of another seed, which those of the first process replace
    ppo = filled(slice(4 * rank, 4 * rank + 4), group, seed=rank)
    stats = ppo.update()
    values = torch.arange(10.0)[5 * rank : 5 * rank + 5] + 1000.0
    found = {
        "model": ppo.model.state_dict(),
        "stats": stats,
        "learning_rate": ppo.learning_rate,
        "moments": mean_and_std(values, group),
        "metrics": group.average_metrics({"a": float(rank), "b": 3.0}),
        "any": (group.any(rank == 1), group.any(False)),
    }
    # a NaN in one process stops both
    env = TargetEnv(4, poison="reward" if rank == 1 else "")
    try:
        ppo = make_ppo(CONFIG, 4, seed=rank, group=group)
        ppo.collect(env, env.observe())
    except RuntimeError as error:
        found["error"] = str(error)
    torch.save(found, folder / f"{rank}.pt")
    group.close()


@pytest.mark.slow
def test_two_halves_make_one_update(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "OMP_NUM_THREADS": "1"}
    path = os.pathsep.join((str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")))
    code = f"import pathlib, test_locorl_distributed as t; t.half(pathlib.Path({str(tmp_path)!r}))"
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code], env={**os.environ, **shared, "RANK": str(rank), "PYTHONPATH": path}
        )
        for rank in range(2)
    ]
    assert [process.wait(timeout=120) for process in processes] == [0, 0]
    one, other = (torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in range(2))

    whole = filled(slice(None), None, seed=0)
    start = {name: values.clone() for name, values in whole.model.state_dict().items()}
    stats = whole.update()
    for name, values in whole.model.state_dict().items():
        assert not torch.equal(values, start[name])
        torch.testing.assert_close(one["model"][name], values, rtol=1e-4, atol=1e-6)
        assert torch.equal(one["model"][name], other["model"][name])
    assert one["learning_rate"] == other["learning_rate"] == whole.learning_rate
    assert one["stats"] == pytest.approx(stats, rel=1e-4, abs=1e-6)

    values = torch.arange(10.0) + 1000.0
    torch.testing.assert_close(one["moments"], (values.mean(), values.std()))
    assert one["metrics"] == {"a": 0.5, "b": 3.0}
    assert one["any"] == (True, False)
    assert "another process" in one["error"]
    assert "the reward is not finite" in other["error"]


def test_one_process_needs_no_group(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    assert Processes.from_environment() is None
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.delenv("RANK", raising=False)
    with pytest.raises(ValueError, match=r"RANK.*torchrun"):
        Processes.from_environment()


def test_robots_are_shared_out_evenly():
    group = object.__new__(Processes)
    group.size = 3
    assert group.share(9) == 3
    with pytest.raises(ValueError, match=r"8 robots.*3 processes"):
        group.share(8)
