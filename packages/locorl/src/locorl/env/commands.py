"""Velocity commands."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from locorl.env.state import Stateful, check_ranges, uniform


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
    heading: tuple[float, float] | None = None
    """Headings to keep, rad, drawn instead of yaw rates, which then steer there; None for plain yaw rates."""
    heading_gain: float = 0.5
    """Commanded yaw rate per heading error, 1/s, where a heading or a waypoint gives it."""

    def __post_init__(self) -> None:
        """Refuse ranges that run backwards and commands that are never held."""
        check_ranges(self, "vx", "vy", "yaw_rate", "heading")
        if self.hold <= 0.0 or not 0.0 <= self.standing <= 1.0:
            raise ValueError(f"CommandConfig: need hold > 0 s and a share standing of 0 to 1, got {self}")


class VelocityCommands(Stateful):
    """What each robot is asked to do.

    Attributes:
        command: vx, vy (m/s) and yaw rate (rad/s) in the base frame, (N, 3).
        heading: heading to keep, rad, (N,); used if `CommandConfig.heading` draws it.
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
        if self.config.heading is not None:
            self.heading[ids] = uniform(self.config.heading, len(ids), self.generator)
        self._age[ids] = 0

    def renew(self) -> None:
        """Count one control step; commands that were held long enough are drawn anew."""
        self._age += 1
        ids = (self._age >= self._hold).nonzero().flatten()
        if len(ids):
            self.draw(ids)

    def steer(self, heading_error: Tensor, rows: Tensor | slice = slice(None)) -> None:
        """Command robots `rows` the yaw rates that reduce `heading_error` (n,), rad; one told to stand stays."""
        rate = (self.config.heading_gain * heading_error).clamp(*self.config.yaw_rate)
        moving = self.command[rows, :2].abs().sum(dim=1) > 0.0
        self.command[rows, 2] = rate * moving
