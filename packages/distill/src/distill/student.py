"""The student network: proprioception and its history in, action and base velocity out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from distill import checkpoint
from distill.history import push
from distill.interfaces import ACTIONS, VELOCITY, PrivilegedTeacher, Teacher
from distill.networks import HistoryEncoder, mlp
from distill.teachers import check_actor, copy_actor, scan_width


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
    scan_dim: int = 0
    """Width of the latent of the terrain; a teacher that sees it overrules it."""
    latent_dim: int = 16
    """Width of the latent of the body; a teacher with an encoder of its own overrules it."""
    actor_hidden: tuple[int, ...] = (256, 128, 64)
    """Hidden layers of the backbone; a teacher that opens its actor overrules them."""


class Inference(NamedTuple):
    """What the student makes of a history: action (B, 12), velocity (B, 3) in m/s, latents (B, S + L)."""

    action: Tensor
    velocity: Tensor
    latent: Tensor


class Student(nn.Module):
    """A policy on onboard sensing.

    A history encoder stands in for the privileged state: one head estimates the base velocity, the
    other the teacher's privileged latents, of the body and, if the teacher sees it, of the terrain, as far
    as legs can feel it. The backbone reads [proprio, terrain latent, velocity, latent], as the teacher's
    actor does. The velocity is detached there, so that it stays an estimate in m/s.

    Args:
        proprio: P, width of one frame.
        config: architecture.
        actor: backbone (B, P + S + 3 + L) -> (B, 12); None builds an ELU network of `config.actor_hidden`.
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
        self.latent = nn.Linear(config.encoder_features, config.scan_dim + config.latent_dim)
        width = proprio + config.scan_dim + VELOCITY + config.latent_dim
        self.actor = actor or mlp(width, config.actor_hidden, ACTIONS)

    def infer(self, history: Tensor) -> Inference:
        """Act on a history (B, H, P) whose last frame is the present one."""
        features = self.encoder(history)
        velocity, latent = self.velocity(features), self.latent(features)
        terrain, body = latent.tensor_split((self.config.scan_dim,), dim=1)
        parts = (history[:, -1], *((terrain,) if self.config.scan_dim else ()), velocity.detach(), body)
        action = self.actor(torch.cat(parts, dim=1))
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
        InterfaceError: the teacher's actor does not map what it should read to 12 actions.
    """
    if not isinstance(teacher, PrivilegedTeacher):
        return Student(proprio, config).to(device)
    scan = scan_width(teacher)
    config = replace(config, scan_dim=scan, latent_dim=teacher.latent_dim)
    student = Student(proprio, config, copy_actor(teacher)).to(device)
    inputs = {"proprio": proprio, "scan latent": scan, "velocity": VELOCITY, "latent": config.latent_dim}
    check_actor(student.actor, {name: width for name, width in inputs.items() if width}, device)
    return student


def blind_payload(student: Student) -> dict[str, object]:
    """Weights, architecture and shape of a blind student."""
    made_with = {"proprio": student.proprio, "architecture": asdict(student.config)}
    return checkpoint.student_payload("blind", student, made_with)


def load_student(path: Path, teacher: Teacher, device: torch.device | str = "cpu") -> Student:
    """Rebuild a trained student from `student.pt` or `checkpoint.pt`.

    Args:
        path: the file.
        teacher: the teacher that it was trained with; it gives the shape of the backbone.
        device: where the student shall live.

    Raises:
        CheckpointError: the file is unreadable, or the student sees or belongs to another teacher.
    """

    def make(table: Mapping[str, Any]) -> Student:
        return build_student(table["proprio"], teacher, StudentConfig(**table["architecture"]))

    return checkpoint.rebuild_student(path, "blind", make, device)
