"""`locorl train`."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import rich
import tyro

from locorl.interfaces import BodyFactory
from locorl.learning.config import RegulariserName
from locorl.learning.distributed import Processes
from locorl.learning.divergence import DivergedError
from locorl.learning.policy import load_policy
from locorl.providers import find_factory
from locorl.simulation.cpu import available_cores
from locorl.simulation.make import find_device
from locorl.tasks import Preset, TaskConfig, make_task
from locorl.training.cost import predict
from locorl.training.faults import replay
from locorl.training.tensorboard import TensorBoard
from locorl.training.trainer import TrainConfig, Trainer
from locorl.training.watcher import Watcher


@dataclass(frozen=True)
class Train:
    """Train a generalist on random bodies; a folder with a checkpoint is resumed.

    `torchrun --nproc-per-node 2 --no-python locorl train ...` shares the robots out among processes.
    """

    folder: Annotated[Path, tyro.conf.Positional]
    """Where checkpoint.pt, policy.pt, metrics.jsonl and config.json go."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    task: str | None = None
    """Task by name, as in `locorl play`; by default locomotion-flat with what `--task.` options change in it."""
    preset: Preset = "laptop"
    """Preset of the task named by --task."""
    start: Path | None = None
    """Policy to go on from, for instance with other reward weights; the optimiser starts fresh."""
    adopt: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Take the policy of --start on even if it was trained on bodies with other rules or gains."""
    regulariser: RegulariserName | None = None
    """What keeps the critic from overfitting; the same as --ppo.regulariser."""
    mirror: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Learn from left-right mirror images too; the same as --ppo.mirror."""
    tensorboard: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write FOLDER/tensorboard too, from the first iteration on (extra `tensorboard`); metrics.jsonl has the same."""
    films: int = 0
    """Iterations between films of two robots in FOLDER/films (extra `play`), half a minute each without a GPU; 0 makes
    none."""
    replay: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Train nothing, but repeat the iteration that stopped the run with NaN, from FOLDER/fault.pt."""
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    def run(self) -> None:
        """Train."""
        factory = find_factory(self.robot)
        if self.replay:
            replay(self.folder / "fault.pt", factory)
            rich.print("this time the iteration went well: its cause has been mended, or was no part of the run")
            return
        group = Processes.from_environment(find_device(self.config.simulator.here()))
        try:
            self._train(factory, group)
        finally:
            if group is not None:
                group.close()

    def _train(self, factory: BodyFactory, group: Processes | None) -> None:
        config = self._config()
        start = None if self.start is None else load_policy(self.start)
        if start is not None and self.adopt:
            start = start.adopted(factory)
        watchers = self._watchers() if group is None or group.first else []
        threads = None if group is None else max(1, available_cores() // _processes_here())
        trainer = Trainer(factory, config, self.folder, start=start, threads=threads, group=group)
        if trainer.share.first:
            rich.print(self._plan(trainer))
        trainer.run(watchers=watchers)

    def _plan(self, trainer: Trainer) -> str:
        """What is about to be done, and what it will cost."""
        config = trainer.config
        samples = config.samples_per_iteration * config.iterations
        plan = (
            f"{config.num_envs} robots x {config.ppo.steps} steps x {config.iterations} iterations "
            f"= {samples / 1e6:.1f} M environment steps -> {self.folder}"
        )
        if trainer.iteration >= config.iterations:
            return f"{plan}\nnothing is left to do: --iterations trains longer"
        done = f"from iteration {trainer.iteration}: " if trainer.iteration else ""
        try:
            return f"{plan}\n{done}{predict(trainer)}"
        except DivergedError as error:  # the run will stop where it does, and leave a dump
            return f"{plan}\nthe cost is not known: {error}"

    def _watchers(self) -> list[Watcher]:
        watchers: list[Watcher] = []
        if self.tensorboard:
            watchers.append(TensorBoard(self.folder / "tensorboard"))
        if self.films:
            # draws in MuJoCo's renderer, which training alone does not need
            from locorl.training.films import Films

            watchers.append(Films(self.folder / "films", self.films))
        return watchers

    def _config(self) -> TrainConfig:
        config, ppo = self.config, self.config.ppo
        if self.regulariser is not None:
            ppo = replace(ppo, regulariser=self.regulariser)
        config = replace(config, ppo=replace(ppo, mirror=ppo.mirror or self.mirror))
        if self.task is None and self.preset == "laptop":
            return config
        if config.task != TaskConfig():
            raise ValueError(
                "--task and --preset take a task as it is, `--task.` options change the default one: give either, or "
                "change a task in Python, with dataclasses.replace"
            )
        return replace(config, task=make_task(self.task or "locomotion-flat", self.preset))


def _processes_here() -> int:
    """Processes that `torchrun` started on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
