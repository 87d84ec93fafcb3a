"""What the studies share: snapshots of a training, the machine's own rate, and a folder under results/."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from locorl import LeggedEnv, PPOConfig, TaskConfig, TrainConfig, Trainer, repeat_design, sample_designs
from locorl.interfaces import Array, BodyFactory

from legged_codesign.provenance import described

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.measure import bare_batch

RUNS, RESULTS = ROOT / "runs" / "studies", ROOT / "results"

BODIES, EVALUATION_SEED = 100, 7
MIRRORED = PPOConfig(mirror=True)


class Snapshots:
    """Keeps a copy of the policy every so many iterations; a `Watcher`.

    Args:
        folder: of the training; the copies go to its folder `snapshots`, named after the iteration.
        every: iterations between two.
    """

    def __init__(self, folder: Path, every: int) -> None:
        self._folder, self._every = folder / "snapshots", every

    @property
    def paths(self) -> list[Path]:
        """The copies, in order."""
        return sorted(self._folder.glob("*.pt"))

    def begin(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def watch(self, trainer: Trainer, row: Mapping[str, float]) -> None:
        """Copy when it is time, and at the end."""
        if trainer.iteration % self._every == 0 or trainer.iteration == trainer.config.iterations:
            trainer.policy().save(self._folder / f"{trainer.iteration:05d}.pt")

    def end(self) -> None:
        """Nothing is open."""


def bare_rate(factory: BodyFactory, config: TrainConfig, seconds: float = 8.0) -> float:
    """Control steps per second that MuJoCo's bare batch makes of this task's robots in their stance.

    What a machine can do at all: to be printed beside the time that a training took on it.
    """
    env = LeggedEnv(factory, repeat_design(factory, factory.space.nominal, config.num_envs), config.task, seed=0)
    env.reset()
    batch = bare_batch(env)
    batch.bind("qpos")[:] = env.sim.qpos.numpy()
    batch.bind("ctrl")[:] = env.stance_ctrl.double().numpy()
    started, steps = time.perf_counter(), 0
    while time.perf_counter() - started < seconds:
        batch.step(nstep=config.task.physics.substeps)
        steps += 1
    return steps * env.num_envs / (time.perf_counter() - started)


def rate_beside(folder: Path, factory: BodyFactory, config: TrainConfig) -> float:
    """The machine's bare rate just before the training of `folder` began, control steps per second."""
    path = folder / "bare_rate.txt"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{bare_rate(factory, config):.0f}\n", encoding="utf-8")
    return float(path.read_text(encoding="utf-8"))


def unseen_bodies(factory: BodyFactory, count: int = BODIES) -> Array:
    """The feasible bodies of the evaluations, drawn with a seed that no training has, (B, d)."""
    return sample_designs(factory, count, np.random.default_rng(EVALUATION_SEED))


def paired_ratio(ours: Array, theirs: Array) -> tuple[float, float, float]:
    """Ratio of the means of two results of the same robots, (R,) each, and the bounds of its 95 % interval."""
    mine, other = _resampled(ours, theirs)
    # no success at all cannot be compared with anything
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.divide(ours.mean(), theirs.mean())), *_middle(mine / other)


def paired_difference(ours: Array, theirs: Array) -> tuple[float, float, float]:
    """Difference of the means of two results of the same robots, (R,) each, and the bounds of its 95 % interval."""
    mine, other = _resampled(ours, theirs)
    return float(ours.mean() - theirs.mean()), *_middle(mine - other)


def _resampled(ours: Array, theirs: Array, draws: int = 10_000) -> tuple[Array, Array]:
    """Means (draws,) of both over robots drawn with replacement, the same for both."""
    index = np.random.default_rng(0).integers(len(ours), size=(draws, len(ours)))
    return ours[index].mean(axis=1), theirs[index].mean(axis=1)


def _middle(values: Array) -> tuple[float, float]:
    low, high = np.percentile(values, (2.5, 97.5))
    return float(low), float(high)


def on(
    *kinds: str, difficulty: tuple[float, float] = (0.0, 1.0), levels: int = 10
) -> Callable[[TaskConfig], TaskConfig]:
    """The task on other ground."""
    return lambda task: task.on(kinds, difficulty=difficulty, levels=levels)


def write_results(name: str, summary: Sequence[str], facts: Mapping[str, Any], seeds: Sequence[int]) -> Path:
    """Make results/`name` with README.md and study.json. Returns the folder.

    Args:
        name: of the folder.
        summary: Markdown lines that say what came out.
        facts: all numbers.
        seeds: of the trainings.
    """
    folder = RESULTS / name
    folder.mkdir(parents=True, exist_ok=True)
    command = shlex.join(["python", str(Path(sys.argv[0]).resolve().relative_to(ROOT)), *sys.argv[1:]])
    lines = (f"# {name}", "", *summary, "", *described(command, ", ".join(map(str, seeds))))
    (folder / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "study.json").write_text(json.dumps(facts, indent=1, default=_plain) + "\n", encoding="utf-8")
    return folder


def markdown_table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """Lines of a Markdown table."""
    return [f"| {' | '.join(map(str, row))} |" for row in (columns, ["---"] * len(columns), *rows)]


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} in study.json")
