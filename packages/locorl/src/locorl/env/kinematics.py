"""Rotations of a batch of bases; quaternions are (w, x, y, z)."""

from __future__ import annotations

import torch
from torch import Tensor


def to_base_frame(quat: Tensor, vector: Tensor) -> Tensor:
    """Express world vectors in the frames that `quat` describes.

    Args:
        quat: unit quaternions base -> world, (N, 4).
        vector: world vectors, (N, 3).

    Returns:
        R(quat)^T vector, (N, 3).
    """
    w, u = quat[:, :1], quat[:, 1:]
    cross = torch.linalg.cross(vector, u)
    # R^T v = v - 2w (u x v) + 2 u x (u x v), written with v x u
    return vector + 2.0 * (w * cross + torch.linalg.cross(u, -cross))


def rotation(quat: Tensor) -> Tensor:
    """Matrices of unit quaternions (n, 4), (n, 3, 3)."""
    w, x, y, z = quat.unbind(dim=1)
    return torch.stack(
        (
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ),
        dim=1,
    ).view(-1, 3, 3)


def projected_gravity(quat: Tensor) -> Tensor:
    """The unit vector pointing down, seen from the base: R(quat)^T (0, 0, -1), (N, 3)."""
    w, x, y, z = quat.unbind(dim=1)
    return torch.stack((2.0 * (w * y - x * z), -2.0 * (w * x + y * z), 2.0 * (x * x + y * y) - 1.0), dim=1)


def yaw_quat(yaw: Tensor) -> Tensor:
    """Quaternions of rotations by `yaw` (N,) about the vertical, (N, 4)."""
    zero = torch.zeros_like(yaw)
    return torch.stack((torch.cos(yaw / 2), zero, zero, torch.sin(yaw / 2)), dim=1)


def yaw_of(quat: Tensor) -> Tensor:
    """Heading of the base's x axis, (N,), rad."""
    w, x, y, z = quat.unbind(dim=1)
    return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def roll_pitch(gravity: Tensor) -> Tensor:
    """Roll and pitch of the base from projected gravity (N, 3), (N, 2), rad."""
    x, y, z = gravity.unbind(dim=1)
    return torch.stack((torch.atan2(-y, -z), torch.asin(x.clamp(-1.0, 1.0))), dim=1)


def wrap(angle: Tensor) -> Tensor:
    """The same angle in (-pi, pi], rad."""
    return torch.atan2(torch.sin(angle), torch.cos(angle))
