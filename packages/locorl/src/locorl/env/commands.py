"""Velocity commands."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from locorl.env.kinematics import wrap
from locorl.env.state import Stateful


@dataclass(frozen=True)
class CommandConfig:
    """Velocity commands, drawn uniformly and held for `hold` seconds."""

    vx: tuple[float, float] = (-0.6, 1.0)
    """Forward velocity, m/s."""
    vy: tuple[float, float] = (-0.3, 0.3)
    """Sideways velocity, m/s."""
    yaw_rate: tuple[float, float] = (-0.5, 0.5)
    """Yaw rate, rad/s; with a heading to keep or waypoints to reach, the bounds of what steers there."""
    hold: float = 10.0
    """Seconds between two draws."""
    standing: float = 0.02
    """Share of draws that command a standstill."""
    heading: bool = False
    """Whether a heading is drawn instead of a yaw rate, which then steers there."""
    heading_gain: float = 0.5
    """Commanded yaw rate per heading error, 1/s, where a heading or a waypoint gives it."""


class VelocityCommands(Stateful):
    """What each robot is asked to do.

    Attributes:
        command: vx, vy (m/s) and yaw rate (rad/s) in the base frame, (N, 3).
        heading: heading to keep, rad, (N,); used with `CommandConfig.heading`.
    """

    _state = ("command", "heading", "_age")

    def __init__(self, config: CommandConfig, dt: float, num_envs: int, generator: torch.Generator) -> None:
        self.config = config
        self.generator = generator
        device = generator.device
        self._hold = round(config.hold / dt)
        self._bounds = torch.tensor((config.vx, config.vy, config.yaw_rate), device=device)
        self.command = torch.zeros(num_envs, 3, device=device)
        self.heading = torch.zeros(num_envs, device=device)
        self._age = torch.zeros(num_envs, dtype=torch.long, device=device)

    def draw(self, ids: Tensor) -> None:
        """New commands for robots `ids`."""
        draw = torch.rand(len(ids), 4, generator=self.generator, device=self.generator.device)
        command = self._bounds[:, 0] + (self._bounds[:, 1] - self._bounds[:, 0]) * draw[:, :3]
        self.command[ids] = command * (draw[:, 3:] >= self.config.standing)
        if self.config.heading:
            angle = torch.rand(len(ids), generator=self.generator, device=self.generator.device)
            self.heading[ids] = torch.pi * (2.0 * angle - 1.0)
        self._age[ids] = 0

    def renew(self) -> None:
        """Count one control step; commands that were held long enough are drawn anew."""
        self._age += 1
        ids = (self._age >= self._hold).nonzero().flatten()
        if len(ids):
            self.draw(ids)

    def heading_error(self, yaw: Tensor) -> Tensor:
        """Heading to keep minus `yaw` (N,), (N,), rad in (-pi, pi]."""
        return wrap(self.heading - yaw)

    def steer(self, heading_error: Tensor) -> None:
        """Command the yaw rates that reduce `heading_error` (N,), rad; a robot told to stand stays."""
        rate = (self.config.heading_gain * heading_error).clamp(float(self._bounds[2, 0]), float(self._bounds[2, 1]))
        moving = self.command[:, :2].abs().sum(dim=1) > 0.0
        self.command[:, 2] = rate * moving
