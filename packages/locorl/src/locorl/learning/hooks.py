"""What may be learnt beside the policy, such as a velocity estimator or a history encoder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from torch import Tensor, nn

from locorl.learning.networks import Obs
from locorl.learning.storage import Minibatch, Rollout


class RolloutHook(Protocol):
    """Something learnt from the same rollouts as the policy.

    In each iteration PPO calls `begin`; `observe` before each step; `end` when the rollout is complete, its
    advantages included and not yet normalised; then `loss` while it improves the policy.

    Attributes:
        name: key of its state in the checkpoint, and prefix of its metrics: `<name>/<metric>`.
    """

    name: str

    def begin(self, iteration: int) -> None:
        """Iteration `iteration`, counted from 0, starts."""
        ...

    def observe(self, obs: Obs) -> Obs:
        """What the actor sees instead of `obs`, group -> (N, dim); `obs` itself must stay as it is.

        It may replace a group, or add `latent`, the same ones at each step of a rollout. The rollout keeps both: the
        actor learns on what it saw, critic and hooks on `obs`.
        """
        ...

    def end(self, rollout: Rollout) -> Mapping[str, float]:
        """The rollout is complete; returns metrics.

        Whatever is trained here with an optimiser of its own must average its gradients itself if several processes
        train together; `parameters` are looked after by PPO.
        """
        ...

    def loss(self, batch: Minibatch) -> Tensor | None:
        """A term () of the loss, a mean over the rows of a minibatch, its mirror image among them."""
        ...

    def parameters(self) -> Iterable[nn.Parameter]:
        """Trained by PPO's optimiser together with the policy."""
        ...

    def state_dict(self) -> dict[str, object]:
        """Tensors and plain data; `parameters` included."""
        ...

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Go back to a saved state."""
        ...
