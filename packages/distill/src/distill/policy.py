"""The student as a policy with a memory, to be rolled out like its teacher."""

from __future__ import annotations

import torch
from torch import Tensor

from distill.history import HistoryBuffer
from distill.interfaces import Observation
from distill.student import Student


class StudentPolicy:
    """Acts for N robots and remembers their histories.

    Call `reset(done)` after every `env.step`, so that a new episode starts with an empty memory.

    Args:
        student: the network.
        num_envs: N.
        device: where observations live.

    Attributes:
        velocity: (N, 3) base velocity estimated by the last `act`, base frame, m/s.
    """

    def __init__(self, student: Student, num_envs: int, device: torch.device | str = "cpu") -> None:
        self._student = student.eval()
        self._history = HistoryBuffer(num_envs, student.config.history, student.proprio, device)
        self.velocity = torch.zeros(num_envs, 3, device=device)

    def reset(self, done: Tensor | None = None) -> None:
        """Forget the histories of the robots in `done` ((N,) bool), or of all."""
        self._history.reset(done)

    @torch.no_grad()
    def act(self, obs: Observation) -> Tensor:
        """Action (N, 12) for the group "proprio" of `obs`; other groups are not read."""
        action, self.velocity, history = self._student(obs["proprio"], self._history.frames)
        self._history.update(history)
        return action
