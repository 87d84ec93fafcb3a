"""Networks of Fig. 3: encoders of ground and privileged state, actor on latents, critic on the complete state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from locorl.learning.layers import run

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
    scan_encoder: tuple[int, ...] = (128, 64)
    """Hidden layers of the scan encoder; it exists on tasks with a height scan."""
    scan_latent: int = 32
    """Size of the scan latent."""

    @classmethod
    def paper(cls) -> NetworkConfig:
        """The sizes that go with Fig. 3, those of the code that the paper builds on."""
        return cls(actor=(512, 256, 128), critic=(512, 256, 128))


def mlp(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers of the given sizes with ELU between them; the last stays linear."""
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(sizes):
        layers += [nn.Linear(fan_in, fan_out), nn.ELU()]
    return nn.Sequential(*layers[:-1])


class ActorCritic(nn.Module):
    """A Gaussian policy and a value function over the observation groups of `ObsLayout`.

    The actor sees proprioception, the latent of the scan where there is one, the explicit privileged state and the
    latent of the implicit one, side by side in this order. The critic sees all four groups as they are. The history
    is for a student's eyes.

    Args:
        dims: columns of the groups `proprio`, `explicit`, `implicit`, and `scan` where the task has one.
        num_actions: size of the action.
        config: sizes.

    Attributes:
        groups: the observation groups that the networks read.
        latent_dim: size of the privileged latent.
    """

    def __init__(self, dims: Mapping[str, int], num_actions: int, config: NetworkConfig) -> None:
        super().__init__()
        self.groups = ("proprio", "explicit", "implicit", *(("scan",) if "scan" in dims else ()))
        self.latent_dim = config.latent
        self.min_log_std = math.log(config.min_std)
        self.encoder = mlp((dims["implicit"], *config.encoder, config.latent))
        self.scan_encoder = None
        seen = dims["proprio"] + dims["explicit"] + config.latent
        if "scan" in dims:
            encoder = mlp((dims["scan"], *config.scan_encoder, config.scan_latent))
            self.scan_encoder = nn.Sequential(*encoder, nn.Tanh())
            seen += config.scan_latent
        self.actor = mlp((seen, *config.actor, num_actions))
        self.critic = mlp((sum(dims[group] for group in self.groups), *config.critic, 1))
        self.log_std = nn.Parameter(torch.full((num_actions,), math.log(config.initial_std)))
        with torch.no_grad():  # a quiet start: the first mean action is near the stance
            last = self.actor[-1]
            assert isinstance(last, nn.Linear)
            last.weight.mul_(0.1)
            last.bias.zero_()

    def latent(self, obs: Obs) -> Tensor:
        """Latent of the implicit privileged state, (N, latent); that in group `latent`, where a hook shows one."""
        return obs["latent"] if "latent" in obs else run(self.encoder, obs["implicit"])

    def scan_latent(self, obs: Obs) -> Tensor:
        """Latent of the height scan, (N, scan_latent), within +-1.

        Raises:
            ValueError: the policy was made for a task without a scan.
        """
        if self.scan_encoder is None:
            raise ValueError("this policy has no scan encoder: its task observes no height scan")
        return run(self.scan_encoder, obs["scan"])

    def features(self, obs: Obs) -> Tensor:
        """What the actor's last layer sees, (N, last hidden size)."""
        scan = () if self.scan_encoder is None else (self.scan_latent(obs),)
        seen = torch.cat((obs["proprio"], *scan, obs["explicit"], self.latent(obs)), dim=-1)
        known = 0 if obs["proprio"].requires_grad else obs["proprio"].shape[-1]
        return run(list(self.actor)[:-1], seen, known)

    def act(self, obs: Obs) -> Tensor:
        """Mean action, (N, num_actions)."""
        return self.actor[-1](self.features(obs))

    def value(self, obs: Obs) -> Tensor:
        """Value of the state, (N,)."""
        state = torch.cat([obs[group] for group in self.groups], dim=-1)
        return run(self.critic, state).squeeze(-1)

    def std(self) -> Tensor:
        """Standard deviation of the exploration noise, (num_actions,)."""
        return self.log_std.clamp(min=self.min_log_std).exp()

    def log_prob(self, mean: Tensor, action: Tensor) -> Tensor:
        """Log-density of `action` under the Gaussian around `mean`, (N,)."""
        std = self.std()
        constant = std.log().sum() + 0.5 * len(std) * math.log(2.0 * math.pi)
        return -0.5 * ((action - mean) / std).square().sum(dim=-1) - constant

    def entropy(self) -> Tensor:
        """Entropy of the Gaussian, ()."""
        return (self.std().log() + 0.5 * math.log(2.0 * math.pi * math.e)).sum()
