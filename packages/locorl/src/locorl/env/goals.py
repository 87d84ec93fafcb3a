"""Waypoints: the course that a parkour robot follows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from locorl.env.kinematics import wrap
from locorl.env.state import Stateful


@dataclass(frozen=True)
class GoalConfig:
    """When a waypoint counts as reached. The last one is a finishing line: past it counts, however far aside."""

    reach: float = 0.2
    """Horizontal distance, m."""
    hold: float = 0.1
    """Seconds within that distance."""


class Waypoints(Stateful):
    """The next waypoint of each robot and the way there.

    Attributes:
        index: number of waypoints that each robot has reached, (N,).
        course: waypoints of each robot, world, (N, k, 3), m.
    """

    _state = ("index", "course", "_near")

    def __init__(self, config: GoalConfig, count: int, dt: float, num_envs: int, device: torch.device) -> None:
        if count < 1:
            raise ValueError("this terrain has no waypoints: choose parkour terrains for a task with goals")
        self.config = config
        self.count = count
        self._hold = max(1, round(config.hold / dt))
        self.index = torch.zeros(num_envs, dtype=torch.long, device=device)
        self.course = torch.zeros(num_envs, count, 3, device=device)
        self._near = torch.zeros(num_envs, dtype=torch.long, device=device)
        self._everyone = torch.arange(num_envs, device=device)

    def assign(self, ids: Tensor, course: Tensor) -> None:
        """Start robots `ids` (m,) on `course` (m, k, 3)."""
        self.course[ids] = course
        self.index[ids] = 0
        self._near[ids] = 0

    def advance(self, position: Tensor) -> None:
        """Count one control step with the bases at `position` (N, 3)."""
        way = self.ahead(0) - position
        near = way[:, :2].square().sum(dim=1) < self.config.reach**2
        near |= (self.index == self.count - 1) & (way[:, 0] < 0.0)  # courses run along x
        self._near = torch.where(near, self._near + 1, torch.zeros_like(self._near))
        reached = (self._near >= self._hold) & (self.index < self.count)
        self.index += reached
        self._near[reached] = 0

    def ahead(self, steps: int = 0) -> Tensor:
        """The waypoint `steps` after the next one, (N, 3); the last one stays."""
        return self._ahead(self._everyone, self.index, steps)

    def _ahead(self, rows: Tensor, index: Tensor, steps: int) -> Tensor:
        return self.course[rows, (index + steps).clamp_(max=self.count - 1)]

    def finished(self) -> Tensor:
        """Robots that have reached every waypoint, (N,) bool."""
        return self.index >= self.count

    def direction(self, position: Tensor) -> Tensor:
        """Unit vector from the base to the next waypoint, horizontal, world, (N, 3).

        Table I prints the vector in space; its vertical part would pay a robot for falling towards a waypoint
        that lies on the ground.
        """
        way = self.ahead() - position
        way[:, 2] = 0.0
        return way / way.norm(dim=1, keepdim=True).clamp(min=1e-6)

    def heading_error(
        self, position: Tensor, yaw: Tensor, steps: int = 0, rows: Tensor | slice = slice(None)
    ) -> Tensor:
        """Bearing of a waypoint ahead of robots `rows` (n,) minus their `yaw` (n,), (n,), rad in (-pi, pi]."""
        way = self._ahead(self._everyone[rows], self.index[rows], steps) - position
        return wrap(torch.atan2(way[:, 1], way[:, 0]) - yaw)
