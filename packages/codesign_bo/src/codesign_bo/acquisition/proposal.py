"""The order of proposals: nominal design, points queued by the user, Sobol points, then the surrogate's."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codesign_bo.acquisition.functions import Objective, noisy_log_ehvi, noisy_log_ei
from codesign_bo.acquisition.optimise import maximise
from codesign_bo.acquisition.pareto import reference_point
from codesign_bo.models.viability import THRESHOLD, ViabilityModel
from codesign_bo.records import Origin, Proposal
from codesign_bo.seeds import derive_seed
from codesign_bo.space import Array, BoxSpace, Feasible, Value, is_feasible, sobol_points

logger = logging.getLogger(__name__)

MIN_SEPARATION = 1e-3
"""Two points closer than this in every dimension of the unit cube are near-duplicates."""


@dataclass(frozen=True)
class Belief:
    """What models say of designs that were not tried.

    Attributes:
        objectives: The main objective, then further ones, each with its surrogate.
        viability: Probability that a design can be evaluated; None as long as all could.
    """

    objectives: tuple[Objective, ...]
    viability: ViabilityModel | None = None


def fingerprint(belief: Belief) -> str:
    """Return a short hash of what the models predict from: their data and hyperparameters."""
    parts: list[Array] = []
    for s in (objective.surrogate for objective in belief.objectives):
        held = s.hyperparameters
        rest = np.array([held.variance, held.extra_variance, held.constant, held.weight])
        parts += [s.x, s.y, s.sem, held.lengthscales, rest]
    if belief.viability is not None:
        model = belief.viability
        parts += [model.x.numpy(), model.slope.numpy(), np.array([model.lengthscale, model.variance])]
    return hashlib.sha256(b"".join(np.ascontiguousarray(p).tobytes() for p in parts)).hexdigest()[:16]


def suggest(space: BoxSpace, belief: Belief, pending: Array, seed: int, feasible: Feasible | None = None) -> Array:
    """Return the point (dim,) of the unit cube from which most improvement is to be expected.

    That is noisy expected improvement of the objective, or of the hypervolume if there are several, times the
    probability of viability; points below `viability.THRESHOLD` count only if there are no others.

    Args:
        space: The space.
        belief: What models say.
        pending: Points (m, dim) under evaluation.
        seed: Seed of draws and candidates; the same arguments give the same point.
        feasible: Predicate over designs in natural units.

    Raises:
        StudyError: No feasible point was found.
        RuntimeError: The models are numerically at their end.
    """
    means = [o.sign * o.surrogate.predict(o.surrogate.x)[0] for o in belief.objectives]
    centres = np.stack([o.surrogate.x[np.argmax(m)] for o, m in zip(belief.objectives, means, strict=True)])
    if len(belief.objectives) == 1:
        gain = noisy_log_ei(belief.objectives[0], pending, seed)
    else:
        gain = noisy_log_ehvi(belief.objectives, _reference(belief.objectives), pending, seed)
    model = belief.viability
    if model is None:
        return maximise(space, gain, centres, seed, feasible)
    return maximise(
        space,
        lambda at: gain(at) + model.log_probability(at),
        centres,
        seed,
        feasible,
        lambda at: model.log_probability(at) - math.log(THRESHOLD),
    )


def _reference(objectives: Sequence[Objective]) -> Array:
    """Return the reference point (m,) of the hypervolume, by the posterior means at all observed points."""
    points = np.unique(np.concatenate([o.surrogate.x for o in objectives]), axis=0)
    sign = np.array([o.sign for o in objectives])
    return sign * reference_point(sign * np.column_stack([o.surrogate.predict(points)[0] for o in objectives]))


def propose(
    space: BoxSpace,
    trial: int,
    n_init: int,
    seed: int,
    belief: Belief | None,
    pending: Array,
    failed: Array | None = None,
    queued: dict[str, Value] | None = None,
    feasible: Feasible | None = None,
) -> Proposal:
    """Return the design of a new trial, as a pure function of the arguments.

    Args:
        space: The space.
        trial: Number of the new trial.
        n_init: Trials before this number do not use the models.
        seed: Seed of the study.
        belief: Models of the evaluated trials, in the order of their numbers; None if these are too few.
        pending: Points (m, dim) of the unit cube under evaluation, or without a score for another reason.
        failed: Points (k, dim) at which evaluations failed; as those of `pending`, they are not tried again.
        queued: Next design in the user's queue.
        feasible: Predicate over designs in natural units.

    Raises:
        StudyError: No feasible design was found.
    """
    if trial == 0:
        return Proposal(space.nominal, "nominal")
    if queued is not None:
        return Proposal(queued, "queued")
    own_seed = derive_seed(seed, trial, 1)
    found: Array | None = None
    if belief is not None and trial >= n_init:
        try:
            found = suggest(space, belief, pending, own_seed, feasible)
        except RuntimeError as error:  # the last step of the ladder: torch's LinAlgError is a RuntimeError
            logger.warning("trial %d is a Sobol point, because the models failed: %s", trial, error)
    origin: Origin = "sobol" if found is None else "surrogate"
    point = sobol_points(space, 1, seed % 2**31, feasible, skip=trial)[0] if found is None else found
    avoid = pending if failed is None else np.concatenate([pending, failed])
    point = _nudge(space, point, avoid, own_seed, feasible)
    return Proposal(space.params(space.from_unit(point[None])[0]), origin)


def _nudge(space: BoxSpace, point: Array, pending: Array, seed: int, feasible: Feasible | None) -> Array:
    """Move `point` just far enough to be no near-duplicate of a pending one."""

    def clear(candidates: Array) -> Array:
        gaps = np.abs(candidates[:, None, :] - pending[None]).max(axis=-1)
        return candidates[(gaps >= MIN_SEPARATION).all(axis=1) & is_feasible(space, candidates, feasible)]

    if not len(pending) or len(clear(point[None])):
        return point
    rng = np.random.default_rng(seed)
    for radius in MIN_SEPARATION * 2.0 ** np.arange(1, 10):
        candidates = clear(space.snap(np.clip(point + rng.uniform(-radius, radius, (64, space.dim)), 0.0, 1.0)))
        if len(candidates):
            return candidates[np.argmin(np.abs(candidates - point).max(axis=1))]
    return sobol_points(space, 1, seed, feasible)[0]
