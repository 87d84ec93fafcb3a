"""Fine-tuning: from a generalist to one body (Algorithm 2's inner loop)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from locorl.bodies.designs import repeat_design
from locorl.interfaces import Array, BodyFactory
from locorl.learning.policy import Policy
from locorl.learning.ppo import PPOConfig
from locorl.training.metrics import read_metrics
from locorl.training.trainer import TrainConfig, Trainer


@dataclass(frozen=True)
class FinetuneConfig:
    """A short training of N identical robots from the generalist; the optimiser starts fresh."""

    num_envs: int = 512
    iterations: int = 12
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(steps=25, learning_rate=2e-4, max_learning_rate=1e-3))
    specific_power: float | None = None
    """Weight of positive mechanical power over body weight in the reward; None keeps the generalist's."""
    command_vx: tuple[float, float] | None = None
    """Commanded forward speeds to train on, m/s; None keeps the generalist's commands."""

    @property
    def samples(self) -> int:
        """Environment steps in one fine-tune."""
        return self.num_envs * self.ppo.steps * self.iterations


@dataclass(frozen=True)
class Finetuned:
    """A fine-tuned policy and how it got there; `curve` holds the metrics of each iteration."""

    policy: Policy
    curve: Sequence[dict[str, float]]


def finetune(
    generalist: Policy,
    factory: BodyFactory,
    design: Array,
    config: FinetuneConfig,
    seed: int,
    folder: Path | None = None,
    quiet: bool = True,
    threads: int | None = None,
) -> Finetuned:
    """Fine-tune `generalist` on one body; the generalist itself is not changed.

    Args:
        generalist: starting point of actor and critic.
        factory: makes the body.
        design: (d,).
        config: budget and learning rate.
        seed: of the run.
        folder: where to keep checkpoint and metrics; a run killed there is resumed.
        quiet: no progress on screen.
        threads: simulation threads.

    Raises:
        ValueError: the design is out of bounds or the body has no stance.
        ppo.DivergedError: training produced NaN.
    """
    task = generalist.card.task
    if config.specific_power is not None:
        task = replace(task, reward=replace(task.reward, specific_power=config.specific_power))
    if config.command_vx is not None:
        narrow = replace(task.command, vx=config.command_vx, vy=(0.0, 0.0), yaw_rate=(0.0, 0.0), standing=0.0)
        task = replace(task, command=narrow)
    train = TrainConfig(
        num_envs=config.num_envs,
        iterations=config.iterations,
        seed=seed,
        task=task,
        ppo=config.ppo,
    )
    bodies = repeat_design(factory, design, config.num_envs)
    trainer = Trainer(factory, train, folder, designs=bodies, start=generalist, threads=threads)
    curve = trainer.run("fine-tune", quiet=quiet)
    if folder:  # a resumed run has earlier iterations too
        curve = read_metrics(folder / "metrics.jsonl")
    return Finetuned(trainer.policy(), curve)
