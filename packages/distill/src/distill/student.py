"""The student network: proprioception and its history in, action and base velocity out."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from distill.errors import InterfaceError
from distill.history import push
from distill.interfaces import ACTIONS, VELOCITY, PrivilegedTeacher, Teacher
from distill.networks import HistoryEncoder, mlp


@dataclass(frozen=True)
class StudentConfig:
    """Architecture of the student.

    The temporal encoder follows Kumar et al. (RMA): a linear layer per frame, then convolutions over
    time. Its window is longer than the ten frames of that line of work, since speed and body have
    to be read from it.
    """

    history: int = 20
    """Frames in the history, the newest included (at 50 Hz: 0.4 s)."""
    frame_features: int = 32
    """Width of the linear layer applied to each frame."""
    channels: tuple[int, ...] = (16, 16)
    """Channels of the convolutions over time."""
    encoder_features: int = 128
    """Width of the layer between the convolutions and the two heads."""
    latent_dim: int = 16
    """Width of the latent; a teacher with an encoder of its own overrules it."""
    actor_hidden: tuple[int, ...] = (256, 128, 64)
    """Hidden layers of the backbone; a teacher that opens its actor overrules them."""


class Inference(NamedTuple):
    """What the student makes of a history: action (B, 12), velocity (B, 3) in m/s, latent (B, L)."""

    action: Tensor
    velocity: Tensor
    latent: Tensor


class Student(nn.Module):
    """A policy on onboard sensing.

    A history encoder stands in for the privileged state: one head estimates the base velocity, the
    other the teacher's privileged latent. The backbone reads [proprio, velocity, latent], as the
    teacher's actor does. The velocity is detached there, so that it stays an estimate in m/s.

    Args:
        proprio: P, width of one frame.
        config: architecture.
        actor: backbone (B, P + 3 + L) -> (B, 12); None builds an ELU network of `config.actor_hidden`.
    """

    def __init__(self, proprio: int, config: StudentConfig, actor: nn.Module | None = None) -> None:
        super().__init__()
        if config.history < 1:
            raise ValueError(f"StudentConfig.history is {config.history}; it must be at least 1")
        self.proprio, self.config = proprio, config
        self.encoder = HistoryEncoder(
            proprio, config.history, config.frame_features, config.channels, config.encoder_features
        )
        self.velocity = nn.Linear(config.encoder_features, VELOCITY)
        self.latent = nn.Linear(config.encoder_features, config.latent_dim)
        self.actor = actor or mlp(proprio + VELOCITY + config.latent_dim, config.actor_hidden, ACTIONS)

    def infer(self, history: Tensor) -> Inference:
        """Act on a history (B, H, P) whose last frame is the present one."""
        features = self.encoder(history)
        velocity, latent = self.velocity(features), self.latent(features)
        action = self.actor(torch.cat((history[:, -1], velocity.detach(), latent), dim=1))
        return Inference(action, velocity, latent)

    def forward(self, obs: Tensor, history_in: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """One control step, as exported.

        Args:
            obs: (B, P) the present frame of proprioception.
            history_in: (B, H, P) `history_out` of the step before; zeros at the start of an episode.

        Returns:
            action (B, 12), estimated base linear velocity (B, 3) in the base frame in m/s,
            and history_out (B, H, P).
        """
        history = push(history_in, obs)
        action, velocity, _ = self.infer(history)
        return action, velocity, history


def build_student(proprio: int, teacher: Teacher, config: StudentConfig, device: torch.device | str = "cpu") -> Student:
    """Make a student for a teacher; its backbone starts as a copy of the teacher's actor, if there is one.

    Args:
        proprio: P, width of one frame.
        teacher: the policy to imitate.
        config: architecture.
        device: where the student lives.

    Raises:
        InterfaceError: the teacher's actor does not map [proprio, velocity, latent] to 12 actions.
    """
    if not isinstance(teacher, PrivilegedTeacher):
        return Student(proprio, config).to(device)
    config = replace(config, latent_dim=teacher.latent_dim)
    student = Student(proprio, config, copy_actor(teacher)).to(device)
    check_actor(student.actor, {"proprio": proprio, "velocity": VELOCITY, "latent": config.latent_dim}, device)
    return student


def copy_actor(teacher: PrivilegedTeacher) -> nn.Module:
    """A copy of the teacher's actor to go on training, which leaves the teacher alone."""
    return copy.deepcopy(teacher.actor).requires_grad_(True)


def check_actor(actor: nn.Module, inputs: Mapping[str, int], device: torch.device | str) -> None:
    """Check what the actor of a teacher reads and gives.

    Args:
        actor: the network.
        inputs: name and width of each part of its input, in order.
        device: where it lives.

    Raises:
        InterfaceError: it does not map them, side by side, to 12 actions.
    """
    width = sum(inputs.values())
    try:
        with torch.no_grad():
            shape = tuple(actor(torch.zeros(1, width, device=device)).shape)
    except RuntimeError as error:
        parts = ", ".join(f"{name} {size}" for name, size in inputs.items())
        raise InterfaceError(f"the teacher's actor does not accept [{parts}] = {width} inputs: {error}") from error
    if shape != (1, ACTIONS):
        raise InterfaceError(f"the teacher's actor gives shape {shape}, expected (1, {ACTIONS})")
