"""`locorl train`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import rich
import tyro

from locorl.learning.policy import load_policy
from locorl.providers import find_factory
from locorl.tasks import Preset, TaskConfig, make_task
from locorl.training.trainer import TrainConfig, Trainer


@dataclass(frozen=True)
class Train:
    """Train a generalist on random bodies; a folder with a checkpoint is resumed."""

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
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    def run(self) -> None:
        """Train."""
        config = self._config()
        samples = config.samples_per_iteration * config.iterations
        rich.print(
            f"{config.num_envs} robots x {config.ppo.steps} steps x {config.iterations} iterations "
            f"= {samples / 1e6:.1f} M environment steps -> {self.folder}"
        )
        start = None if self.start is None else load_policy(self.start)
        trainer = Trainer(find_factory(self.robot), config, self.folder, start=start)
        trainer.run()

    def _config(self) -> TrainConfig:
        if self.task is None and self.preset == "laptop":
            return self.config
        if self.config.task != TaskConfig():
            raise ValueError(
                "--task and --preset take a task as it is, `--task.` options change the default one: give either, or "
                "change a task in Python, with dataclasses.replace"
            )
        return replace(self.config, task=make_task(self.task or "locomotion-flat", self.preset))
