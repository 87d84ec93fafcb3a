"""What every training has: iterations of a rollout and gradient steps, and a state that goes on bit by bit.

A run folder holds `checkpoint.pt` (everything needed to go on), `student.pt` (the result) and `metrics.jsonl`. The
environment is restarted with a fresh seed wherever a checkpoint is written: an environment cannot be saved in general,
and so a resumed run equals an uninterrupted one, bit by bit, with any environment whose `reset(seed)` determines its
episodes.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import torch
from torch import Tensor, nn

from distill import checkpoint
from distill.descent import descend
from distill.errors import CheckpointError
from distill.metrics import MetricsLog
from distill.progress import Progress


@dataclass(frozen=True)
class ScheduleConfig:
    """Hyperparameters that every training has."""

    iterations: int = 64
    """Rollouts, each followed by gradient steps."""
    rollout_steps: int = 24
    """Control steps per robot and rollout."""
    segment: int = 16
    """Iterations between restarts of the environment; a checkpoint is written at each restart."""
    updates: int = 16
    """Gradient steps per iteration."""
    learning_rate: float = 1e-3
    """Adam's rate at the first iteration."""
    final_rate: float = 0.1
    """Share of the rate that is left at the last iteration; linear in between."""
    max_grad_norm: float = 1.0
    """Gradients are scaled down to this norm."""
    seed: int = 0
    """Seed of weights, batches and episodes."""

    def __post_init__(self) -> None:
        """Refuse a training that does nothing."""
        self._at_least_one("iterations", "rollout_steps", "segment", "updates")

    def rate(self, iteration: int) -> float:
        """Learning rate."""
        done = iteration / max(1, self.iterations - 1)
        return self.learning_rate * (1.0 - (1.0 - self.final_rate) * done)

    def _at_least_one(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) < 1:
                raise ValueError(f"{type(self).__name__}.{name} is {getattr(self, name)}; it must be at least 1")


class DataSet(Protocol):
    """What gradient steps draw from."""

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from here."""
        ...

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Take over a `state_dict`."""
        ...


Student_co = TypeVar("Student_co", bound=nn.Module, covariant=True)


class Training(ABC, Generic[Student_co]):
    """One training run: what it is called with, and how far it has come.

    Args:
        config: hyperparameters.
        student: trained wherever its parameters ask for gradients.
        data: what gradient steps draw from.
        robots: N.

    Attributes:
        student: the network in training.
        iteration: iterations done.
    """

    def __init__(self, config: ScheduleConfig, student: Student_co, data: DataSet, robots: int) -> None:
        self.student, self.iteration = student, 0
        self._config, self._data, self._robots = config, data, robots
        trained = [parameter for parameter in student.parameters() if parameter.requires_grad]
        self._optimizer = torch.optim.Adam(trained, lr=config.learning_rate)

    @abstractmethod
    def restart(self, seed: int) -> None:
        """Begin new episodes everywhere."""

    @abstractmethod
    def collect(self) -> dict[str, float]:
        """Roll the student for `config.rollout_steps` and add to the data set; metrics of the rollout."""

    @abstractmethod
    def loss(self) -> dict[str, Tensor]:
        """The loss on a fresh batch: "total", "action" and other terms, () each."""

    @abstractmethod
    def identity(self) -> dict[str, object]:
        """What a checkpoint and a run must have in common, beside configuration and robots."""

    @abstractmethod
    def payload(self) -> dict[str, object]:
        """The student as `checkpoint.student_payload`."""

    def segment(self) -> Iterator[dict[str, float]]:
        """Restart the environment and run up to `config.segment` iterations; yields their metrics."""
        config = self._config
        self.restart(segment_seed(config.seed, self.iteration))
        for _ in range(min(config.segment, config.iterations - self.iteration)):
            yield self._iterate()

    def _iterate(self) -> dict[str, float]:
        config, start = self._config, time.perf_counter()
        rate = config.rate(self.iteration)
        stats = self.collect()
        losses = descend(self._optimizer, self.loss, config.updates, rate, config.max_grad_norm, self.iteration)
        self.iteration += 1
        return {
            "iteration": self.iteration - 1,
            "samples": self.iteration * config.rollout_steps * self._robots,
            "learning_rate": rate,
            **stats,
            **losses,
            "seconds": time.perf_counter() - start,
        }

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from the end of a segment."""
        return {
            **self._identity(),
            **self.payload(),
            "iteration": self.iteration,
            "optimizer": self._optimizer.state_dict(),
            "rollouts": self._data.state_dict(),
            "random": torch.get_rng_state(),
        }

    def load_state_dict(self, state: Mapping[str, object], path: Path) -> None:
        """Go on from `state`, read from `path` (named in errors).

        Raises:
            CheckpointError: the checkpoint is of another run, or incomplete.
        """
        if unequal := [key for key, value in self._identity().items() if state.get(key) != value]:
            raise CheckpointError(
                f"{path}: written by a run with another {' and '.join(unequal)}; "
                "use the settings of that run, another folder, or start afresh without resuming"
            )
        try:
            self.student.load_state_dict(checkpoint.table(checkpoint.table(state["student"])["weights"]))
            self._optimizer.load_state_dict(checkpoint.table(state["optimizer"]))
            self._data.load_state_dict(checkpoint.table(state["rollouts"]))
            iteration, random = state["iteration"], state["random"]
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise CheckpointError(f"{path}: does not fit this student and teacher: {error}") from error
        if not isinstance(iteration, int) or not isinstance(random, Tensor):
            raise CheckpointError(f"{path}: lacks its iteration or its random state")
        self.iteration = iteration
        torch.set_rng_state(random)

    def _identity(self) -> dict[str, object]:
        return {"config": asdict(self._config), "num_envs": self._robots, **self.identity()}

    def run(self, out_dir: Path, *, resume: bool, progress: bool) -> None:
        """Bring the training to its end, from wherever `out_dir` says that it stands, and write the student there.

        Args:
            out_dir: run folder.
            resume: go on from `out_dir/checkpoint.pt` if it exists; otherwise it is overwritten.
            progress: show rate and time left on the terminal.
        """
        config, path = self._config, out_dir / "checkpoint.pt"
        if resume and path.exists():
            self.load_state_dict(checkpoint.load(path), path)
        log = MetricsLog(out_dir / "metrics.jsonl")
        log.rewind(self.iteration)
        with Progress(config.iterations, self.iteration, "distilling", shown=progress) as bar:
            while self.iteration < config.iterations:
                for row in self.segment():
                    log.append(row)
                    bar.advance(config.rollout_steps * self._robots, row["action_loss"])
                checkpoint.save(path, self.state_dict())
        checkpoint.save(out_dir / "student.pt", self.payload())


def segment_seed(seed: int, iteration: int) -> int:
    """Seed of the episodes that start at `iteration`; different for every run seed and segment."""
    return (seed * 1_000_003 + iteration) % 2**31


@contextmanager
def own_random_state(seed: int) -> Iterator[None]:
    """Seed torch for the run, and give the caller its random state back."""
    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        yield
