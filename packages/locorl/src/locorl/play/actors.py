"""What moves the robots: standing, noise, or a trained policy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from locorl.env.legged_env import LeggedEnv
from locorl.evaluation.evaluate import Actor
from locorl.learning.policy import Policy, load_policy


class Stand:
    """Holds the stance: no action at all."""

    def reset(self, done: Tensor | None = None) -> None:
        """Nothing to forget."""

    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        """Zeros, (N, 12)."""
        proprio = obs["proprio"]
        return proprio.new_zeros(len(proprio), LeggedEnv.num_actions)


class RandomActor:
    """Gaussian noise, the same at every start with the same seed.

    Args:
        amplitude: standard deviation of each action.
        correlation: of an action with the one before it: 0 gives white noise, values near 1 smooth motion.
        seed: of the noise.
    """

    def __init__(self, amplitude: float = 1.5, correlation: float = 0.9, seed: int = 0) -> None:
        if amplitude < 0.0 or not 0.0 <= correlation < 1.0:
            raise ValueError(f"noise needs amplitude >= 0 and 0 <= correlation < 1, got {amplitude} and {correlation}")
        self.amplitude = amplitude
        self.correlation = correlation
        self.seed = seed
        self.reset()

    def reset(self, done: Tensor | None = None) -> None:
        """Start anew; robots where `done` (N,) only go back to rest."""
        if done is None:
            self._generator = torch.Generator().manual_seed(self.seed)
            self._action: Tensor | None = None
        elif self._action is not None:
            self._action[done] = 0.0

    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        """The next noise, (N, 12)."""
        proprio = obs["proprio"]
        noise = torch.randn(len(proprio), LeggedEnv.num_actions, generator=self._generator).to(proprio)
        noise *= self.amplitude
        if self._action is None:
            self._action = noise
        else:  # the weights keep the variance
            self._action = self.correlation * self._action + math.sqrt(1.0 - self.correlation**2) * noise
        return self._action.clone()


def make_actor(policy: str, seed: int = 0) -> Actor:
    """The actor that `--policy` names.

    Args:
        policy: `stand`, `random`, or the path of a policy or a training checkpoint.
        seed: of the noise of `random`.

    Raises:
        ValueError: neither of these.
        CheckpointError: the file cannot be read.
    """
    if policy == "stand":
        return Stand()
    if policy == "random":
        return RandomActor(seed=seed)
    if not Path(policy).is_file():
        raise ValueError(f"no policy '{policy}': give stand, random, or the path of a policy.pt or checkpoint.pt")
    return load_policy(Path(policy))


def check_fits(actor: Actor, env: LeggedEnv) -> None:
    """Refuse a policy whose robot, rules, gains, observations or actions are not those of `env`.

    Raises:
        ValueError: naming both.
    """
    if not isinstance(actor, Policy):
        return
    card = actor.card
    actor.check_bodies(env.factory)
    if dict(card.dims) != dict(env.group_dims):
        raise ValueError(
            f"this policy observes {dict(card.dims)}, as in task '{card.task.name}'; task '{env.task.name}' gives "
            f"{dict(env.group_dims)}: play it on its own task and preset, or train one for this"
        )
    known = (card.task.action_scale, card.task.physics.control_dt)
    if known != (env.task.action_scale, env.dt):
        raise ValueError(
            f"this policy acts with scale {known[0]:g} every {known[1]:g} s; task '{env.task.name}' takes scale "
            f"{env.task.action_scale:g} every {env.dt:g} s: choose the preset that it was trained with"
        )
