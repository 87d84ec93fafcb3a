"""Where each robot is to go: a commanded velocity, a heading to keep, or the next waypoint of a course."""

from __future__ import annotations

import torch
from torch import Tensor

from locorl.env.commands import VelocityCommands
from locorl.env.goals import Waypoints
from locorl.env.kinematics import wrap
from locorl.env.state import Motion

EVERYONE = slice(None)


class Guidance:
    """Commands, and waypoints where the task has them.

    Args:
        commands: velocity commands; on a course, their first column is the speed to keep.
        goals: waypoints, or None.
    """

    def __init__(self, commands: VelocityCommands, goals: Waypoints | None) -> None:
        self.commands = commands
        self.goals = goals
        self._steers = goals is not None or commands.config.heading is not None
        num_envs, device = commands.command.shape[0], commands.command.device
        self._nowhere = torch.zeros(1, 1, device=device)
        self._nobody = torch.zeros(num_envs, dtype=torch.bool, device=device)

    def speed(self, now: Motion, direction: Tensor) -> Tensor:
        """Speed forward, or along what `direction` gave, (N,), m/s; the first column of the command asks for it."""
        if self.goals is None:
            return now.velocity[:, 0]
        return (now.velocity_world * direction).sum(dim=1)

    def progress(self, now: Motion, speed: Tensor) -> Tensor:
        """Speed along the commanded way, sideways commands included, (N,), m/s; `speed` is what `speed` gave."""
        if self.goals is not None:
            return speed
        asked = self.commands.command[:, :2]
        return (now.velocity[:, :2] * asked).sum(dim=1) / torch.linalg.vector_norm(asked, dim=1).clamp(min=1e-6)

    def direction(self, now: Motion) -> Tensor:
        """Unit vector to the next waypoint, world, (N, 3); zero, to be broadcast, without waypoints."""
        return self._nowhere if self.goals is None else self.goals.direction(now.position)

    def velocity_command(self, now: Motion, direction: Tensor) -> Tensor:
        """What the rewards ask for, vx, vy (m/s) and yaw rate (rad/s), (N, 3), base frame.

        On a course the velocity points to the next waypoint, along what `direction` gave, wherever the robot looks.
        """
        command = self.commands.command
        if self.goals is None:
            return command
        cos, sin, (x, y, _) = now.yaw.cos(), now.yaw.sin(), direction.unbind(1)
        speed = command[:, 0]
        return torch.stack((speed * (cos * x + sin * y), speed * (cos * y - sin * x), command[:, 2]), dim=1)

    def heading_error(self, now: Motion, rows: Tensor | slice = EVERYONE) -> Tensor:
        """Yaw to the next waypoint, or to the heading to keep, minus the robot's, (n,), rad."""
        if self.goals is None:
            return wrap(self.commands.heading[rows] - now.yaw)
        return self.goals.heading_error(now.position, now.yaw, rows=rows)

    def heading_errors(self, now: Motion, rows: Tensor | slice = EVERYONE) -> Tensor:
        """`heading_error`, and the same to the waypoint after the next, or once more, (n, 2), rad."""
        error = self.heading_error(now, rows)
        after = error if self.goals is None else self.goals.heading_error(now.position, now.yaw, 1, rows)
        return torch.stack((error, after), dim=1)

    def reach(self, now: Motion) -> Tensor:
        """Count one control step towards the waypoints; robots that have reached their last one, (N,) bool."""
        if self.goals is None:
            return self._nobody
        self.goals.advance(now.position)
        return self.goals.finished()

    def steer(self, now: Motion, rows: Tensor | slice = EVERYONE) -> None:
        """Set the yaw rates of robots `rows`, of which `now` is, where a heading or a waypoint gives them."""
        if self._steers:
            self.commands.steer(self.heading_error(now, rows), rows)
