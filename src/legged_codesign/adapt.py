"""Fine-tune a generalist on one body while estimator and history encoder learn beside it (section III-D)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import distill
import torch
from locorl import FinetuneConfig, Policy, PPOConfig, RolloutHook, TaskConfig, finetune
from locorl.env.observation import observation_layout
from locorl.interfaces import Array, BodyFactory
from locorl.learning.networks import ActorCritic
from locorl.simulation.make import find_device


@dataclass(frozen=True)
class AdaptConfig:
    """The fine-tune that prepares a teacher for its student."""

    finetune: FinetuneConfig = field(
        default_factory=lambda: FinetuneConfig(
            iterations=40, ppo=PPOConfig(steps=24, learning_rate=2e-4, max_learning_rate=1e-3)
        )
    )
    """Budget and learning rates; its history is that of the networks below."""
    networks: distill.AdaptationConfig = field(default_factory=distill.AdaptationConfig)
    """Sizes of estimator and history encoder."""
    schedule: distill.RoaSchedule = field(default_factory=distill.RoaSchedule)
    """Regularisation (from 0 to 0.1 at once) and adaptation phases."""
    estimate_after: int | None = 10
    """Iterations after which the teacher acts on the estimated velocity; None: never, and then it cannot afterwards."""

    @property
    def past(self) -> int:
        """Past frames of proprioception that the robots observe."""
        return self.networks.history - 1


class Adaptation:
    """Estimator, history encoder and the hooks that train them in the rollouts of a teacher.

    Args:
        teacher: the policy to start from.
        config: sizes and schedule.
        seed: of the networks' weights and of the minibatches; the same weights on every device.
        device: where the rollouts are.

    Attributes:
        networks: estimator and history encoder.
        hooks: give them to a `Trainer` or to `finetune`.
    """

    def __init__(self, teacher: Policy, config: AdaptConfig, seed: int, device: torch.device | str = "cpu") -> None:
        proprio = teacher.card.dims["proprio"]
        blank = heading_columns(teacher.card.task, len(teacher.card.design_names))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.networks = distill.build_adaptation(proprio, teacher, config.networks, blank, device)
        self._roa = distill.RegularisedAdaptation(self.networks, config.schedule, seed=seed)
        estimation = distill.VelocityEstimation(self.networks, config.estimate_after, seed=seed)
        self.hooks: Sequence[RolloutHook] = (estimation, self._roa)

    def attach(self, model: ActorCritic) -> None:
        """Show the policy in training to the regularisation."""
        self._roa.attach(model.latent)


def adapt(
    folder: Path,
    factory: BodyFactory,
    generalist: Policy,
    design: Array,
    config: AdaptConfig,
    seed: int,
    quiet: bool = False,
) -> tuple[Policy, distill.AdaptationModule]:
    """Fine-tune `generalist` on the body `design` (d,), or go on with the fine-tune found in `folder`.

    Returns:
        The teacher, and the estimator and history encoder that know what it is told, on the device of the simulator.
    """
    adaptation = Adaptation(generalist, config, seed, find_device(config.finetune.simulator.here()))
    tuned = finetune(
        generalist,
        factory,
        design,
        replace(config.finetune, history=config.past),
        seed,
        folder,
        quiet=quiet,
        hooks=adaptation.hooks,
        attach=adaptation.attach,
    )
    return tuned.policy, adaptation.networks


def heading_columns(task: TaskConfig, num_design: int) -> range:
    """Columns of the proprioception that hold the way to go, which no sensor gives."""
    layout = observation_layout(task.observation, num_design)
    hidden = [layout.column("proprio", term.name) for term in layout.proprio if not term.onboard]
    return range(hidden[0].start, hidden[-1].stop) if hidden else range(0)
