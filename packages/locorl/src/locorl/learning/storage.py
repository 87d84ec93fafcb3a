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
    seen: tuple[dict[str, Tensor], ...]
    """What the actor saw of them, some rows after the other: `obs` itself, unless hooks showed it something else."""
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

        What hooks showed in place of an observation is mirrored too; a latent is not, it has no known symmetry.
        """
        image = mirror.observation(self.obs)
        obs = {group: torch.cat((values, image[group])) for group, values in self.obs.items()}
        (seen,) = self.seen
        shown = seen is not self.obs
        return Minibatch(
            obs,
            (seen, dict(mirror.observation({group: seen[group] for group in self.obs}))) if shown else (obs,),
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
        self.shown: dict[str, Tensor] = {}
        """What the actor saw in place of an observation group or of the latent, group -> (T, N, dim)."""
        self.action, self.mean = empty(num_actions), empty(num_actions)
        self.log_prob, self.reward, self.value, self.next_value = empty(), empty(), empty(), empty()
        self.advantage, self.target = empty(), empty()
        self.done = torch.zeros(steps, num_envs, dtype=torch.bool, device=device)
        self.terminated = torch.zeros_like(self.done)

    def observe(self, t: int, obs: Mapping[str, Tensor]) -> None:
        """Keep s_t, group -> (N, dim)."""
        for group, values in self.states.items():
            values[t] = obs[group]

    def show(self, t: int, obs: Mapping[str, Tensor], seen: Mapping[str, Tensor]) -> None:
        """Keep where `seen`, what the actor saw at step t, is not `obs`; group -> (N, dim).

        Raises:
            ValueError: other groups differ than at step 0.
        """
        changed = {group: values for group, values in seen.items() if values is not obs.get(group)}
        if t == 0:
            self.shown = {g: values.new_zeros(self.steps, *values.shape) for g, values in changed.items()}
        if changed.keys() != self.shown.keys():
            raise ValueError(f"hooks showed {sorted(self.shown)} at step 0 of a rollout, {sorted(changed)} at step {t}")
        for group, values in changed.items():
            self.shown[group][t] = values

    def shuffle(self, count: int, generator: torch.Generator) -> Sequence[Tensor]:
        """All T N transitions shuffled into `count` minibatches, each once: their rows, (B,) each."""
        order = torch.randperm(self.steps * self.num_envs, generator=generator, device=self.reward.device)
        return order.tensor_split(count)

    def pick(self, rows: Tensor) -> Minibatch:
        """The transitions of these rows (B,)."""

        def of(values: Tensor) -> Tensor:
            return values.flatten(0, 1).index_select(0, rows)

        obs = {group: of(values) for group, values in self.obs.items()}
        seen = {**obs, **{group: of(values) for group, values in self.shown.items()}} if self.shown else obs
        columns = (self.action, self.mean, self.log_prob, self.value, self.advantage, self.target)
        return Minibatch(obs, (seen,), *map(of, columns))


def evaluate_rows(network: Callable[[Mapping[str, Tensor]], Tensor], obs: Mapping[str, Tensor]) -> Tensor:
    """`network` of observations (B, dim), some rows at a time: what lies between the layers stays small."""
    parts = zip(*(values.split(_ROWS) for values in obs.values()), strict=True)
    return torch.cat([network(dict(zip(obs, part, strict=True))) for part in parts])
