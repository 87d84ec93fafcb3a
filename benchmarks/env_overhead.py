"""How much of a bare `mujoco.batch.Batch.step` rate does `LeggedEnv.step` keep?

For each task, as the laptop preset has it (observations, height scan, rewards, ends, restarts), 1024 random bodies
stand on their tiles under targets stance + N(0, 0.15) rad. The bare batch has the same model, per-simulation fields and
substeps, starts from the environment's own reset state and gets the same targets, so that both simulate the same
motion, but for robots that fall and are restarted; this is checked to the bit before anything is timed. They run in
turns in one process. Prints both rates and the median of their ratios; the target is 0.85 on every task.

    python benchmarks/env_overhead.py
    python benchmarks/env_overhead.py --tasks locomotion-flat parkour-stones --robot lite3
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

# not the folder of this file: it has a morphgen.py, which `import morphgen` would find
sys.path[0] = str(Path(__file__).parents[1])
# as `import locorl` does where torch is not loaded yet
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch
import tyro
from locorl import TASKS, LeggedEnv, make_task, sample_designs
from locorl.providers import find_factory
from numpy.typing import NDArray

from benchmarks.measure import alternate, bare_batch, joint_targets, machine, noisy_stance


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    tasks: tuple[str, ...] = ("all",)
    """Names of tasks, or `all`."""
    robot: str = "go2"
    envs: int = 1024
    steps: int = 50
    """Control steps in one run; the scan looks at every fifth."""
    runs: int = 8
    """Alternating runs of each."""
    seed: int = 0


def compare(env: LeggedEnv, options: Benchmark) -> tuple[NDArray[np.float64], float]:
    """Seconds of the bare batch and of the environment, (runs, 2), and the share of robots restarted in a run."""
    actions = noisy_stance(env, options.steps, options.seed)
    targets = joint_targets(env, actions)
    env.reset(seed=options.seed)
    start = env.state_dict()
    batch = bare_batch(env)
    qpos, ctrl = batch.bind("qpos"), batch.bind("ctrl")

    def run_env() -> float:
        env.load_state_dict(start)
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - begin

    def run_bare() -> float:
        batch.reset()
        batch.state[...] = start["sim.state"].numpy()
        begin = time.perf_counter()
        for target in targets:
            ctrl[...] = target
            batch.step(nstep=env.task.physics.substeps)
        return time.perf_counter() - begin

    restarted = torch.zeros(env.num_envs, dtype=torch.bool)
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        restarted |= terminated | truncated
    run_bare()
    alike = (torch.from_numpy(qpos) == env.sim.qpos).all(dim=1)
    assert (alike | restarted).all(), "the bare batch does not simulate what the environment does"
    return alternate(options.runs, (run_bare, run_env)), float(restarted.float().mean())


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    factory = find_factory(options.robot)
    designs = sample_designs(factory, options.envs, np.random.default_rng(options.seed))
    print(f"{options.envs} bodies of {factory.name}, {options.steps} control steps a run, {options.runs} runs of each")
    print(f"{'':20}  thousand control steps/s   ratio, median            robots")
    print(f"{'task':20}  Batch.step  LeggedEnv.step  (lowest to highest)  restarted")
    for name in TASKS if options.tasks == ("all",) else options.tasks:
        env = LeggedEnv(factory, designs, make_task(name), seed=options.seed)
        seconds, restarted = compare(env, options)
        bare, ours = options.envs * options.steps / np.median(seconds, axis=0) / 1000
        ratio = seconds[:, 0] / seconds[:, 1]
        spread = f"{np.median(ratio):.3f} ({ratio.min():.3f} to {ratio.max():.3f})"
        print(f"{name:20}  {bare:10.1f}  {ours:14.1f}  {spread}  {restarted:8.1%}", flush=True)
    print(machine())


if __name__ == "__main__":
    main()
