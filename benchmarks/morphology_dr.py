"""What does it cost to train on many bodies: at once (Spatial-DR), or one after the other (Temporal-DR)?

On flat ground all runs have one environment, seed, actions (targets stance + N(0, 0.15) rad) and number of steps, and
differ in the bodies alone; an environment that was given other bodies in place restarts from the same state.

- Spatial-DR: N different bodies, against N nominal ones (the paper's No-DR) and against N copies of one of the N,
  another one in each pair. The second comparison averages over what bodies cost that contacts make slower.
- Temporal-DR: the same body and the same steps with the switch (`LeggedEnv.set_designs`) on the clock, against without.
  The paper gives each of 81 bodies 1/81 of the training: at 400 iterations of 24 steps that is a switch every 118
  control steps.

Only the environment is on the clock; in a training the policy and its updates add the same to both sides. Prints median
ratios of alternating pairs with bootstrap intervals; both targets are 1.05. In the paper Temporal-DR takes 1.9 times
as long as No-DR, Spatial-DR 1.01 times.

    python benchmarks/morphology_dr.py
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
from locorl import LeggedEnv, PPOConfig, make_task, repeat_design, sample_designs
from locorl.interfaces import Array
from locorl.providers import find_factory

from benchmarks.measure import alternate, machine, median_interval, noisy_stance


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    robot: str = "go2"
    envs: int = 256
    pairs: int = 24
    steps: int = 50
    """Control steps in one run of the spatial comparison."""
    bodies: int = 81
    """Temporal-DR: bodies that take turns in a training."""
    iterations: int = 400
    """Temporal-DR: iterations of that training."""
    seed: int = 0


class Runs:
    """Runs of one environment with bodies of choice, all under the same actions.

    Args:
        env: the environment.
        steps: control steps of the longest run.
        seed: of the actions and of everything that the environment draws.
    """

    def __init__(self, env: LeggedEnv, steps: int, seed: int) -> None:
        self.env, self.seed = env, seed
        self.actions = noisy_stance(env, steps, seed)

    def seconds(self, designs: Array, steps: int, switch: bool = False) -> float:
        """Time of `steps` control steps of bodies `designs`; with `switch`, of putting them in place too."""
        self.env.generator.manual_seed(self.seed)
        begin = time.perf_counter()
        self.env.set_designs(designs)
        if not switch:
            begin = time.perf_counter()
        for action in self.actions[:steps]:
            self.env.step(action)
        return time.perf_counter() - begin

    def restarts(self, designs: Array, steps: int) -> float:
        """Share of the robots that start another episode in the course of such a run."""
        self.env.generator.manual_seed(self.seed)
        self.env.set_designs(designs)
        ended = torch.zeros(self.env.num_envs, dtype=torch.bool)
        for action in self.actions[:steps]:
            _, _, terminated, truncated, _ = self.env.step(action)
            ended |= terminated | truncated
        return float(ended.float().mean())


def print_ratio(name: str, ratio: Array) -> None:
    """A line of the table."""
    median, low, high = median_interval(ratio)
    print(f"{name:44} {median:6.3f}  ({low:.3f} to {high:.3f})", flush=True)


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    n, pairs = options.envs, options.pairs
    every = options.iterations * PPOConfig().steps // options.bodies
    factory = find_factory(options.robot)
    designs = sample_designs(factory, n, np.random.default_rng(options.seed))
    nominal = repeat_design(factory, factory.space.nominal, n)
    env = LeggedEnv(factory, designs, make_task("locomotion-flat"), seed=options.seed)
    runs = Runs(env, max(options.steps, every), options.seed)

    # each measure takes its next body from a sequence of its own; the first one warms up
    turns = np.linspace(0, n - 1, pairs + 1).astype(int)
    copies, with_switch, without = (iter(np.repeat(designs[turns, None], n, axis=1)) for _ in range(3))
    spatial = alternate(
        pairs,
        (
            lambda: runs.seconds(designs, options.steps),
            lambda: runs.seconds(nominal, options.steps),
            lambda: runs.seconds(next(copies), options.steps),
        ),
    )
    temporal = alternate(
        pairs,
        (
            lambda: runs.seconds(next(with_switch), every, switch=True),
            lambda: runs.seconds(next(without), every),
        ),
    )
    print(f"{n} robots of {factory.name} on flat ground, {pairs} pairs; times as long, median (95 % interval)")
    print_ratio("Spatial-DR / nominal body", spatial[:, 0] / spatial[:, 1])
    print_ratio("Spatial-DR / one of the bodies, each in turn", spatial[:, 0] / spatial[:, 2])
    print_ratio(f"Temporal-DR / no switch, every {every} steps", temporal[:, 0] / temporal[:, 1])
    restarts = " and ".join(f"{runs.restarts(bodies, options.steps):.1%}" for bodies in (designs, nominal))
    print(f"robots restarted in a run of {options.steps} steps: {restarts} (Spatial-DR, nominal body)")
    print(machine())


if __name__ == "__main__":
    main()
