"""Pre-allocated storage of one rollout, and the minibatches drawn from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

_ROWS = 4096


class Mirror(Protocol):
    """The robots' left-right symmetry; mirroring twice changes nothing."""

    def observation(self, obs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """The mirrored observation, group -> (B, dim)."""
        ...

    def action(self, action: Tensor) -> Tensor:
        """The mirrored action, (B, num_actions)."""
        ...


class Minibatch(NamedTuple):
    """B transitions: observation group -> (B, dim), and (B, ...) tensors of the same rows."""

    obs: dict[str, Tensor]
    action: Tensor
    mean: Tensor
    log_prob: Tensor
    value: Tensor
    advantage: Tensor
    target: Tensor

    def with_mirror_image(self, mirror: Mirror) -> Minibatch:
        """These transitions and after them their mirror images, 2 B rows.

        An image keeps the log-probability of its original. The mirrored action was drawn by the mirror image of the
        old policy, whose density there is the density of the original action where that was taken; so the
        likelihood ratio is the importance weight of the policy that did draw the sample, whether the old policy was
        symmetric or not. Were the old policy asked about the mirrored pair instead, the ratio would start at 1, but
        for a sample that this policy has not drawn, and images of rare actions would count as much as likely ones.
        """
        image = mirror.observation(self.obs)
        return Minibatch(
            {group: torch.cat((values, image[group])) for group, values in self.obs.items()},
            torch.cat((self.action, mirror.action(self.action))),
            torch.cat((self.mean, mirror.action(self.mean))),
            *(column.repeat(2) for column in (self.log_prob, self.value, self.advantage, self.target)),
        )


class Rollout:
    """T steps of N environments, written in place.

    Args:
        steps: T.
        num_envs: N.
        dims: observation group -> columns; of the groups to keep.
        num_actions: size of the action.
        device: where.
    """

    def __init__(
        self,
        steps: int,
        num_envs: int,
        dims: Mapping[str, int],
        num_actions: int,
        device: torch.device | str = "cpu",
    ) -> None:
        def empty(*shape: int) -> Tensor:
            return torch.zeros(steps, num_envs, *shape, device=device)

        self.steps, self.num_envs = steps, num_envs
        self.states = {g: torch.zeros(steps + 1, num_envs, size, device=device) for g, size in dims.items()}
        """Observations s_0 to s_T, group -> (T + 1, N, dim)."""
        self.obs = {group: values[:-1] for group, values in self.states.items()}
        """Those that were acted on, (T, N, dim); the same memory."""
        self.action, self.mean = empty(num_actions), empty(num_actions)
        self.log_prob, self.reward, self.value, self.next_value = empty(), empty(), empty(), empty()
        self.advantage, self.target = empty(), empty()
        self.done = torch.zeros(steps, num_envs, dtype=torch.bool, device=device)
        self.terminated = torch.zeros_like(self.done)

    def observe(self, t: int, obs: Mapping[str, Tensor]) -> None:
        """Keep s_t, group -> (N, dim)."""
        for group, values in self.states.items():
            values[t] = obs[group]

    def shuffle(self, count: int, generator: torch.Generator) -> Sequence[Tensor]:
        """All T N transitions shuffled into `count` minibatches, each once: their rows, (B,) each."""
        order = torch.randperm(self.steps * self.num_envs, generator=generator, device=self.reward.device)
        return order.tensor_split(count)

    def pick(self, rows: Tensor) -> Minibatch:
        """The transitions of these rows (B,)."""
        obs = {group: values.flatten(0, 1).index_select(0, rows) for group, values in self.obs.items()}
        columns = (self.action, self.mean, self.log_prob, self.value, self.advantage, self.target)
        return Minibatch(obs, *(column.flatten(0, 1).index_select(0, rows) for column in columns))


def evaluate_rows(network: Callable[[Mapping[str, Tensor]], Tensor], obs: Mapping[str, Tensor]) -> Tensor:
    """`network` of observations (B, dim), some rows at a time: what lies between the layers stays small."""
    parts = zip(*(values.split(_ROWS) for values in obs.values()), strict=True)
    return torch.cat([network(dict(zip(obs, part, strict=True))) for part in parts])
