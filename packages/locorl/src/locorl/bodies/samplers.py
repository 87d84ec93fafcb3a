"""Morphology samplers: which bodies the robots of a training have, and when they change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, get_args

import numpy as np
import torch
from torch import Tensor

from locorl.bodies.designs import design_grid, feasible, repeat_design, sample_designs, sobol_designs
from locorl.interfaces import Array, BodyFactory

MorphologyKind = Literal["spatial", "temporal", "none", "grid", "sobol", "adaptive"]


@dataclass(frozen=True)
class MorphologyConfig:
    """How bodies are dealt to the robots of a training (sections III-B1 and IV-B1)."""

    kind: MorphologyKind = "spatial"
    """spatial: each robot has a body of its own, drawn uniformly (the paper's Spatial-DR).
    temporal: all robots share one body, which changes on a schedule (Temporal-DR).
    none: the nominal body (No-DR).
    grid: the bodies of a regular grid, in equal numbers.
    sobol: each robot has a body of its own, from a scrambled Sobol sequence.
    adaptive: as spatial at first; from time to time all are drawn anew, part of them like those that track worst."""
    levels: int = 3
    """grid, and temporal with a grid: values per parameter; 3 give the paper's 81 bodies."""
    bodies: int | None = 81
    """temporal: bodies that take turns, drawn uniformly; None takes those of the grid, shuffled."""
    every: int = 20
    """adaptive: iterations between changes."""
    uniform: float = 0.5
    """adaptive: share of the robots with freshly drawn uniform bodies; it keeps the whole space in training, and
    limits what bodies that no policy can drive may take."""
    worst: float = 0.1
    """adaptive: share of the bodies around which the other robots' bodies are drawn."""
    spread: float = 0.1
    """adaptive: how far from such a body, as a part of each parameter's range."""
    neighbours: int = 8
    """adaptive: a body's score is the mean over this many nearest bodies, as a single robot's is mostly the luck of
    its commands."""

    def __post_init__(self) -> None:
        """Refuse impossible settings before anything runs."""
        if self.kind not in get_args(MorphologyKind):
            raise ValueError(
                f"MorphologyConfig: no kind '{self.kind}'; there are {', '.join(get_args(MorphologyKind))}"
            )
        for name in ("levels", "bodies", "every", "neighbours"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"MorphologyConfig: {name} must be at least 1, got {value}")
        for name in ("uniform", "worst", "spread"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"MorphologyConfig: {name} must be in (0, 1], got {getattr(self, name)}")


class MorphologySampler(Protocol):
    """Deals bodies to N robots. Everything random in it follows from its seed."""

    @property
    def designs(self) -> Array:
        """The bodies as they are now, (N, d), all feasible."""
        ...

    def next(self, iteration: int, scores: Tensor) -> Array | None:
        """Ask before each iteration, once and in order, whether the bodies change.

        Args:
            iteration: the one that begins, from 0.
            scores: how badly each robot has done with its present body, (N,), a mean over its steps; higher is worse.

        Returns:
            The new bodies, (N, d), or None if they stay.
        """
        ...

    def state_dict(self) -> dict[str, Any]:
        """What is needed to go on from here, as tensors and plain data."""
        ...

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go back to a saved state."""
        ...


def make_sampler(
    config: MorphologyConfig, factory: BodyFactory, num_envs: int, iterations: int, seed: int
) -> MorphologySampler:
    """The sampler that `config` describes.

    Args:
        config: kind and options.
        factory: makes the bodies; its design space is sampled.
        num_envs: N.
        iterations: of the whole training, for the schedule of `temporal`.
        seed: of the bodies.

    Raises:
        ValueError: the design space holds hardly any feasible body; or the training is too short or too small for
            the sampler.
    """
    rng = np.random.default_rng(seed)
    if config.kind == "temporal":
        if config.bodies is None:
            bodies = rng.permutation(_feasible_grid(factory, config.levels))
        else:
            bodies = sample_designs(factory, config.bodies, rng)
        return TemporalSampler(bodies, num_envs, iterations)
    if config.kind == "adaptive":
        return AdaptiveSampler(config, factory, num_envs, seed)
    if config.kind == "none":
        return FixedSampler(repeat_design(factory, factory.space.nominal, num_envs))
    # neighbours of a grid or a sequence are alike, and neighbouring robots share a terrain
    if config.kind == "grid":
        return FixedSampler(_deal(_feasible_grid(factory, config.levels), num_envs, rng))
    if config.kind == "sobol":
        return FixedSampler(rng.permutation(sobol_designs(factory, num_envs, seed)))
    return FixedSampler(sample_designs(factory, num_envs, rng))


class FixedSampler:
    """The same bodies for the whole training.

    Args:
        designs: one for each robot, (N, d).
    """

    def __init__(self, designs: Array) -> None:
        self.designs = designs

    def next(self, iteration: int, scores: Tensor) -> None:
        """They never change."""

    def state_dict(self) -> dict[str, Any]:
        """There is nothing to save."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """There is nothing to go back to."""


class TemporalSampler:
    """One body for all robots at a time; each has an equal share of the training, to one iteration.

    The paper trains 81 bodies for 1/81 of the total duration each (section IV-B1). No body comes back.

    Args:
        bodies: in the order of their turns, (K, d).
        num_envs: N.
        iterations: of the whole training.

    Raises:
        ValueError: there are more bodies than iterations.
    """

    def __init__(self, bodies: Array, num_envs: int, iterations: int) -> None:
        if len(bodies) > iterations:
            raise ValueError(
                f"{len(bodies)} bodies cannot take turns in {iterations} iterations: train longer or take fewer bodies"
            )
        self._bodies, self._num_envs, self._iterations = bodies, num_envs, iterations
        self._turn = 0

    @property
    def designs(self) -> Array:
        """The present body, once for each robot, (N, d)."""
        return np.tile(self._bodies[self._turn], (self._num_envs, 1))

    def next(self, iteration: int, scores: Tensor) -> Array | None:
        """The next body for all robots when its turn comes."""
        turn = iteration * len(self._bodies) // self._iterations
        if turn == self._turn:
            return None
        self._turn = turn
        return self.designs

    def state_dict(self) -> dict[str, Any]:
        """Whose turn it is."""
        return {"turn": self._turn}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go back to a saved state."""
        self._turn = int(state["turn"])


class AdaptiveSampler:
    """Trains more on bodies like those on which the policy does worst.

    Starts as `spatial` does. Every `config.every` iterations all bodies are dealt anew: a share of `config.uniform`
    uniformly, the others around the bodies with the worst scores, each averaged over the nearest bodies.

    Args:
        config: the options.
        factory: makes the bodies.
        num_envs: N.
        seed: of the bodies.

    Raises:
        ValueError: there is but one robot, or the design space holds hardly any feasible body.
    """

    def __init__(self, config: MorphologyConfig, factory: BodyFactory, num_envs: int, seed: int) -> None:
        if num_envs < 2:
            raise ValueError("adaptive bodies need at least 2 robots, one of them with a uniformly drawn body")
        self._config, self._factory, self._seed = config, factory, seed
        self.designs = sample_designs(factory, num_envs, np.random.default_rng(seed))

    def next(self, iteration: int, scores: Tensor) -> Array | None:
        """Other bodies every `config.every` iterations."""
        if iteration == 0 or iteration % self._config.every:
            return None
        self.designs = self._deal(self._local_mean(scores.cpu()), np.random.default_rng((self._seed, iteration)))
        return self.designs

    def state_dict(self) -> dict[str, Any]:
        """The bodies."""
        return {"designs": torch.from_numpy(self.designs.copy())}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go back to a saved state."""
        self.designs = state["designs"].numpy().copy()

    def _local_mean(self, scores: Tensor) -> Array:
        """Mean score of each body and its nearest, (N,)."""
        space = self._factory.space
        scaled = torch.from_numpy((self.designs - space.low) / np.maximum(space.high - space.low, 1e-9)).float()
        distance = torch.cdist(scaled, scaled, compute_mode="donot_use_mm_for_euclid_dist")
        nearest = distance.topk(min(self._config.neighbours, len(scores)), largest=False).indices
        return scores[nearest].mean(dim=1).numpy()

    def _deal(self, scores: Array, rng: np.random.Generator) -> Array:
        config, space, n = self._config, self._factory.space, len(scores)
        fresh = int(np.clip(round(config.uniform * n), 1, n - 1))
        worst = np.argsort(scores, kind="stable")[-max(1, round(config.worst * n)) :]
        parents = self.designs[rng.choice(worst, n - fresh)]
        reach = config.spread * (space.high - space.low)
        # bounds cut the reach; clipping would pile bodies up on them
        near = rng.uniform(np.maximum(parents - reach, space.low), np.minimum(parents + reach, space.high))
        near = np.where(feasible(self._factory, near)[:, None], near, parents)
        return rng.permutation(np.concatenate((sample_designs(self._factory, fresh, rng), near)))


def _feasible_grid(factory: BodyFactory, levels: int) -> Array:
    grid = design_grid(factory, levels)
    grid = grid[feasible(factory, grid)]
    if not len(grid):
        raise ValueError(f"no body of the grid of '{factory.name}' has a stance: take another number of levels")
    return grid


def _deal(designs: Array, count: int, rng: np.random.Generator) -> Array:
    """Each of `designs` (k, d) in equal numbers, to one, in random order, (count, d); a random part if count < k."""
    return rng.permutation(designs[np.resize(rng.permutation(len(designs)), count)])
