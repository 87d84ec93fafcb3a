"""How much of a bare `mujoco.batch.Batch.step` rate does `LeggedEnv.step` keep?

Both run 1024 random Go2 bodies on flat ground with the same model, substeps and per-simulation fields, from the stance,
under targets stance + N(0, 0.15) rad, in alternating runs of one process. The bare batch binds nothing but `ctrl` and
`qpos`. Prints both rates and their ratio; the target is 0.80.

    python benchmarks/env_overhead.py
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

# the folder of this file has a morphgen.py, which `import morphgen` would find
sys.path = [folder for folder in sys.path if Path(folder) != Path(__file__).parent]

import numpy as np
import torch
import tyro
from locorl import LeggedEnv, TaskConfig, sample_designs
from locorl.providers import find_factory
from locorl.simulation.cpu import available_cores
from mujoco.batch import Batch

from legged_codesign.provenance import provenance

NOISE = 0.15


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    envs: int = 1024
    steps: int = 50
    """Control steps in one run."""
    runs: int = 8
    """Alternating runs of each."""
    seed: int = 0


def bare_batch(env: LeggedEnv) -> Batch:
    """A batch with the environment's model and fields."""
    batch = Batch(env.sim.model, env.num_envs, available_cores())
    for name, values in env.sim.fields.items():
        batch.expand(name)[...] = values
    batch.set_const()
    return batch


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    factory = find_factory("go2")
    designs = sample_designs(factory, options.envs, np.random.default_rng(options.seed))
    task = TaskConfig()
    env = LeggedEnv(factory, designs, task, seed=options.seed)
    batch = bare_batch(env)
    qpos, qvel, ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
    generator = torch.Generator().manual_seed(options.seed)
    noise = NOISE * torch.randn(options.steps, options.envs, 12, generator=generator)
    targets = (env.stance_ctrl + noise).double().numpy()
    actions = noise / task.action_scale

    def run_env() -> float:
        env.reset(seed=options.seed)
        start = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - start

    def run_bare() -> float:
        batch.reset()
        qpos[...], qvel[...] = env.stance_qpos.numpy(), 0.0
        start = time.perf_counter()
        for target in targets:
            ctrl[...] = target
            batch.step(nstep=task.physics.substeps)
        return time.perf_counter() - start

    run_env(), run_bare()
    pairs = np.array([(run_bare(), run_env()) for _ in range(options.runs)])
    rates = options.envs * options.steps / pairs / 1000
    ratio = pairs[:, 0] / pairs[:, 1]
    print(f"bare Batch.step  {np.median(rates[:, 0]):7.1f} thousand control steps/s")
    print(f"LeggedEnv.step   {np.median(rates[:, 1]):7.1f} thousand control steps/s")
    print(f"ratio            {np.median(ratio):7.3f}  ({ratio.min():.3f} to {ratio.max():.3f} in {options.runs} runs)")
    facts = provenance()
    print(", ".join(f"{name} {facts[name]}" for name in ("processor", "cores", "mujoco", "torch") if name in facts))


if __name__ == "__main__":
    main()
