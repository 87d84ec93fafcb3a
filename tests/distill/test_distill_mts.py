"""Whose heading is followed: by |prediction - oracle|, never by the size of the oracle alone."""

from __future__ import annotations

import math

import pytest
import torch
from distill.vision.mts import choose, heading_difference, near
from hypothesis import given
from hypothesis import strategies as st

angles = st.floats(-10.0, 10.0)


@pytest.mark.parametrize(
    ("prediction", "oracle", "used"),
    [
        (0.5, 0.0, True),
        (0.7, 0.0, False),
        (-0.5, 0.0, True),
        (-0.7, 0.0, False),
        (1.2, 1.4, True),  # a large oracle is followed by a prediction that is near it
        (-1.2, -1.4, True),
        (0.0, -1.0, False),  # which a test of "oracle < 0.6" would let pass
        (3.0, -3.0, True),  # 0.28 rad apart, across the back
    ],
)
def test_predictions_near_the_oracle_are_used(prediction, oracle, used):
    prediction, oracle = torch.tensor([[prediction]]), torch.tensor([[oracle]])
    assert near(prediction, oracle, 0.6).tolist() == [used]
    chosen = choose(prediction, oracle, near(prediction, oracle, 0.6))
    assert torch.equal(chosen, prediction if used else oracle)


def test_one_heading_that_is_off_gives_both_back_to_the_oracle():
    prediction, oracle = torch.tensor([[0.1, 0.9], [0.1, 0.2]]), torch.zeros(2, 2)
    assert near(prediction, oracle, 0.6).tolist() == [False, True]


@given(angles, angles)
def test_the_difference_is_the_short_way_round(a, b):
    found = heading_difference(torch.tensor(a, dtype=torch.float64), torch.tensor(b, dtype=torch.float64)).item()
    expected = abs(math.atan2(math.sin(a - b), math.cos(a - b)))
    assert found == pytest.approx(expected, abs=1e-9)
