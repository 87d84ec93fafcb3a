"""Mixture of teacher and student: whose heading the student follows."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def heading_difference(prediction: Tensor, oracle: Tensor) -> Tensor:
    """|prediction - oracle|, the short way round, elementwise, rad."""
    return (torch.remainder(prediction - oracle + math.pi, 2.0 * math.pi) - math.pi).abs()


def near(prediction: Tensor, oracle: Tensor, threshold: float) -> Tensor:
    """Whether every predicted heading is within `threshold` (rad) of the oracle's: (..., K) -> (...,) bool."""
    return (heading_difference(prediction, oracle) < threshold).all(dim=-1)


def choose(prediction: Tensor, oracle: Tensor, use: Tensor) -> Tensor:
    """The prediction (..., K) where `use` (...,) says so, the oracle's heading elsewhere."""
    return torch.where(use.unsqueeze(-1), prediction, oracle)
