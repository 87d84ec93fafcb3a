"""The order of proposals: nominal design, points queued by the user, Sobol points, then the surrogate's."""

# pyright: reportArgumentType=false
# designs are numbers here until records hold integers and categories too
from __future__ import annotations

import numpy as np

from codesign_bo.acquire import suggest
from codesign_bo.records import Origin, Proposal
from codesign_bo.space import Array, BoxSpace, Feasible, is_feasible, sobol_points
from codesign_bo.surrogate import Surrogate

MIN_SEPARATION = 1e-3
"""Two points closer than this in every dimension of the unit cube are near-duplicates."""


def derive_seed(study_seed: int, *key: int) -> int:
    """Return the seed in [0, 2**31) that belongs to `key` in this study.

    Keys: `(trial,)` evaluates a trial, `(trial, 1)` proposes it, `(repeat, 2)` confirms, `(0, 3)` fits.
    """
    state = np.random.SeedSequence(study_seed, spawn_key=key).generate_state(1)
    return int(state[0] >> 1)


def propose(
    space: BoxSpace,
    trial: int,
    n_init: int,
    seed: int,
    surrogate: Surrogate | None,
    pending: Array,
    queued: dict[str, float] | None = None,
    maximize: bool = True,
    feasible: Feasible | None = None,
) -> Proposal:
    """Return the design of a new trial, as a pure function of the arguments.

    Args:
        space: The space.
        trial: Number of the new trial.
        n_init: Trials before this number do not use the surrogate.
        seed: Seed of the study.
        surrogate: Fitted to the evaluated trials in the order of their numbers; None if too few.
        pending: Points (m, dim) of the unit cube to stay away from: under evaluation, or failed.
        queued: Next design in the user's queue.
        maximize: Whether the objective is to be maximised.
        feasible: Predicate over designs in natural units.

    Raises:
        StudyError: No feasible design was found.
    """
    if trial == 0:
        return Proposal(space.nominal, "nominal")
    if queued is not None:
        return Proposal(queued, "queued")
    own_seed = derive_seed(seed, trial, 1)
    if surrogate is None or trial < n_init:
        point = sobol_points(space, 1, seed % 2**31, feasible, skip=trial)[0]
        origin: Origin = "sobol"
    else:
        point = suggest(space, surrogate, pending, own_seed, maximize, feasible)
        origin = "surrogate"
    point = _nudge(space, point, pending, own_seed, feasible)
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
        candidates = clear(np.clip(point + rng.uniform(-radius, radius, (64, space.dim)), 0.0, 1.0))
        if len(candidates):
            return candidates[np.argmin(np.abs(candidates - point).max(axis=1))]
    return sobol_points(space, 1, seed, feasible)[0]
