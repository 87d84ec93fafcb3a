"""When the history encoder learns and acts, and how strongly it pulls the privileged encoder towards itself."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RoaSchedule:
    """Regularised online adaptation over the iterations of PPO, counted from 0.

    The defaults are for fine-tuning from a generalist: the weight rises at once, and phases alternate more often than
    in a pre-training of thousands of iterations (there: start 2000, ramp 3000, every 20).
    """

    weight: float = 0.1
    """Final weight of the distance of the privileged latent from the history latent."""
    identification: float = 1.0
    """Weight of the share of the bodies' variance that a linear probe of the history latent leaves unexplained,
    beside the share of the privileged latent's that it misses; 0, as in the paper: the history latent learns of the
    body only what moves the privileged one much, and that is little of the shanks."""
    start: int = 0
    """Iteration at which the weight begins to rise from 0."""
    ramp: int = 1
    """Iterations over which it rises, linearly."""
    warmup: int = 2
    """First iterations, in which the encoder learns from rollouts of the privileged latent."""
    every: int = 5
    """After them, each `every`th iteration is an adaptation phase: the policy acts on the history latent, and the
    encoder learns from what comes of it."""

    def __post_init__(self) -> None:
        if min(self.weight, self.identification, self.start, self.warmup) < 0:
            raise ValueError(f"RoaSchedule: weight, identification, start and warmup must be 0 or more, got {self}")
        if self.ramp < 1 or self.every < 1:
            raise ValueError(f"RoaSchedule: ramp and every must be at least 1, got {self.ramp} and {self.every}")

    def regularisation(self, iteration: int) -> float:
        """Weight of the regularisation."""
        return self.weight * min(1.0, max(0.0, (iteration - self.start) / self.ramp))

    def acts(self, iteration: int) -> bool:
        """Whether the policy acts on the history latent."""
        return iteration >= self.warmup and (iteration - self.warmup) % self.every == 0

    def learns(self, iteration: int) -> bool:
        """Whether the history encoder is trained."""
        return iteration < self.warmup or self.acts(iteration)
