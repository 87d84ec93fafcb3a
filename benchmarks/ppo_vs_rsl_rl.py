"""How long does locorl's PPO take beside rsl_rl's, on the same environment?

Both train on LeggedEnv (flat ground, every robot its own body) with equal seeds, hidden layers, hyperparameters,
robots and threads; rsl_rl through `locorl.adapters.rsl_rl`. They take turns, one iteration each, so that whatever else
the machine does slows both. What differs: our actor sees the implicit group through an encoder (a small network more),
rsl_rl clips the gradients of actor and critic apart and bootstraps time-outs with the value of the state before.

The learner's time is all time of an iteration outside `env.step` (of the adapter, for rsl_rl, so that the adapter does
not count as learner). Prints ratios ours / rsl_rl, over runs with other seeds: learner (target 0.8) and iteration
(target 0.9); the shares of learner and simulation; and both rewards at the end of training, at equal samples, with the
pooled standard error of their difference over the runs.

    python benchmarks/ppo_vs_rsl_rl.py
    python benchmarks/ppo_vs_rsl_rl.py --runs 1 --iterations 20
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# not the folder of this file: it has a morphgen.py, which `import morphgen` would find
sys.path[0] = str(Path(__file__).parents[1])
# as `import locorl` does where torch is not loaded yet
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch
import tyro
from locorl import PPO, ActorCritic, LeggedEnv, NetworkConfig, PPOConfig, make_task, sample_designs
from locorl.adapters.rsl_rl import RslRlVecEnv, rsl_rl_config
from locorl.providers import find_factory
from numpy.typing import NDArray
from rsl_rl.runners import OnPolicyRunner

from benchmarks.measure import machine

NAMES = ("locorl", "rsl_rl")
WARM_UP = 2
"""Iterations at the start of a run that do not count."""


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    robot: str = "go2"
    task: str = "locomotion-flat"
    envs: int = 1024
    runs: int = 3
    iterations: int = 100
    threads: int | None = None
    """Threads of simulator and torch alike; every core by default."""
    paper: bool = False
    """The paper's network sizes instead of the default ones."""
    seed: int = 0
    """Of the first run; the others count on."""

    def __post_init__(self) -> None:
        """Refuse a run that only warms up."""
        if self.runs < 1 or self.iterations <= WARM_UP:
            raise ValueError(f"need at least 1 run and {WARM_UP + 1} iterations, got {self.runs} and {self.iterations}")


class Training:
    """One training, iteration by iteration.

    Args:
        env: what it trains on, a `LeggedEnv` or its adapter; its `step` is timed from now on.
        iterate: makes one iteration.
    """

    def __init__(self, env: Any, iterate: Callable[[], object]) -> None:
        self._iterate = iterate
        self._simulation, self._rewards = 0.0, []
        step = env.step

        def timed(action: torch.Tensor):
            begin = time.perf_counter()
            result = step(action)
            self._simulation += time.perf_counter() - begin
            self._rewards.append(result[1].mean())
            return result

        env.step = timed

    def iterate(self) -> tuple[float, float, float]:
        """One iteration: seconds in all, seconds of simulation, mean reward of a step."""
        self._simulation, self._rewards = 0.0, []
        begin = time.perf_counter()
        self._iterate()
        elapsed = time.perf_counter() - begin
        return elapsed, self._simulation, float(torch.stack(self._rewards).mean())


def train_ours(env: LeggedEnv, config: PPOConfig, network: NetworkConfig, seed: int) -> Training:
    """Locorl."""
    torch.manual_seed(seed)
    model = ActorCritic(env.group_dims, env.num_actions, network)
    ppo = PPO(model, config, env.num_envs, env.group_dims, seed)
    obs = env.reset()

    def iterate() -> None:
        nonlocal obs
        obs, _ = ppo.collect(env, obs)
        ppo.update()

    return Training(env, iterate)


def train_theirs(raw: LeggedEnv, config: PPOConfig, network: NetworkConfig, seed: int) -> Training:
    """rsl_rl, with its own runner, which writes no log."""
    torch.manual_seed(seed)
    env = RslRlVecEnv(raw)
    runner = OnPolicyRunner(env, rsl_rl_config(env, config, network))
    return Training(env, lambda: runner.learn(1))


def measure(options: Benchmark, seed: int) -> NDArray[np.float64]:
    """Seconds of an iteration, of its simulation, and mean reward (1/s), (2, iterations, 3)."""
    factory = find_factory(options.robot)
    designs = sample_designs(factory, options.envs, np.random.default_rng(seed))
    task = make_task(options.task)
    config, network = PPOConfig(), NetworkConfig.paper() if options.paper else NetworkConfig()
    trainings = []
    for train in (train_ours, train_theirs):
        env = LeggedEnv(factory, designs, task, seed=seed, threads=options.threads)
        trainings.append(train(env, config, network, seed))
    found = np.zeros((2, options.iterations, 3))
    for iteration in range(options.iterations):
        for index in (0, 1) if iteration % 2 else (1, 0):
            found[index, iteration] = trainings[index].iterate()
    found[:, :, 2] /= task.physics.control_dt
    return found


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    if options.threads is not None:
        torch.set_num_threads(options.threads)
    ratios, shares, rewards = [], [], []
    for run in range(options.runs):
        found = measure(options, options.seed + run)
        elapsed, simulation = found[:, WARM_UP:, 0], found[:, WARM_UP:, 1]
        learner = elapsed - simulation
        # of neighbours in time
        ratios.append((np.median(learner[0] / learner[1]), np.median(elapsed[0] / elapsed[1])))
        shares.append((np.median(learner, axis=1), np.median(simulation, axis=1)))
        rewards.append(found[:, -max(1, options.iterations // 10) :, 2].mean(axis=1))
        print(f"run {run}: learner {ratios[-1][0]:.3f}, iteration {ratios[-1][1]:.3f}", flush=True)
    samples = options.envs * PPOConfig().steps * options.iterations / 1e6
    print(f"\n{options.robot}, {options.task}, {options.envs} robots")
    print(f"{options.iterations} iterations, {samples:.1f} M samples")
    print(f"ours / rsl_rl, medians over pairs of iterations, and of {options.runs} runs:")
    for name, values, target in zip(("learner", "iteration"), zip(*ratios, strict=True), (0.8, 0.9), strict=True):
        print(f"  {name:10} {np.median(values):.3f} ({min(values):.3f} to {max(values):.3f}; target {target})")
    for name, learner, simulation in zip(NAMES, *np.mean(shares, axis=0), strict=True):
        whole = learner + simulation
        print(
            f"  {name:10} {whole:.3f} s an iteration: learner {learner:.3f} s ({100 * learner / whole:.0f} %), "
            f"simulation {simulation:.3f} s ({100 * simulation / whole:.0f} %)"
        )
    ours, theirs = np.transpose(rewards)
    print(f"mean reward in the last tenth, 1/s: locorl {ours.mean():.3f}, rsl_rl {theirs.mean():.3f}", end="")
    if options.runs > 1:
        error = np.sqrt((ours.var(ddof=1) + theirs.var(ddof=1)) / options.runs)
        print(f", difference {ours.mean() - theirs.mean():+.3f} +- {error:.3f} (pooled standard error)")
    else:
        print(" (one run: no standard error)")
    print(f"{torch.get_num_threads()} torch threads; {machine()}")


if __name__ == "__main__":
    main()
