"""Statistics of a rollout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from locorl.learning.storage import Rollout

if TYPE_CHECKING:
    from locorl.env.step_info import StepInfo


class RolloutStats:
    """What the environment tells beside the rollout, kept as tensors until the end."""

    def __init__(self) -> None:
        self._rows: list[Tensor] = []
        self._names: tuple[str, ...] = ()

    def add(self, info: StepInfo) -> None:
        """Take in one step."""
        self._names = tuple(info.reward_terms)
        robots = (info.tracking_error, info.diverged.float(), info.success.float(), info.level.float())
        self._rows.append(torch.stack((*(each.mean() for each in robots), *info.reward_terms.values())))

    def summary(self, rollout: Rollout, dt: float) -> dict[str, float]:
        """Means over the rollout; `reward`, its terms, `fall_rate` and `success_rate` are per second."""
        reward = torch.stack((rollout.reward.mean(), rollout.terminated.float().mean())) / dt
        reward, fall_rate = reward.tolist()
        error, diverged, success, level, *terms = torch.stack(self._rows).mean(dim=0).tolist()
        return {
            "reward": reward,
            "fall_rate": fall_rate,
            "tracking_error": error,
            "diverged": diverged,
            "success_rate": success / dt,
            "terrain_level": level,
            **{f"term/{name}": value / dt for name, value in zip(self._names, terms, strict=True)},
        }
