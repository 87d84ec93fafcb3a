"""The student's memory: the last H frames of proprioception, oldest first, zeros before an episode."""

from __future__ import annotations

import torch
from torch import Tensor


def push(history: Tensor, obs: Tensor) -> Tensor:
    """Drop the oldest frame and append the newest.

    Args:
        history: (B, H, P), oldest first.
        obs: (B, P).

    Returns:
        (B, H, P) whose last frame is `obs`.
    """
    return torch.cat((history[:, 1:], obs.unsqueeze(1)), dim=1)


def begin(history: Tensor, obs: Tensor) -> Tensor:
    """Fill histories that are empty, as they are when an episode starts, with the present frame.

    A history is empty if its newest frame is all zeros, which no frame of a robot is: the direction of gravity is
    part of it. The rule lies in the network, so that every runtime starts from zeros.

    Args:
        history: (B, H, P), oldest first.
        obs: (B, P).
    """
    empty = (history[:, -1:] == 0.0).all(dim=2, keepdim=True)
    return torch.where(empty, obs.unsqueeze(1), history)


class HistoryBuffer:
    """The history of N robots, forgotten where an episode ends.

    The network itself pushes the newest frame (`Student.forward`); the buffer keeps what it returns.

    Attributes:
        frames: (N, H, P), oldest first.
    """

    def __init__(self, num_envs: int, history: int, proprio: int, device: torch.device | str = "cpu") -> None:
        self.frames = torch.zeros(num_envs, history, proprio, device=device)

    def update(self, frames: Tensor) -> None:
        """Keep `frames` (N, H, P), the `history_out` of the network."""
        self.frames = frames

    def reset(self, done: Tensor | None = None) -> None:
        """Forget the history of the robots in `done` ((N,) bool), or of all."""
        if done is None:
            self.frames = torch.zeros_like(self.frames)
        else:
            self.frames = self.frames.masked_fill(done[:, None, None], 0.0)
