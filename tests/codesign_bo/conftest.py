import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalRequest, EvalResult
from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # nothing is timed on a shared machine
settings.load_profile("untimed")


@pytest.fixture
def space() -> BoxSpace:
    return BoxSpace.box(["thigh", "shank"], low=[0.6, 0.5], high=[1.4, 1.5], nominal=1.0)


@pytest.fixture
def bowl():
    """A noisy bowl with its top at (1.2, 0.8) and known noise of 0.05 per sample of 4."""

    def evaluate(request: EvalRequest) -> EvalResult:
        x = np.array([request.params["thigh"], request.params["shank"]])
        noise = 0.05 * np.random.default_rng(request.seed).normal(size=4)
        samples = 1.0 - np.sum((x - [1.2, 0.8]) ** 2) + noise
        return EvalResult(samples.mean(), samples.std(ddof=1) / 2, 4, {"energy": float(x.sum())})

    return evaluate
