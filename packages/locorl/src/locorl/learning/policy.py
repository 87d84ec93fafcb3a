"""Trained policies: loading, acting, and the refusal of bodies that they were not trained for."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from locorl import checkpoint
from locorl.bodies.family import BodyFamily
from locorl.config import from_dict, to_dict
from locorl.interfaces import BodyFactory, DesignSpace
from locorl.learning.networks import ActorCritic, NetworkConfig
from locorl.tasks.task import TaskConfig

CARD_FORMAT = 4
"""Format of the cards that this version writes; it reads format 1 too, which named reward terms otherwise, format 2,
which lacks some, and format 3, which does not tell the family of bodies."""

_TERMS_RENAMED = {
    "linear_velocity": "linear_velocity_tracking",
    "angular_velocity": "angular_velocity_tracking",
    "vertical_velocity": "linear_velocity_penalty",
    "roll_pitch_rate": "angular_velocity_penalty",
    "hip_position": "hip_position_penalty",
    "joint_position": "joint_position_penalty",
    "torque": "torque_penalty",
    "air_time": "feet_air_time",
}
_TERMS_SINCE_FORMAT_3 = ("progress", "low_swing", "fall")


@dataclass(frozen=True)
class PolicyCard:
    """What a policy was trained for.

    Attributes:
        robot: name of the robot.
        design_names: design parameters that it observes, in order.
        design_low: their lower bounds in training.
        design_high: their upper bounds.
        dims: columns of the observation groups.
        task: the task.
        network: sizes.
        samples: environment steps that it was trained on.
        seed: seed of the training.
        family: rules and gains of its bodies; None where the file does not tell.
    """

    robot: str
    design_names: tuple[str, ...]
    design_low: tuple[float, ...]
    design_high: tuple[float, ...]
    dims: Mapping[str, int]
    task: TaskConfig
    network: NetworkConfig
    samples: int
    seed: int
    family: BodyFamily | None = None


class Policy:
    """A deterministic policy: acts with the mean action.

    Satisfies what distillation asks of a teacher: `act`, `latent`, `actor`, `latent_dim`, and on tasks with a height
    scan `scan_latent` and `scan_latent_dim`.

    It acts where the observations are: at the first that lie on another device than its networks it takes a copy of
    these there, so that networks in training stay where they are.

    Args:
        model: the networks.
        card: what they were trained for.
    """

    def __init__(self, model: ActorCritic, card: PolicyCard) -> None:
        self.model = model.eval()
        self.card = card

    @property
    def actor(self) -> nn.Module:
        """Maps [proprio, scan latent on tasks with a scan, explicit, latent] to the mean action."""
        return self.model.actor

    @property
    def latent_dim(self) -> int:
        """Size of the privileged latent."""
        return self.model.latent_dim

    @property
    def scan_latent_dim(self) -> int:
        """Size of the scan latent; 0 on tasks without a scan."""
        return 0 if self.model.scan_encoder is None else self.card.network.scan_latent

    def reset(self, done: Tensor | None = None) -> None:
        """Nothing to forget: the policy has no memory."""

    @torch.no_grad()
    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        """Mean action, (N, 12)."""
        return self._near(obs).act(obs)

    @torch.no_grad()
    def latent(self, obs: Mapping[str, Tensor]) -> Tensor:
        """Privileged latent, (N, latent_dim)."""
        return self._near(obs).latent(obs)

    @torch.no_grad()
    def scan_latent(self, obs: Mapping[str, Tensor]) -> Tensor:
        """Latent of the height scan, (N, scan_latent_dim), within +-1.

        Raises:
            ValueError: the task has no scan.
        """
        return self._near(obs).scan_latent(obs)

    def _near(self, obs: Mapping[str, Tensor]) -> ActorCritic:
        device = next(iter(obs.values())).device
        if self.model.log_std.device != device:
            self.model = copy.deepcopy(self.model).to(device)
        return self.model

    @property
    def signature(self) -> dict[str, object]:
        """What it must have in common with the robots that it controls: name -> value."""
        card = self.card
        family = {} if card.family is None else card.family.signature
        return {"robot": card.robot, "design": card.design_names, **family, **card.task.interface}

    def check_space(self, robot: str, space: DesignSpace) -> None:
        """Refuse a robot or a design space that the policy was not trained on.

        Raises:
            ValueError: naming both.
        """
        if (robot, tuple(space.names)) != (self.card.robot, self.card.design_names):
            raise ValueError(
                f"this policy was trained on '{self.card.robot}' with design parameters {self.card.design_names}; "
                f"it cannot control '{robot}' with {tuple(space.names)}: train one for it"
            )

    def check_bodies(
        self,
        factory: BodyFactory,
        way_out: str = "make its bodies as then, or take the policy on as it is (--adopt, Policy.adopted)",
    ) -> None:
        """Refuse what `check_space` does, and bodies that follow from other rules or have other gains.

        What a policy of an earlier format does not tell is not checked.

        Args:
            factory: makes the bodies.
            way_out: what to do about another family, in the words of the caller.

        Raises:
            ValueError: naming both.
        """
        self.check_space(factory.name, factory.space)
        if self.card.family is None:
            return
        changes = self.card.family.differences(BodyFamily.of(factory))
        if changes:
            raise ValueError(
                f"this policy was trained on other bodies of '{factory.name}' than these "
                f"({'; '.join(changes)}): {way_out}"
            )

    def adopted(self, factory: BodyFactory) -> Policy:
        """The same policy for bodies of another family: their rules and gains are taken as those of its training."""
        return Policy(self.model, replace(self.card, family=BodyFamily.of(factory)))

    def content(self) -> dict[str, Any]:
        """The policy as checkpoint content."""
        return {
            "kind": "policy",
            "card_format": CARD_FORMAT,
            "card": to_dict(self.card),
            "model": self.model.state_dict(),
        }

    def save(self, path: Path) -> None:
        """Write the policy alone, without what resuming its training would need."""
        checkpoint.save(path, self.content())


def load_policy(path: Path) -> Policy:
    """Read a policy or a training checkpoint.

    Raises:
        checkpoint.CheckpointError: unreadable, or not a policy of locorl.
    """
    return policy_from(checkpoint.load(path), path)


def policy_from(content: Mapping[str, Any], path: Path) -> Policy:
    """The policy within checkpoint content read from `path`."""
    try:
        card = from_dict(PolicyCard, _current_card(content))
        model = ActorCritic(card.dims, 12, card.network)
        model.load_state_dict(content["model"])
    except (KeyError, ValueError, TypeError, RuntimeError) as error:
        raise checkpoint.CheckpointError(f"{path} holds no policy that this version can read: {error}") from error
    return Policy(model, card)


def _current_card(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """The card in the present format."""
    card, card_format = content["card"], content.get("card_format", 1)
    if card_format > CARD_FORMAT:
        raise ValueError(f"its card has format {card_format}, this version reads up to {CARD_FORMAT}; update locorl")
    if card_format >= 3:  # since then it only tells more
        return card
    reward = dict(card["task"]["reward"])
    if card_format == 1:
        reward = {_TERMS_RENAMED.get(name, name): value for name, value in reward.items()}
    reward = {**dict.fromkeys(_TERMS_SINCE_FORMAT_3, 0.0), **reward}
    return {**card, "task": {**card["task"], "reward": reward}}
