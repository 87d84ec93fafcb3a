"""Training, fine-tuning and evaluation on MuJoCo Warp's CPU device, and what a device changes in a run's identity."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from locorl import EvalConfig, FinetuneConfig, SimulatorConfig, TrainConfig, Trainer, evaluate, finetune
from locorl.checkpoint import CheckpointError, load
from locorl.config import to_dict
from locorl.learning.policy import load_policy
from locorl.learning.ppo import PPOConfig
from locorl.training.resume import identity

WARP = SimulatorConfig("warp")
SMALL = TrainConfig(num_envs=8, iterations=2, save_every=1, ppo=PPOConfig(steps=4, minibatches=2))


def test_cuda_is_each_process_own_gpu(monkeypatch):
    cuda = SimulatorConfig("warp", "cuda", threads=3)
    monkeypatch.delenv("LOCAL_RANK", raising=False)
    assert cuda.here() == cuda
    monkeypatch.setenv("LOCAL_RANK", "2")
    assert cuda.here(threads=1) == SimulatorConfig("warp", "cuda:2", threads=1)
    assert SimulatorConfig("warp", "cuda:0").here().device == "cuda:0"
    assert SimulatorConfig().here().device == "cpu"


def test_identity_is_the_backend_and_the_kind_of_device():
    def of(**simulator):
        return identity(to_dict(replace(SMALL, simulator=SimulatorConfig(**simulator))))

    assert of(threads=1) == of(threads=2) == of(contacts=99)
    assert of(backend="warp", device="cuda:0") == of(backend="warp", device="cuda")
    assert of(backend="warp", device="cuda") != of(backend="warp") != of()
    before = to_dict(SMALL)
    del before["simulator"]  # as runs were written down before there was a choice
    assert identity(before) == of()


def test_threads_change_on_resume_but_not_the_backend(factory, tmp_path):
    Trainer(factory, replace(SMALL, simulator=SimulatorConfig(threads=1)), tmp_path).run(quiet=True)
    assert Trainer(factory, replace(SMALL, simulator=SimulatorConfig(threads=2)), tmp_path).iteration == 2
    with pytest.raises(CheckpointError, match=r"simulator\.backend: cpu -> warp"):
        Trainer(factory, replace(SMALL, simulator=WARP), tmp_path)


def test_a_policy_acts_where_the_observations_are(factory):
    trainer = Trainer(factory, SMALL)
    policy = trainer.policy()
    assert policy.act({name: value.to("meta") for name, value in trainer.env.reset().items()}).device.type == "meta"
    assert trainer.model.log_std.device.type == "cpu"  # that in training stays


@pytest.mark.slow
def test_training_resumes_exactly_and_its_policy_is_evaluated_and_fine_tuned(factory, tmp_path):
    pytest.importorskip("mujoco_warp")
    config = replace(SMALL, simulator=WARP)
    rows = Trainer(factory, config, tmp_path / "whole").run(quiet=True)
    assert all(math.isfinite(value) for row in rows for value in row.values())
    Trainer(factory, replace(config, iterations=1), tmp_path / "parts").run(quiet=True)
    Trainer(factory, config, tmp_path / "parts").run(quiet=True)
    whole, parts = (load(tmp_path / name / "checkpoint.pt")["model"] for name in ("whole", "parts"))
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


@pytest.mark.slow
def test_a_policy_of_the_cpu_is_evaluated_and_fine_tuned_on_warp(factory, tmp_path):
    pytest.importorskip("mujoco_warp")
    Trainer(factory, SMALL, tmp_path).run(quiet=True)
    policy, design = load_policy(tmp_path / "policy.pt"), factory.space.low / 2 + factory.space.high / 2
    protocol = EvalConfig(seconds=0.3, settle=0.1, robots_per_body=2)
    cpu, warp = (
        evaluate(policy, factory, design[None], policy.card.task, protocol, simulator=simulator)
        for simulator in (None, WARP)
    )
    assert isinstance(warp.distance, np.ndarray)
    np.testing.assert_array_equal(warp.survived, cpu.survived)
    np.testing.assert_allclose(warp.distance, cpu.distance, atol=0.01)
    np.testing.assert_allclose(warp.energy, cpu.energy, rtol=0.1)
    tuning = FinetuneConfig(num_envs=8, iterations=1, ppo=SMALL.ppo, simulator=WARP, keep_best=True, choice=protocol)
    tuned = finetune(policy, factory, design, tuning, seed=0)
    assert [candidate.iteration for candidate in tuned.candidates] == [0, 1]
    assert math.isfinite(tuned.curve[0]["reward"])
