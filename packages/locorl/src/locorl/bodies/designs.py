"""Samples of bodies to train and test on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from locorl.interfaces import Array, BodyBatch, BodyFactory


def sample_designs(factory: BodyFactory, count: int, rng: np.random.Generator) -> Array:
    """Draw `count` feasible designs uniformly from the factory's design space, (count, d).

    Raises:
        ValueError: the design space holds hardly any feasible body.
    """
    space = factory.space
    return _keep_feasible(factory, count, lambda: rng.uniform(space.low, space.high, size=(count, len(space.names))))


def sobol_designs(factory: BodyFactory, count: int, seed: int) -> Array:
    """The first `count` feasible points of a scrambled Sobol sequence over the design space, (count, d).

    They fill the space more evenly than independent draws do, the most evenly where `count` is a power of 2.

    Raises:
        ValueError: the design space holds hardly any feasible body.
    """
    low, high = np.asarray(factory.space.low), np.asarray(factory.space.high)
    sequence = torch.quasirandom.SobolEngine(len(low), scramble=True, seed=seed)
    return _keep_feasible(
        factory, count, lambda: low + (high - low) * sequence.draw(count, dtype=torch.float64).numpy()
    )


def _keep_feasible(factory: BodyFactory, count: int, draw: Callable[[], Array]) -> Array:
    """The first `count` feasible designs of repeated draws of `count`."""
    if count < 1:
        raise ValueError(f"there must be at least one body, got {count}")
    chosen: list[Array] = []
    found = 0
    for _ in range(20):
        designs = draw()
        designs = designs[feasible(factory, designs)]
        chosen.append(designs)
        found += len(designs)
        if found >= count:
            return np.concatenate(chosen)[:count]
    raise ValueError(
        f"only {found} of {20 * count} random designs of '{factory.name}' have a stance: widen the bounds or "
        "correct the robot's description"
    )


def repeat_design(factory: BodyFactory, design: Array, count: int) -> Array:
    """`count` copies of one design, (count, d).

    Raises:
        ValueError: the design lies outside the design space or the body has no stance.
    """
    space = factory.space
    design = np.asarray(design, dtype=np.float64)
    if design.shape != (len(space.names),):
        raise ValueError(f"a design of '{factory.name}' has {len(space.names)} parameters {space.names}, got {design}")
    outside = [
        f"{name}={value:g} not in [{low:g}, {high:g}]"
        for name, value, low, high in zip(space.names, design, space.low, space.high, strict=True)
        if not low - 1e-9 <= value <= high + 1e-9
    ]
    if outside:
        raise ValueError(f"design of '{factory.name}' out of bounds: {', '.join(outside)}")
    if not feasible(factory, design[None])[0]:
        raise ValueError(f"the body {dict(zip(space.names, design, strict=True))} of '{factory.name}' has no stance")
    return np.tile(design, (count, 1))


def feasible(factory: BodyFactory, designs: Array) -> np.ndarray:
    """Which designs (n, d) have a stance, (n,) bool."""
    batch: BodyBatch = factory.batch(np.asarray(designs, dtype=np.float64))
    return np.asarray(batch.feasible)


def design_grid(factory: BodyFactory, levels: int = 3) -> Array:
    """The regular grid of `levels` values per parameter, (levels^d, d); 81 bodies for the paper's space.

    Raises:
        ValueError: there is not even one value per parameter.
    """
    if levels < 1:
        raise ValueError(f"a grid needs at least one value per parameter, got {levels}")
    space = factory.space
    axes = [np.linspace(low, high, levels) for low, high in zip(space.low, space.high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(space.names))
