"""The losses of PPO."""

from __future__ import annotations

import torch
from torch import Tensor

from locorl.learning.storage import Minibatch


def clipped_surrogate(log_prob: Tensor, batch: Minibatch, clip: float) -> Tensor:
    """-mean of min(r A, clip(r, 1 - c, 1 + c) A), (), with r the likelihood ratio to the policy that acted.

    Args:
        log_prob: of the actions under the policy as it is now, (B,).
        batch: the transitions.
        clip: c.
    """
    ratio = (log_prob - batch.log_prob).exp()
    return -torch.min(batch.advantage * ratio, batch.advantage * ratio.clamp(1 - clip, 1 + clip)).mean()


def clipped_value_loss(value: Tensor, batch: Minibatch, clip: float) -> Tensor:
    """Mean of the larger squared error, (): of the new value, and of it held within `clip` of the old one.

    Args:
        value: of the states as the critic is now, (B,).
        batch: the transitions.
        clip: greatest step of a value.
    """
    clipped = batch.value + (value - batch.value).clamp(-clip, clip)
    return torch.max((value - batch.target).square(), (clipped - batch.target).square()).mean()


def gaussian_kl(mean: Tensor, std: Tensor, old_mean: Tensor, old_std: Tensor) -> Tensor:
    """KL(old || new) of diagonal Gaussians, mean over rows, ().

    Args:
        mean: of the new policy, (B, A).
        std: of the new policy, (A,).
        old_mean: (B, A).
        old_std: (A,).
    """
    ratio = old_std / std
    spread = 0.5 * (ratio.square() - 1.0) - ratio.log()
    return 0.5 * ((mean - old_mean) / std).square().sum(dim=1).mean() + spread.sum()
