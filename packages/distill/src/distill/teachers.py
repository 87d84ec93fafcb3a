"""What a student takes over from a teacher that opens its network."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TypeGuard

import torch
from torch import Tensor, nn

from distill.errors import InterfaceError
from distill.interfaces import ACTIONS, Observation, PrivilegedTeacher, ScanTeacher, Teacher


def has_scan(teacher: Teacher) -> TypeGuard[ScanTeacher]:
    """Whether the teacher's actor reads a latent of the terrain."""
    return isinstance(teacher, ScanTeacher) and teacher.scan_latent_dim > 0


def scan_width(teacher: Teacher) -> int:
    """S, width of the latent of the terrain; 0 for a teacher without one."""
    return teacher.scan_latent_dim if has_scan(teacher) else 0


def knowledge(teacher: PrivilegedTeacher, obs: Observation) -> Tensor:
    """What the teacher knows beside its sensors and velocity: latents of terrain and body side by side, (N, S + L)."""
    latent = teacher.latent(obs)
    return torch.cat((teacher.scan_latent(obs), latent), dim=1) if has_scan(teacher) else latent


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
