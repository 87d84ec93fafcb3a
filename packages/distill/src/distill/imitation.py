"""What the student learns: the teacher's actions, the base velocity and the privileged latent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor
from torch.nn.functional import mse_loss

from distill.student import Student


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms beside the action error, which has weight 1."""

    velocity: float = 1.0
    """Of the squared error of the base velocity (m/s)^2."""
    latent: float = 0.5
    """Of the squared error of the privileged latents; unused with a teacher that has none."""


class ImitationLoss(NamedTuple):
    """Scalars; `total` is the weighted sum, the others are plain mean squared errors."""

    total: Tensor
    action: Tensor
    velocity: Tensor
    latent: Tensor


def imitation_loss(student: Student, samples: Mapping[str, Tensor], weights: LossWeights) -> ImitationLoss:
    """Mean squared errors of the student against its labels (paper, section III-D).

    Args:
        student: the student.
        samples: "history" (B, H, P), "action" (B, 12), "explicit" (B, 3), and "latent" (B, S + L) or none.
        weights: of the terms.
    """
    action, velocity, latent = student.infer(samples["history"])
    action_loss = mse_loss(action, samples["action"])
    velocity_loss = mse_loss(velocity, samples["explicit"])
    latent_loss = mse_loss(latent, samples["latent"]) if "latent" in samples else action_loss.new_zeros(())
    total = action_loss + weights.velocity * velocity_loss + weights.latent * latent_loss
    return ImitationLoss(total, action_loss, velocity_loss, latent_loss)
