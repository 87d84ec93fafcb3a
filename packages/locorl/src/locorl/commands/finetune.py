"""`locorl finetune`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import rich
import tyro
from rich.table import Table

from locorl.commands.evaluate import check_plot
from locorl.evaluation.evaluate import EvalConfig, evaluate
from locorl.evaluation.fitness import MEASURES, Gain, gains
from locorl.evaluation.statistics import Estimate, estimate
from locorl.learning.policy import load_policy
from locorl.providers import find_factory
from locorl.training.finetune import FinetuneConfig, Finetuned, finetune


@dataclass(frozen=True)
class Finetune:
    """Fine-tune a generalist to one body and print both policies' scores on it."""

    checkpoint: Annotated[Path, tyro.conf.Positional]
    """The generalist: a policy.pt, or a training's checkpoint.pt."""
    folder: Annotated[Path, tyro.conf.Positional]
    """Where policy.pt, metrics and the evaluated policies go; a fine-tune that was interrupted there goes on."""
    design: tuple[float, ...]
    """Design parameters in the order of the design space."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    adopt: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Take the generalist on even if it was trained on bodies with other rules or gains."""
    seed: int = 0
    """Of everything random in the fine-tune."""
    config: FinetuneConfig = field(default_factory=FinetuneConfig)
    evaluation: EvalConfig = field(default_factory=lambda: EvalConfig(robots_per_body=64, reset_joint=0.1))
    """The evaluation that is reported, with a seed of its own."""
    plot: Path | None = None
    """Learning curve, as a .png."""

    def run(self) -> None:
        """Fine-tune and compare."""
        config = self.config
        if config.chooses and config.choice.seed == self.evaluation.seed:
            raise ValueError(
                f"--config.choice.seed and --evaluation.seed are both {self.evaluation.seed}: what chose a policy "
                "cannot report how good it is; take another seed for one of them"
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        check_plot(self.plot)
        factory = find_factory(self.robot)
        design = np.asarray(self.design)
        tuned = finetune(
            self.checkpoint, factory, design, config, self.seed, self.folder, quiet=False, adopt=self.adopt
        )
        tuned.policy.save(self.folder / "policy.pt")
        # both by the reward that the fine-tune is about
        task, generalist = tuned.policy.card.task, load_policy(self.checkpoint)
        before, after = (
            evaluate(policy, factory, design[None], task, self.evaluation, simulator=config.simulator)
            for policy in (generalist, tuned.policy)
        )
        if tuned.candidates:
            rich.print(_candidates_table(tuned))
        rich.print(gains_table(gains(before, after)))
        _explain(tuned, config)
        if self.plot is not None:
            from locorl.evaluation.plots import finetune_figure, save

            judged = {candidate.iteration: estimate(candidate.returns) for candidate in tuned.candidates}
            save(finetune_figure(tuned.curve, judged, tuned.iteration), self.plot)
            rich.print(f"learning curve -> {self.plot}")


def _explain(tuned: Finetuned, config: FinetuneConfig) -> None:
    if tuned.stopped:
        rich.print(
            f"stopped at iteration {tuned.candidates[-1].iteration} of {config.iterations}: no improvement in "
            f"{config.patience} evaluations"
        )
    if config.keep_best:
        what = "the generalist itself: nothing that came after was better" if tuned.iteration == 0 else "the best"
        rich.print(f"policy.pt is that of iteration {tuned.iteration}, {what}")


def gains_table(results: Mapping[str, Gain]) -> Table:
    """Before, after and difference of each measure, with standard errors over robots."""
    robots = next(iter(results.values())).before.n
    table = Table(title=f"{robots} robots, the same commands and starts; mean ± standard error")
    for column in ("", "generalist", "fine-tuned", "difference, robot by robot"):
        table.add_column(column, justify="right" if column else "left")
    for name, gain in results.items():
        table.add_row(MEASURES[name], _show(gain.before), _show(gain.after), _show(gain.difference, "+"))
    return table


def _candidates_table(tuned: Finetuned) -> Table:
    table = Table(title="policies to choose from (other robots than those below)")
    for column in ("iteration", "return (eq. 9)", "positive joint work, J (eq. 10)", "survived"):
        table.add_column(column, justify="right")
    for candidate in tuned.candidates:
        kept = " *" if candidate.iteration == tuned.iteration else "  "
        values = (_show(estimate(each)) for each in (candidate.returns, candidate.energy))
        table.add_row(f"{candidate.iteration}{kept}", *values, f"{candidate.survived:.0%}")
    return table


def _show(value: Estimate, sign: str = "") -> str:
    return f"{value.mean:{sign}.4g} ± {value.sem:.2g}" if value.n > 1 else f"{value.mean:{sign}.4g}"
