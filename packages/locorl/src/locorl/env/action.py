"""What the environment takes as actions."""

from __future__ import annotations

import torch
from torch import Tensor


def check_action(action: Tensor, shape: tuple[int, int], device: torch.device) -> Tensor:
    """The action in single precision on `device`; infinite ones are left to be clipped.

    Raises:
        ValueError: it has another shape than (N, 12), or is not a number for some robot; nothing has changed then.
    """
    action = torch.as_tensor(action, dtype=torch.float32, device=device)
    if action.shape != shape:
        raise ValueError(f"an action is {shape}, a row for each robot; got {tuple(action.shape)}")
    bad = action.isnan()
    if bad.any():
        robots = bad.any(dim=1).nonzero().flatten().tolist()
        some = ", ".join(map(str, robots[:5])) + (", ..." if len(robots) > 5 else "")
        raise ValueError(f"the action is NaN for {len(robots)} of {shape[0]} robots ({some}): has the policy diverged?")
    return action
