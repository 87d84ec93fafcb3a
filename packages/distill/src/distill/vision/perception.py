"""When images are taken in, and when what they show is used: at a low rate and with a fixed latency."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from distill.vision.student import VisionStudent


class Percept(NamedTuple):
    """What N robots see and use at one instant.

    Attributes:
        terrain: latent (N, S).
        heading: (N, K), rad.
        seen: (N,) bool; False until the first image of an episode is due, with zeros above.
    """

    terrain: Tensor
    heading: Tensor
    seen: Tensor


class PerceptionState(NamedTuple):
    """What N robots remember of images: memory (N, M), and what was seen in the last ones, (Q, N, S + K + 1)."""

    memory: Tensor
    queue: Tensor

    def rows(self, robots: Tensor) -> PerceptionState:
        """That of some robots (n,)."""
        return PerceptionState(self.memory[robots], self.queue[:, robots])


class Perception:
    """The recurrent part of a student for N robots.

    Ticks are control steps since the last restart. An image is taken in with the proprioception of the same tick at
    each `depth_period`th tick, for all robots at once; what it shows is in use from `latency` ticks later until the
    next one is due. So all that a robot has to compute between has a fixed time to be computed in, and training,
    simulation and robot see the same. Where an episode ends, everything is zero again, what is under way included.

    Args:
        student: the networks.
        num_envs: N.
        device: where images live.
    """

    def __init__(self, student: VisionStudent, num_envs: int, device: torch.device | str = "cpu") -> None:
        self._student = student
        self._period, self._latency = student.depth_period, student.config.latency
        terrain, memory = student.config.terrain_dim, student.depth_encoder.memory
        queue = math.ceil(self._latency / self._period) + 1
        self._split = (terrain, terrain + student.headings)
        self._memory = torch.zeros(num_envs, memory, device=device)
        # the last column tells that there was an image
        self._queue = list(torch.zeros(queue, num_envs, terrain + student.headings + 1, device=device))
        self._tick = 0

    @property
    def due(self) -> bool:
        """Whether the next `step` takes an image in."""
        return self._tick % self._period == 0

    def state(self) -> PerceptionState:
        """What is remembered, at a tick at which an image is due."""
        return PerceptionState(self._memory, torch.stack(self._queue))

    def restore(self, state: PerceptionState) -> None:
        """Go on from a `state`, at a tick at which an image is due."""
        self._memory, self._queue, self._tick = state.memory, list(state.queue), 0

    def reset(self, done: Tensor | None = None) -> None:
        """Forget what the robots in `done` ((N,) bool) have seen; or restart all of them, at tick 0."""
        if done is None:
            done = torch.ones(len(self._memory), dtype=torch.bool, device=self._memory.device)
            self._tick = 0
        gone = done[:, None]
        self._memory = self._memory.masked_fill(gone, 0.0)
        self._queue = [shown.masked_fill(gone, 0.0) for shown in self._queue]

    def step(self, features: Tensor | None, proprio: Tensor) -> Percept:
        """Advance one tick.

        Args:
            features: (N, F) of the images of this tick, see `VisionStudent.features`; read only where `due`.
            proprio: (N, P) of this tick.

        Returns:
            What is in use at this tick.
        """
        if self.due:
            if features is None:
                raise ValueError("an image is due at this tick; check Perception.due")
            terrain, heading, self._memory = self._student.see(features, proprio, self._memory)
            self._queue = [*self._queue[1:], torch.cat((terrain, heading, torch.ones_like(heading[:, :1])), dim=1)]
        images_ago = self._tick // self._period - (self._tick - self._latency) // self._period
        terrain, heading, seen = self._queue[-1 - images_ago].tensor_split(self._split, dim=1)
        self._tick += 1
        return Percept(terrain, heading, seen[:, 0] > 0.5)
