"""Generalised advantage estimation with a regularised discount (eqs. 6 and 7 of the paper)."""

from __future__ import annotations

import torch
from torch import Tensor


def generalised_advantage(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    done: Tensor,
    terminated: Tensor,
    gamma: float,
    lam: float,
) -> tuple[Tensor, Tensor]:
    """Advantages A_t = sum_l (gamma lam)^l delta_(t+l), delta_t = r_t + gamma V(s_(t+1)) - V(s_t).

    The one `gamma` is gamma_reg everywhere: in the sum, in the TD target, and in the bootstrap of an
    episode that was cut by time, for which V(s_(t+1)) is the value of the state it was cut in.

    Args:
        reward: (T, N).
        value: V(s_t), (T, N).
        next_value: V(s_(t+1)) before any reset, (T, N); ignored where `terminated`.
        done: episode ended after step t, for whatever reason, (T, N) bool.
        terminated: it ended in a state without a future, (T, N) bool.
        gamma: discount gamma_reg.
        lam: lambda of the estimator.

    Returns:
        Advantages and returns (advantage + value, the target of the critic), (T, N) each.
    """
    delta = reward + gamma * next_value * ~terminated - value
    carry = gamma * lam * ~done
    advantage = torch.empty_like(delta)
    running = torch.zeros_like(delta[0])
    for t in range(len(delta) - 1, -1, -1):
        running = delta[t] + carry[t] * running
        advantage[t] = running
    return advantage, advantage + value
