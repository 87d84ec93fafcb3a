"""`locorl train`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import rich
import tyro

from locorl.learning.policy import load_policy
from locorl.learning.train import TrainConfig, Trainer
from locorl.providers import find_factory


@dataclass(frozen=True)
class Train:
    """Train a generalist on random bodies; a folder with a checkpoint is resumed."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Where checkpoint.pt, policy.pt, metrics.jsonl and config.json go."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    start: Path | None = None
    """Policy to go on from, for instance with other reward weights; the optimiser starts fresh."""
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)

    def run(self) -> None:
        """Train."""
        samples = self.config.samples_per_iteration * self.config.iterations
        rich.print(
            f"{self.config.num_envs} robots x {self.config.ppo.steps} steps x {self.config.iterations} iterations "
            f"= {samples / 1e6:.1f} M environment steps -> {self.folder}"
        )
        start = None if self.start is None else load_policy(self.start)
        trainer = Trainer(find_factory(self.robot), self.config, self.folder, start=start)
        trainer.run()
