"""Fixtures of locorl: a quadruped of boxes, and small tasks and trainings on it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not

from locorl import LeggedEnv, NetworkConfig, PPOConfig, TaskConfig, TrainConfig, sample_designs
from locorl_box import BoxQuadruped

torch.set_num_threads(1)
settings.register_profile("locorl", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("locorl")


@pytest.fixture(scope="session")
def factory() -> BoxQuadruped:
    return BoxQuadruped()


@pytest.fixture(scope="session")
def designs(factory: BoxQuadruped) -> np.ndarray:
    """Eight feasible designs, far from each other."""
    return sample_designs(factory, 8, np.random.default_rng(5))


@pytest.fixture
def make_env(factory: BoxQuadruped, designs: np.ndarray) -> Callable[..., LeggedEnv]:
    def make(task: TaskConfig | None = None, seed: int = 0, designs: np.ndarray = designs) -> LeggedEnv:
        return LeggedEnv(factory, designs, task or TaskConfig(), seed=seed, threads=1)

    return make


@pytest.fixture(scope="session")
def tiny() -> TrainConfig:
    """A training of seconds."""
    return TrainConfig(
        num_envs=8,
        iterations=4,
        save_every=2,
        ppo=PPOConfig(steps=6, epochs=2, minibatches=2),
        network=NetworkConfig(actor=(16,), critic=(16,), encoder=(8,), latent=4),
    )
