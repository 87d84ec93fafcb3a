"""`locorl finetune`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from locorl.commands.evaluate import print_summaries
from locorl.evaluation.evaluate import EvalConfig, evaluate
from locorl.learning.policy import load_policy
from locorl.providers import find_factory
from locorl.training.finetune import FinetuneConfig, finetune


@dataclass(frozen=True)
class Finetune:
    """Fine-tune a generalist to one body and print both policies' scores on it."""

    checkpoint: Annotated[Path, tyro.conf.Positional]
    folder: Annotated[Path, tyro.conf.Positional]
    design: tuple[float, ...]
    """Design parameters in the order of the design space."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    seed: int = 0
    config: FinetuneConfig = field(default_factory=FinetuneConfig)
    evaluation: EvalConfig = field(default_factory=lambda: EvalConfig(robots_per_body=64, reset_joint=0.1))

    def run(self) -> None:
        """Fine-tune and compare."""
        factory, generalist = find_factory(self.robot), load_policy(self.checkpoint)
        design = np.asarray(self.design)
        tuned = finetune(generalist, factory, design, self.config, self.seed, self.folder, quiet=False)
        tuned.policy.save(self.folder / "policy.pt")
        results = {
            name: evaluate(policy, factory, design[None], generalist.card.task, self.evaluation).summary()
            for name, policy in (("generalist", generalist), ("fine-tuned", tuned.policy))
        }
        print_summaries(results)
