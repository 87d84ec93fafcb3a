"""What a robot receives of its depth camera: late, noisy, clipped and normalised images at a low rate."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from locorl.env.depth_camera import DepthCamera, DepthConfig, mounted
from locorl.env.state import Stateful, uniform
from locorl.terrain.heights import HeightGrid


class DepthStream(Stateful):
    """Images of the cameras of all robots, taken at the same ticks and handed out after the latency.

    A tick is one control step. An image is taken every `period` and handed out `latency` later; between, the last one
    stays. A robot that restarts sees an image of its new place at once, until the next one that was taken since.

    Args:
        config: the camera.
        ground: what it sees.
        num_envs: number of robots.
        dt: control period, s; `period` and `latency` of the camera are multiples of it.
        generator: random numbers on the ground's device, or a seed for some.

    Attributes:
        pitch: of the mount of each robot, drawn at its reset, (N,), rad; positive looks down.

    Raises:
        ValueError: the period or the latency is no multiple of `dt`.
    """

    _state = ("pitch", "_images", "_tick")

    def __init__(
        self, config: DepthConfig, ground: HeightGrid, num_envs: int, dt: float, generator: torch.Generator | int
    ) -> None:
        self.config = config
        self._camera = DepthCamera(config, ground)
        self._period = max(1, _ticks("period", config.period, dt))
        self._latency = _ticks("latency", config.latency, dt)
        if isinstance(generator, int):
            generator = torch.Generator(ground.device).manual_seed(generator)
        self._generator = generator
        under_way = math.ceil(self._latency / self._period) + 1
        shape = (under_way, num_envs, config.rows, config.columns)
        self._images = torch.full(shape, 0.5, device=ground.device)
        self._tick = torch.zeros((), dtype=torch.long)
        self.pitch = torch.zeros(num_envs, device=ground.device)

    @property
    def frame(self) -> Tensor:
        """The image in use, (N, rows, columns), from -0.5 (near) to 0.5 (far, or nothing); valid until the next call.

        Robots that were never reset see nothing.
        """
        return self._images[(int(self._tick) - self._latency) // self._period % len(self._images)]

    @property
    def fresh(self) -> bool:
        """Whether the last step handed out another image; resets do not count."""
        return (int(self._tick) - self._latency) % self._period == 0

    def step(self, position: Tensor, quat: Tensor) -> None:
        """Count one control step that ended with the bases at `position` (N, 3), m, and `quat` (N, 4), wxyz."""
        self._tick += 1
        image, rest = divmod(int(self._tick), self._period)
        if rest == 0:
            self._images[image % len(self._images)] = self._take(position, quat, self.pitch)

    def reset(self, ids: Tensor, position: Tensor, quat: Tensor) -> None:
        """Start robots `ids` (m,) with the bases at `position` (m, 3), m, and `quat` (m, 4), wxyz."""
        low, high = self.config.pitch
        pitch = uniform((math.radians(low), math.radians(high)), len(ids), self._generator)
        self.pitch[ids] = pitch
        self._images[:, ids] = self._take(position, quat, pitch)

    def state_dict(self) -> dict[str, Tensor]:
        """Copies of the state, that of the random numbers included."""
        return {**super().state_dict(), "generator": self._generator.get_state()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a saved state.

        Raises:
            ValueError: it was saved with another number of robots, image size or latency.
        """
        super().load_state_dict(state)
        self._generator.set_state(state["generator"].cpu())

    def _take(self, position: Tensor, quat: Tensor, pitch: Tensor) -> Tensor:
        near, far = self.config.near, self.config.far
        depth = self._camera.render(*mounted(self.config, position.float(), quat.float(), pitch))
        return (self._disturb(depth).clamp_(near, far) - near) / (far - near) - 0.5

    def _disturb(self, depth: Tensor) -> Tensor:
        """Add noise to the depths (n, rows, columns) of what the camera sees; nothing stays nothing."""
        c = self.config
        lost = torch.zeros_like(depth)
        if c.edge_dropout:
            lost = c.edge_dropout * _behind_edges(depth, c.edge_jump)
        if c.dropout:
            lost = 1.0 - (1.0 - lost) * (1.0 - c.dropout)
        seen = depth < c.far
        if c.relative_noise or c.additive_noise:
            noise = torch.randn(depth.shape, generator=self._generator, device=depth.device)
            depth = depth + seen * noise * ((c.relative_noise * depth).square() + c.additive_noise**2).sqrt()
        if c.dropout or c.edge_dropout:
            chance = torch.rand(depth.shape, generator=self._generator, device=depth.device)
            depth = depth.masked_fill(chance < lost, c.far)
        return depth


def _behind_edges(depth: Tensor, jump: float) -> Tensor:
    """Pixels whose inverse depth is less than a direct neighbour's by more than `jump`, (n, rows, columns) bool."""
    inverse = 1.0 / depth.clamp(min=1e-3)
    behind = torch.zeros_like(depth, dtype=torch.bool)
    for axis in (1, 2):
        step, size = inverse.diff(dim=axis), depth.shape[axis]
        behind.narrow(axis, 0, size - 1).logical_or_(step > jump)
        behind.narrow(axis, 1, size - 1).logical_or_(step < -jump)
    return behind


def _ticks(name: str, seconds: float, dt: float) -> int:
    ticks = round(seconds / dt)
    if ticks < 0 or abs(ticks * dt - seconds) > 1e-6:
        raise ValueError(f"the camera's {name} is {seconds} s: choose a multiple of the control period, {dt} s")
    return ticks
