"""A seeing policy tick by tick, from its two networks, on one robot: the reference of what a bundle's consumer does."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from distill.manifest import SeeingPart
from distill.runtimes import Array, Network, Shape, load_torchscript, onnx_network, torch_network
from distill.vision.student import VisionStudent


class DepthNetwork(nn.Module):
    """The part of a student that is fed with images, as exported."""

    def __init__(self, student: VisionStudent) -> None:
        super().__init__()
        self.student = student
        self.train(student.training)

    def forward(self, depth: Tensor, obs: Tensor, memory_in: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Take in one image.

        Args:
            depth: (1, rows, columns) from -0.5 (near) to 0.5 (far, or nothing).
            obs: (1, P) of the same tick; its headings are not read.
            memory_in: (1, M) `memory_out` of the image before; zeros at the start of an episode.

        Returns:
            terrain (1, S), heading (1, K), rad, and memory_out (1, M).
        """
        return self.student.see(self.student.features(depth), obs, memory_in)


class SeeingOutput(NamedTuple):
    """One tick: action (12,), velocity (3,), m/s, and terrain (S,) and heading (K,), rad, in use."""

    action: Array
    velocity: Array
    terrain: Array
    heading: Array


class SeeingRuntime:
    """Both networks with their states and the fixed latency between them.

    Args:
        policy: `VisionStudent.forward` as a function of arrays.
        depth: `DepthNetwork.forward` likewise.
        part: widths and timing.
        history: shape of the policy's state, (1, H, P).
    """

    def __init__(self, policy: Network, depth: Network, part: SeeingPart, history: Shape) -> None:
        self._policy, self._depth, self._part = policy, depth, part
        self._shapes = tuple(history), (1, part.memory)
        self._nothing = [np.zeros((1, width), np.float32) for width in (part.terrain, part.headings)]
        self.reset()

    def reset(self) -> None:
        """Begin a new episode."""
        self._history, self._memory = (np.zeros(shape, np.float32) for shape in self._shapes)
        self._tick = 0
        self._under_way: list[tuple[int, list[Array]]] = []
        self._in_use = self._nothing

    @property
    def due(self) -> bool:
        """Whether the next `step` takes an image in."""
        return self._tick % self._part.period_ticks == 0

    def step(self, obs: Array, image: Array | None) -> SeeingOutput:
        """Advance one tick on the observation (P,), and on the image (rows, columns) of this tick where one is due."""
        if self.due:
            assert image is not None
            *outputs, self._memory = self._depth([image[None], obs[None], self._memory])
            self._under_way.append((self._tick + self._part.latency_ticks, outputs))
        while self._under_way and self._under_way[0][0] <= self._tick:
            self._in_use = self._under_way.pop(0)[1]
        action, velocity, self._history = self._policy([obs[None], *self._in_use, self._history])
        self._tick += 1
        return SeeingOutput(action[0], velocity[0], self._in_use[0][0], self._in_use[1][0])


def eager_runtime(student: VisionStudent) -> SeeingRuntime:
    """The networks as they are, on the CPU."""
    policy, depth = torch_network(student), torch_network(DepthNetwork(student))
    return SeeingRuntime(policy, depth, seeing_part(student), (1, student.history, student.proprio))


def seeing_part(student: VisionStudent) -> SeeingPart:
    """What a manifest says of a student."""
    return SeeingPart(
        student.depth_shape,
        student.config.terrain_dim,
        student.headings,
        student.depth_encoder.memory,
        student.depth_period,
        student.config.latency,
        student.config.heading_limit,
    )


def due_ticks(reset: NDArray[np.bool_], period: int) -> NDArray[np.bool_]:
    """Ticks (T,) at which images are taken, in a trace with starts at `reset` (T,)."""
    ticks = np.arange(len(reset))
    return (ticks - np.maximum.accumulate(np.where(reset, ticks, 0))) % period == 0


def replay_seeing(
    runtime: SeeingRuntime, obs: Array, images: Array, reset: NDArray[np.bool_], due: NDArray[np.bool_]
) -> SeeingOutput:
    """Feed recorded observations (T, P) and the images (C, rows, columns) of the ticks in `due` (T,).

    Returns:
        All outputs, (T, ...) each.
    """
    order = np.cumsum(due) - 1
    outputs: list[SeeingOutput] = []
    for tick, frame in enumerate(obs):
        if reset[tick]:
            runtime.reset()
        outputs.append(runtime.step(frame, images[order[tick]] if due[tick] else None))
    return SeeingOutput(*(np.stack(parts) for parts in zip(*outputs, strict=True)))


def examples(student: VisionStudent) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Inputs of policy and depth network, batch 1."""
    obs = torch.zeros(1, student.proprio)
    terrain, heading = torch.zeros(1, student.config.terrain_dim), torch.zeros(1, student.headings)
    history = torch.zeros(1, student.history, student.proprio)
    memory = torch.zeros(1, student.depth_encoder.memory)
    return (obs, terrain, heading, history), (torch.zeros(1, *student.depth_shape), obs, memory)


def seeing_runtimes(folder: Path, manifest: dict[str, Any]) -> dict[str, SeeingRuntime]:
    """The runtimes of a seeing bundle, by the name of the policy's file."""
    policy, depth = manifest["policy"], manifest["depth"]
    shapes = SeeingPart.of(manifest), policy["state"][0]["shape"]
    pair = onnx_network(folder / policy["file"]), onnx_network(folder / depth["file"])
    found = {policy["file"]: SeeingRuntime(*pair, *shapes)}
    if "torchscript" in policy and "torchscript" in depth:
        mine, its = (torch_network(load_torchscript(folder / network["torchscript"])) for network in (policy, depth))
        found[policy["torchscript"]] = SeeingRuntime(mine, its, *shapes)
    return found
