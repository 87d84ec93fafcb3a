"""Live through a rollout again, with gradients that flow back to its beginning."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from distill.vision.mts import choose, near
from distill.vision.perception import Perception
from distill.vision.sequences import Sequence
from distill.vision.student import VisionStudent


class Unrolled(NamedTuple):
    """What a student makes of T steps of B robots.

    Attributes:
        action: (T, B, 12).
        heading: predicted, (T, B, K), rad.
        oracle: headings (T, B, K), rad.
        terrain: latent (T, B, S).
        velocity: estimated (T, B, 3), m/s.
        seen: (T, B) bool, whether heading and terrain come from an image.
    """

    action: Tensor
    heading: Tensor
    oracle: Tensor
    terrain: Tensor
    velocity: Tensor
    seen: Tensor


def unroll(student: VisionStudent, sequence: Sequence, threshold: float | None) -> Unrolled:
    """Run a student over a recorded rollout, from what it remembered at its beginning.

    That memory has no gradient: back-propagation through time is cut there, and wherever an episode begins.

    Args:
        student: the networks.
        sequence: B robots; its first step is one at which images were taken.
        threshold: of MTS, rad; None: predicted headings are always used.
    """
    steps, robots = sequence.first.shape
    features = student.features(sequence.depth.flatten(0, 1)).unflatten(0, sequence.depth.shape[:2])
    perception = Perception(student, robots, sequence.proprio.device)
    perception.restore(sequence.perception)
    history, images = sequence.history, iter(features)
    windows, percepts = [], []
    for step in range(steps):
        first, proprio = sequence.first[step], sequence.proprio[step]
        perception.reset(first)
        history = student.adaptation.push(history.masked_fill(first[:, None, None], 0.0), proprio)
        windows.append(history)
        percepts.append(perception.step(next(images) if perception.due else None, proprio))
    terrain, heading, seen = (torch.stack(parts) for parts in zip(*percepts, strict=True))
    oracle = sequence.proprio[..., student.heading]
    use = torch.ones_like(seen) if threshold is None else near(heading, oracle, threshold)
    window = torch.stack(windows)
    velocity, latent = student.adaptation.velocity(window), student.adaptation.latent(window)
    parts = (sequence.proprio, terrain, choose(heading, oracle, use), velocity, latent)
    return Unrolled(_over_rows(student.infer, parts, (steps, robots)), heading, oracle, terrain, velocity, seen)


def _over_rows(function: Callable[..., Tensor], parts: tuple[Tensor, ...], leading: tuple[int, int]) -> Tensor:
    return function(*(part.flatten(0, 1) for part in parts)).unflatten(0, leading)
