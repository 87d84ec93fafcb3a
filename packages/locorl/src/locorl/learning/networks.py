"""Networks of Fig. 3: privileged encoder, actor on latents, critic on the complete state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

Obs = Mapping[str, Tensor]


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the networks; the defaults suit a CPU."""

    actor: tuple[int, ...] = (256, 128, 64)
    """Hidden layers of the actor."""
    critic: tuple[int, ...] = (256, 128, 64)
    """Hidden layers of the critic."""
    encoder: tuple[int, ...] = (64,)
    """Hidden layers of the privileged encoder."""
    latent: int = 20
    """Size of the privileged latent."""
    initial_std: float = 1.0
    """Standard deviation of the exploration noise before training, in units of action."""
    min_std: float = 0.05
    """The noise never falls below this, which keeps the likelihood ratio sane."""


def mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers of the given sizes with ELU between them; the last stays linear."""
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(sizes):
        layers += [nn.Linear(fan_in, fan_out), nn.ELU()]
    return nn.Sequential(*layers[:-1])


class ActorCritic(nn.Module):
    """A Gaussian policy and a value function over the observation groups of `ObsLayout`.

    The actor sees proprioception, the explicit privileged state and the latent of the implicit one; the
    critic sees everything as it is.

    Args:
        dims: columns of the groups `proprio`, `explicit` and `implicit`.
        num_actions: size of the action.
        config: sizes.
    """

    def __init__(self, dims: Mapping[str, int], num_actions: int, config: NetworkConfig) -> None:
        super().__init__()
        proprio, explicit, implicit = dims["proprio"], dims["explicit"], dims["implicit"]
        self.latent_dim = config.latent
        self.min_log_std = math.log(config.min_std)
        self.encoder = mlp((implicit, *config.encoder, config.latent))
        self.actor = mlp((proprio + explicit + config.latent, *config.actor, num_actions))
        self.critic = mlp((proprio + explicit + implicit, *config.critic, 1))
        self.log_std = nn.Parameter(torch.full((num_actions,), math.log(config.initial_std)))
        with torch.no_grad():  # a quiet start: the first mean action is near the stance
            last = self.actor[-1]
            assert isinstance(last, nn.Linear)
            last.weight.mul_(0.1)
            last.bias.zero_()

    def latent(self, obs: Obs) -> Tensor:
        """Latent of the implicit privileged state, (N, latent)."""
        return self.encoder(obs["implicit"])

    def act(self, obs: Obs) -> Tensor:
        """Mean action, (N, num_actions)."""
        return self.actor(torch.cat((obs["proprio"], obs["explicit"], self.latent(obs)), dim=-1))

    def value(self, obs: Obs) -> Tensor:
        """Value of the state, (N,)."""
        return self.critic(torch.cat((obs["proprio"], obs["explicit"], obs["implicit"]), dim=-1)).squeeze(-1)

    def std(self) -> Tensor:
        """Standard deviation of the exploration noise, (num_actions,)."""
        return self.log_std.clamp(min=self.min_log_std).exp()

    def log_prob(self, mean: Tensor, action: Tensor) -> Tensor:
        """Log-density of `action` under the Gaussian around `mean`, (N,)."""
        std = self.std()
        normal = ((action - mean) / std).square() + 2.0 * std.log() + math.log(2.0 * math.pi)
        return -0.5 * normal.sum(dim=-1)

    def entropy(self) -> Tensor:
        """Entropy of the Gaussian, ()."""
        return (self.std().log() + 0.5 * math.log(2.0 * math.pi * math.e)).sum()
