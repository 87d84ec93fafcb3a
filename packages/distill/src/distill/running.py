"""Runs that can be killed at any moment and go on bit by bit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import torch

from distill import checkpoint
from distill.errors import CheckpointError
from distill.metrics import MetricsLog
from distill.progress import Progress


class Resumable(Protocol):
    """A training that can be saved at the end of each of its segments, where it restarts its environment."""

    @property
    def iteration(self) -> int:
        """Iterations done."""
        ...

    def segment(self) -> Iterator[dict[str, float]]:
        """Run one segment; yields the metrics of each iteration, "action_loss" among them."""
        ...

    def state_dict(self) -> dict[str, object]:
        """Everything needed to go on from the end of a segment."""
        ...

    def load_state_dict(self, state: dict[str, object], path: Path) -> None:
        """Go on from `state`, read from `path` (named in errors)."""
        ...


def run(training: Resumable, out_dir: Path, iterations: int, samples: int, *, resume: bool, progress: bool) -> None:
    """Bring a training to its end, from wherever `out_dir` says that it stands.

    Args:
        training: as new.
        out_dir: run folder.
        iterations: at which it ends.
        samples: states per iteration, for the rate shown.
        resume: go on from `out_dir/checkpoint.pt` if it exists; otherwise it is overwritten.
        progress: show rate and time left on the terminal.
    """
    path = out_dir / "checkpoint.pt"
    if resume and path.exists():
        training.load_state_dict(checkpoint.load(path), path)
    log = MetricsLog(out_dir / "metrics.jsonl")
    log.rewind(training.iteration)
    with Progress(iterations, training.iteration, "distilling", shown=progress) as bar:
        while training.iteration < iterations:
            for row in training.segment():
                log.append(row)
                bar.advance(samples, row["action_loss"])
            checkpoint.save(path, training.state_dict())


def check_identity(state: Mapping[str, object], here: Mapping[str, object], path: Path) -> None:
    """Refuse the checkpoint of another run.

    Args:
        state: the checkpoint.
        here: what it and this run must have in common.
        path: of the checkpoint.

    Raises:
        CheckpointError: names what differs.
    """
    if unequal := [key for key, value in here.items() if state.get(key) != value]:
        raise CheckpointError(
            f"{path}: written by a run with another {' and '.join(unequal)}; "
            "use the settings of that run, another folder, or start afresh without resuming"
        )


def segment_seed(seed: int, iteration: int) -> int:
    """Seed of the episodes that start at `iteration`; different for every run seed and segment."""
    return (seed * 1_000_003 + iteration) % 2**31


@contextmanager
def own_random_state(seed: int) -> Iterator[None]:
    """Seed torch for the run, and give the caller its random state back."""
    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        yield
