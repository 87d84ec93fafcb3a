"""The reward of one control step: the weighted sum of all active terms."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache, reduce

import torch
from torch import Tensor

from locorl.rewards.config import RewardConfig
from locorl.rewards.state import StepState
from locorl.rewards.terms import TERMS, find_term


def active_terms(config: RewardConfig) -> dict[str, float]:
    """Weights that are not zero, by term, your own after the others.

    Raises:
        ValueError: a term of your own cannot be imported.
    """
    weights = {field.name: getattr(config, field.name) for field in fields(config) if field.name in TERMS}
    weights |= dict(config.own)
    for name in weights:
        find_term(name)
    return {name: float(weight) for name, weight in weights.items() if weight != 0.0}


def total_reward(state: StepState, config: RewardConfig, dt: float) -> tuple[Tensor, dict[str, Tensor]]:
    """Sum of all active terms for one control step.

    Args:
        state: the N robots after the step.
        config: weights and shapes; at least one weight is not zero.
        dt: control period, s, by which every weight is multiplied.

    Returns:
        The reward (N,), and each term's weighted share before any clipping, name -> (N,).
    """
    names, weights = _weights(config, dt, state.velocity.dtype, state.velocity.device)
    shares = torch.stack([find_term(name)(state, config) for name in names]).mul_(weights)
    # one after the other: the order of `sum` depends on the number of robots
    reward = reduce(torch.add, shares.unbind())
    if config.clip_at_zero:
        reward = reward.clamp(min=0.0)
    return reward, dict(zip(names, shares.unbind(), strict=True))


@lru_cache(maxsize=16)
def _weights(
    config: RewardConfig, dt: float, dtype: torch.dtype, device: torch.device
) -> tuple[tuple[str, ...], Tensor]:
    """Names of the active terms and their weights times the control period, (terms, 1)."""
    weights = active_terms(config)
    return tuple(weights), torch.tensor([[weight * dt] for weight in weights.values()], dtype=dtype, device=device)
