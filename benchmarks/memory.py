"""How much memory do 4096 environments with hills take?

Peak resident memory of this process after the imports, after the construction of the environment and after some steps
of it, height scan and all. The target is 6 GB.

    python benchmarks/memory.py
"""

from __future__ import annotations

import resource
import sys
from dataclasses import dataclass
from pathlib import Path

# not the folder of this file: it has a morphgen.py, which `import morphgen` would find
sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import tyro
from locorl import LeggedEnv, make_task, sample_designs
from locorl.providers import find_factory

from benchmarks.measure import machine, noisy_stance


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    task: str = "locomotion-hills"
    robot: str = "go2"
    envs: int = 4096
    steps: int = 10
    seed: int = 0


def report(what: str) -> None:
    """Print the peak so far."""
    unit = 1 if sys.platform == "darwin" else 1024
    print(f"{what:28} {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9:6.2f} GB", flush=True)


def main() -> None:
    """Build, step and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    print(f"{options.envs} bodies of {options.robot} on {options.task}: peak resident memory")
    report("imports")
    factory = find_factory(options.robot)
    designs = sample_designs(factory, options.envs, np.random.default_rng(options.seed))
    report("bodies sampled")
    env = LeggedEnv(factory, designs, make_task(options.task), seed=options.seed)
    report("environment built")
    env.reset()
    for action in noisy_stance(env, options.steps, options.seed):
        env.step(action)
    report(f"reset and {options.steps} steps")
    env.set_designs(designs[::-1])
    report("other bodies put in place")
    print(machine())


if __name__ == "__main__":
    main()
