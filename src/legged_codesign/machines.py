"""Where the trials of a search run: in this process, beside one another on this machine, on Ray, on Slurm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from codesign_bo.executors import Executor, LocalExecutor, RayExecutor, SlurmExecutor
from locorl.simulation.cpu import available_cores

from legged_codesign.stages import RunError

ExecutorName = Literal["local", "ray", "slurm"]


@dataclass(frozen=True)
class Machines:
    """How many trials run at once, and on what.

    It is no part of a run's configuration: a run that began on a cluster may go on at home. With several workers the
    order in which results come in decides what is proposed next, so the trial table is that of a sequential run only
    up to that.
    """

    executor: ExecutorName = "local"
    """local: this machine. ray: a cluster (extra `legged-codesign-bo[ray]`; RAY_ADDRESS says where, else one is started
    here). slurm: a job for each trial (extra `legged-codesign-bo[slurm]`). The run folder must be seen from all."""
    workers: int = 1
    """Trials at once; one on this machine runs within this process."""
    cpus: int | None = None
    """Cores of each trial; None shares out those of this machine."""
    gpus: float = 0.0
    """GPUs of each trial; on this machine a whole one for each worker."""
    hours: float = 24.0
    """Longest time of a trial."""
    partition: str = ""
    """Of Slurm."""

    def __post_init__(self) -> None:
        """Refuse what cannot run."""
        for name in ("workers", "cpus"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"--{name} is {value}; it must be at least 1")
        if self.gpus < 0 or self.hours <= 0:
            raise ValueError(f"--gpus is {self.gpus:g} and --hours is {self.hours:g}; they must not be negative")

    @property
    def here(self) -> bool:
        """Whether trials run within this process, one after the other."""
        return self.executor == "local" and self.workers == 1

    @property
    def threads(self) -> int | None:
        """Threads of each trial; None takes every core."""
        if self.here:
            return self.cpus
        return self.cpus or max(1, available_cores() // self.workers)

    @contextmanager
    def open(self, folder: Path) -> Iterator[Executor | None]:
        """The executor of a search in the run folder `folder`; None if trials run in this process.

        Raises:
            RunError: the executor's library is not installed, or there is no such cluster.
        """
        if self.here:
            yield None
            return
        try:
            executor = self._executor(folder)
        except (ImportError, ConnectionError, RuntimeError) as error:
            raise RunError(
                f"--executor {self.executor} cannot start: {error}. The run goes on from here with another executor"
            ) from error
        with executor:
            yield executor

    def _executor(self, folder: Path) -> Executor:
        seconds, threads = 3600.0 * self.hours, self.threads or 1
        if self.executor == "ray":
            return RayExecutor(self.workers, num_cpus=threads, num_gpus=self.gpus, timeout=seconds)
        if self.executor == "slurm":
            more: dict[str, Any] = {"slurm_partition": self.partition} if self.partition else {}
            if self.gpus:
                more["gpus_per_node"] = math.ceil(self.gpus)  # Slurm deals out whole ones
            jobs = (folder / "slurm").resolve()
            return SlurmExecutor(self.workers, jobs, round(60 * self.hours), cpus_per_task=threads, **more)
        return LocalExecutor(self.workers, timeout=seconds, gpus=range(self.workers) if self.gpus else ())
