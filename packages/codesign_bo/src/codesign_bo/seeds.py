"""Seeds of everything random in a study, all derived from its own."""

from __future__ import annotations

import numpy as np


def derive_seed(study_seed: int, *key: int) -> int:
    """Return the seed in [0, 2**31) that belongs to `key` in this study.

    Keys: `(trial,)` evaluates a trial, `(trial, 1)` proposes it, `(repeat, 2)` confirms, `(0, 3)` fits.
    """
    state = np.random.SeedSequence(study_seed, spawn_key=key).generate_state(1)
    return int(state[0] >> 1)
