"""What a seeing student learns: the teacher's actions and the oracle's headings."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor
from torch.nn.functional import mse_loss

from distill.vision.config import VisionTrainConfig
from distill.vision.sequences import Sequence
from distill.vision.unroll import Unrolled


class VisionLoss(NamedTuple):
    """Scalars; `total` is the weighted sum, the others are mean squared errors, 0 where they are not asked for."""

    total: Tensor
    action: Tensor
    heading: Tensor
    terrain: Tensor
    velocity: Tensor


def vision_loss(found: Unrolled, sequence: Sequence, config: VisionTrainConfig, limit: float) -> VisionLoss:
    """Mean squared errors of a student against its labels (paper, section III-D).

    Headings and terrain count where an image is in use. Oracle headings beyond what can be predicted are cut to that.

    Args:
        found: by the student.
        sequence: the labels.
        config: weights.
        limit: largest heading, rad.
    """
    none = found.action.new_zeros(())
    action = mse_loss(found.action, sequence.action)
    heading = _mean_where(found.seen, (found.heading - found.oracle.clamp(-limit, limit)).square().mean(dim=-1))
    terrain = velocity = none
    total = action + config.heading_weight * heading
    if config.latent_supervision:
        terrain = _mean_where(found.seen, (found.terrain - sequence.scan_latent).square().mean(dim=-1))
        total = total + config.terrain_weight * terrain
    if not config.roa:
        velocity = mse_loss(found.velocity, sequence.explicit)
        total = total + config.velocity_weight * velocity
    return VisionLoss(total, action, heading, terrain, velocity)


def _mean_where(mask: Tensor, values: Tensor) -> Tensor:
    """Mean of `values` where `mask`; 0 if nowhere."""
    return values.masked_fill(~mask, 0.0).sum() / mask.sum().clamp(min=1)
