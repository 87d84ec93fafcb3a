"""Builds observations: reads each named term, adds noise, keeps scan, heading and history."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from locorl.env.kinematics import roll_pitch
from locorl.env.observation import ObservationConfig, ObsLayout
from locorl.env.scan import HeightScan
from locorl.env.state import Motion, Stateful
from locorl.terrain.heights import HeightGrid

Rows = Tensor | slice


@dataclass
class Snapshot:
    """What there is to observe of n robots at one instant.

    Attributes:
        motion: base and joints.
        stance_q: joint angles of the stance, (n, 12), rad.
        stance_height: base above the ground in the stance, (n,), m.
        command: commanded velocities, (n, 3).
        action: last action, (n, 12).
        touching: feet in contact, (n, 4), bool.
        heading_errors: towards the next waypoint and the one after, or from a heading to keep, (n, 2), rad.
    """

    motion: Motion
    stance_q: Tensor
    stance_height: Tensor
    command: Tensor
    action: Tensor
    touching: Tensor
    heading_errors: Callable[[], Tensor]


class Observer(Stateful):
    """Observations of N robots; scan and heading errors are held between two looks at the world.

    Args:
        config: what to observe.
        layout: the same, spelt out.
        ground: heights of the terrain.
        noise: level of the sensor noise; 0 takes nothing from the random stream.
        dt: control period, s.
        num_envs: N.
        generator: of the noise.
    """

    _state = ("scan", "heading_errors", "history", "_shown", "_tick")

    def __init__(
        self,
        config: ObservationConfig,
        layout: ObsLayout,
        ground: HeightGrid,
        noise: float,
        dt: float,
        num_envs: int,
        generator: torch.Generator,
    ) -> None:
        device = generator.device
        self.config, self.layout = config, layout
        self.scanner = None if config.scan is None else HeightScan(config.scan, ground)
        self._noise, self._generator = noise, generator
        self._period = max(1, round(config.perception_period / dt))
        self._heads = any(not term.onboard for term in layout.proprio)
        self._looks = self._heads or self.scanner is not None
        width = layout.dims["proprio"]
        self.scan = torch.zeros(num_envs, layout.dims.get("scan", 0), device=device)
        self.heading_errors = torch.zeros(num_envs, 2, device=device)
        self.history = torch.zeros(num_envs, config.history, width, device=device)
        self._shown = torch.zeros(num_envs, width if config.history else 0, device=device)
        self._tick = torch.zeros((), dtype=torch.long)
        noise_of = [torch.full((term.size,), noise * term.noise * term.scale) for term in layout.proprio]
        self._proprio_noise = torch.cat(noise_of).to(device)
        onboard = [torch.full((term.size,), float(term.onboard)) for term in layout.proprio]
        self._onboard = torch.cat(onboard).to(device)
        self.implicit = torch.zeros(num_envs, layout.dims["implicit"], device=device)
        """The implicit group, which changes only with the bodies, (N, dim)."""

    def advance(self, now: Snapshot) -> None:
        """Count one control step: the last observation becomes history, and at its rate perception looks anew."""
        if self.config.history:
            self.history = torch.cat((self.history[:, 1:], self._shown[:, None]), dim=1)
        if self._looks:
            self._tick += 1
            if int(self._tick) % self._period == 0:
                self._look(now, slice(None))

    def observe(self, now: Snapshot) -> dict[str, Tensor]:
        """The observation of all robots, group -> (N, dim)."""
        return self._groups(now, slice(None))

    def restart(self, now: Snapshot, rows: Tensor) -> dict[str, Tensor]:
        """The first observation of robots `rows`, of which `now` is, in a new episode: their past is forgotten."""
        if self._looks:
            self._look(now, rows)
        if self.config.history:
            self.history[rows] = (self._proprio(now, rows) * self._onboard)[:, None]
        return self._groups(now, rows)

    def _look(self, now: Snapshot, rows: Rows) -> None:
        if self._heads:
            self.heading_errors[rows] = now.heading_errors()
        if self.scanner:
            self.scan[rows] = self.scanner.measure(now.motion.position, now.motion.yaw, now.stance_height)

    def _groups(self, now: Snapshot, rows: Rows) -> dict[str, Tensor]:
        proprio = self._proprio(now, rows)
        if self._noise > 0.0:
            proprio += self._proprio_noise * self._white(proprio)
        groups = {"proprio": proprio, "explicit": now.motion.velocity.clone(), "implicit": self.implicit[rows]}
        if self.scanner:
            scan = self.scan[rows].clone()
            if self._noise > 0.0:
                scan += self._noise * self.layout.scan[0].noise * self._white(scan)
            groups["scan"] = scan
        if self.config.history:
            self._shown[rows] = proprio * self._onboard
            groups["history"] = self.history[rows].flatten(1)
        return groups

    def _proprio(self, now: Snapshot, rows: Rows) -> Tensor:
        heading = self.heading_errors[rows]
        parts = []
        for term in self.layout.proprio:
            value = READERS[term.name](now, heading)
            parts.append(value if term.scale == 1.0 else value * term.scale)
        return torch.cat(parts, dim=1)

    def _white(self, like: Tensor) -> Tensor:
        return 2.0 * torch.rand(like.shape, generator=self._generator, device=like.device) - 1.0


READERS: Mapping[str, Callable[[Snapshot, Tensor], Tensor]] = {
    "base_angular_velocity": lambda now, _: now.motion.rate,
    "projected_gravity": lambda now, _: now.motion.gravity,
    "roll_pitch": lambda now, _: roll_pitch(now.motion.gravity),
    "heading_error": lambda _, held: held[:, :1],
    "next_heading_error": lambda _, held: held[:, 1:],
    "command": lambda now, _: now.command,
    "commanded_speed": lambda now, _: now.command[:, :1],
    "joint_position_error": lambda now, _: now.motion.q - now.stance_q,
    "joint_velocity": lambda now, _: now.motion.qd,
    "last_action": lambda now, _: now.action,
    "foot_contact": lambda now, _: now.touching.float() - 0.5,
}
"""How each term of `PROPRIO` is read from a snapshot and the held heading errors (n, 2), in its own unit, (n, size)."""
