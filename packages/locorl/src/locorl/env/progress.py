"""How far each robot has come, how far it should have, and how well it keeps its speed."""

from __future__ import annotations

import torch
from torch import Tensor

from locorl.env.guidance import Guidance
from locorl.env.state import Motion, Stateful


class Progress(Stateful):
    """Sums over an episode, and over the time that a robot has had its body.

    Attributes:
        way: along the commanded way in this episode, (N,), m.
        asked: commanded in this episode until now, (N,), m.
    """

    _state = ("way", "asked", "_error", "_steps")

    def __init__(self, guidance: Guidance, dt: float, num_envs: int, device: torch.device) -> None:
        self._guidance, self._dt = guidance, dt
        self.way, self.asked, self._error = (torch.zeros(num_envs, device=device) for _ in range(3))
        self._steps = torch.zeros((), dtype=torch.long)

    def add(self, now: Motion, direction: Tensor, diverged: Tensor) -> tuple[Tensor, Tensor]:
        """Take in one control step; speed and tracking error of each robot, (N,) each, m/s.

        A simulation that failed has come nowhere: what it did before it failed proves nothing.
        """
        command = self._guidance.commands.command
        speed = self._guidance.speed(now, direction)
        error = (speed - command[:, 0]).abs()
        self.way += self._guidance.progress(now, speed) * self._dt
        self.way.masked_fill_(diverged, 0.0)
        self.asked += torch.linalg.vector_norm(command[:, :2], dim=1) * self._dt
        self._error += torch.where(diverged, torch.zeros_like(error), error)
        self._steps += 1
        return speed, error

    def whole_way(self, steps_left: Tensor) -> Tensor:
        """Commanded in the whole episode if the present command holds for `steps_left` (N,) more steps, (N,), m."""
        speed = torch.linalg.vector_norm(self._guidance.commands.command[:, :2], dim=1)
        return self.asked + speed * self._dt * steps_left

    def score(self) -> Tensor:
        """Mean tracking error of each robot since its body last changed, (N,), m/s."""
        return self._error / max(1, int(self._steps))

    def reset(self, ids: Tensor) -> None:
        """Robots `ids` start an episode."""
        self.way[ids] = 0.0
        self.asked[ids] = 0.0

    def change_bodies(self) -> None:
        """Start the scores anew."""
        self._error.zero_()
        self._steps.zero_()
