"""What locorl's benchmarks share: noise for standing robots, a bare batch, alternating runs, intervals, facts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from locorl import LeggedEnv
from locorl.simulation.cpu import CpuSimulator, available_cores
from locorl.simulation.fields import batch_of
from mujoco.batch import Batch
from numpy.typing import NDArray
from torch import Tensor

from legged_codesign.provenance import provenance

NOISE = 0.15
"""Standard deviation of the joint targets around the stance, rad."""


def noisy_stance(env: LeggedEnv, steps: int, seed: int) -> Tensor:
    """Actions that hold the stance under noise, (steps, N, 12)."""
    generator = torch.Generator().manual_seed(seed)
    noise = NOISE * torch.randn(steps, env.num_envs, env.num_actions, generator=generator)
    return noise / env.task.action_scale


def joint_targets(env: LeggedEnv, actions: Tensor) -> NDArray[np.float64]:
    """The joint targets that the environment makes of `actions` (steps, N, 12), to the bit, rad."""
    clip = env.task.action_clip
    return (env.stance_ctrl + env.task.action_scale * actions.clamp(-clip, clip)).double().numpy()


def bare_batch(env: LeggedEnv) -> Batch:
    """A batch with the environment's model and fields, and nothing bound."""
    assert isinstance(env.sim, CpuSimulator)
    return batch_of(env.sim.model, env.num_envs, available_cores(), env.sim.fields)


def alternate(runs: int, measures: Sequence[Callable[[], float]]) -> NDArray[np.float64]:
    """Seconds of each measure, (runs, measures), in turns; every other turn goes backwards, one before warms up."""
    seconds = np.zeros((runs + 1, len(measures)))
    for run in range(runs + 1):
        for index in range(len(measures))[:: 1 if run % 2 else -1]:
            seconds[run, index] = measures[index]()
    return seconds[1:]


def median_interval(values: NDArray[np.float64], draws: int = 10_000, seed: int = 0) -> tuple[float, float, float]:
    """Median of `values` and the bounds of its 95 % percentile bootstrap interval."""
    again = np.random.default_rng(seed).choice(values, (draws, len(values)))
    low, high = np.percentile(np.median(again, axis=1), (2.5, 97.5))
    return float(np.median(values)), float(low), float(high)


def machine() -> str:
    """The processor, its cores and the versions that matter."""
    facts = provenance()
    names = ("processor", "cores", "mujoco", "torch", "commit")
    return ", ".join(f"{name} {facts[name]}" for name in names if name in facts)
