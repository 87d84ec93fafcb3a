"""Pre-allocated storage of one rollout."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor


class Minibatch(NamedTuple):
    """B transitions: observation group -> (B, dim), and (B, ...) tensors of the same rows."""

    obs: dict[str, Tensor]
    action: Tensor
    mean: Tensor
    log_prob: Tensor
    value: Tensor
    advantage: Tensor
    target: Tensor


class Rollout:
    """T steps of N environments, written in place.

    Args:
        steps: T.
        num_envs: N.
        dims: observation group -> columns.
        num_actions: size of the action.
    """

    def __init__(self, steps: int, num_envs: int, dims: Mapping[str, int], num_actions: int) -> None:
        def empty(*shape: int) -> Tensor:
            return torch.zeros(steps, num_envs, *shape)

        self.steps, self.num_envs = steps, num_envs
        self.obs = {group: empty(size) for group, size in dims.items()}
        self.action, self.mean = empty(num_actions), empty(num_actions)
        self.log_prob, self.reward, self.value, self.next_value = empty(), empty(), empty(), empty()
        self.advantage, self.target = empty(), empty()
        self.done = torch.zeros(steps, num_envs, dtype=torch.bool)
        self.terminated = torch.zeros_like(self.done)

    def minibatches(self, count: int, generator: torch.Generator) -> Iterator[Minibatch]:
        """Shuffle all T N transitions into `count` minibatches; each transition is visited once."""
        total = self.steps * self.num_envs
        order = torch.randperm(total, generator=generator)
        obs = {group: values.view(total, -1) for group, values in self.obs.items()}
        action, mean = self.action.view(total, -1), self.mean.view(total, -1)
        flat = [x.view(total) for x in (self.log_prob, self.value, self.advantage, self.target)]
        for rows in order.tensor_split(count):
            log_prob, value, advantage, target = (x[rows] for x in flat)
            picked = {group: values[rows] for group, values in obs.items()}
            yield Minibatch(picked, action[rows], mean[rows], log_prob, value, advantage, target)
