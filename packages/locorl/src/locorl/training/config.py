"""The configuration of a training run."""

from __future__ import annotations

from dataclasses import dataclass, field

from locorl.bodies.samplers import MorphologyConfig
from locorl.learning.config import PPOConfig
from locorl.learning.networks import NetworkConfig
from locorl.simulation.make import SimulatorConfig
from locorl.tasks.task import TaskConfig


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    num_envs: int = 1024
    """Robots trained at once, by all processes together."""
    iterations: int = 500
    """Rollouts and updates."""
    seed: int = 0
    save_every: int = 20
    """Iterations between checkpoints."""
    morphology: MorphologyConfig = field(default_factory=MorphologyConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    simulator: SimulatorConfig = field(default_factory=SimulatorConfig)

    def __post_init__(self) -> None:
        """Refuse impossible settings before anything runs."""
        for name, least in (("num_envs", 1), ("iterations", 0), ("seed", 0), ("save_every", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"TrainConfig: {name} must be at least {least}, got {getattr(self, name)}")
        # the advantages of a batch are divided by their standard deviation
        needed = max(2, self.ppo.minibatches)
        if self.samples_per_iteration < needed:
            raise ValueError(
                f"TrainConfig: {self.num_envs} robots x {self.ppo.steps} steps are too few samples for "
                f"{self.ppo.minibatches} minibatches: there must be at least {needed}"
            )

    @property
    def samples_per_iteration(self) -> int:
        """Environment steps in one iteration."""
        return self.num_envs * self.ppo.steps
