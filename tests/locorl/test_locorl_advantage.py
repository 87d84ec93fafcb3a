"""Generalised advantage estimation by hand and by its definition as a double sum."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl.learning.advantage import generalised_advantage


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)[:, None]


def flags(*values: int) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.bool)[:, None]


NO = flags(0, 0, 0)


def test_three_steps_by_hand():
    # delta = 1 + 0.5*2 - 4 = -2;  2 + 0.5*6 - 2 = 3;  3 + 0.5*8 - 6 = 1;  carry 0.5*0.8 = 0.4
    advantage, target = generalised_advantage(
        column(1, 2, 3), column(4, 2, 6), column(2, 6, 8), NO, NO, gamma=0.5, lam=0.8
    )
    assert advantage.flatten().tolist() == pytest.approx([-2 + 0.4 * (3 + 0.4 * 1), 3 + 0.4 * 1, 1])
    assert target.flatten().tolist() == pytest.approx([-2 + 0.4 * 3.4 + 4, 3.4 + 2, 1 + 6])


def test_a_fall_ends_the_sum_and_has_no_future():
    end = flags(0, 1, 0)
    advantage, _ = generalised_advantage(column(1, 2, 3), column(4, 2, 6), column(2, 6, 8), end, end, 0.5, 0.8)
    # the second delta is 2 - 2 = 0, and nothing of the third reaches it
    assert advantage.flatten().tolist() == pytest.approx([-2, 0, 1])


def test_a_time_out_ends_the_sum_but_keeps_the_value_of_the_state_it_was_cut_in():
    end = flags(0, 1, 0)
    advantage, _ = generalised_advantage(column(1, 2, 3), column(4, 2, 6), column(2, 7, 8), end, NO, 0.5, 0.8)
    second = 2 + 0.5 * 7 - 2  # gamma enters the bootstrap
    assert advantage.flatten().tolist() == pytest.approx([-2 + 0.4 * second, second, 1])


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(0.05, 0.999), st.floats(0.0, 1.0))
def test_against_the_double_sum(seed, steps, gamma, lam):
    rng = np.random.default_rng(seed)
    reward, value, following = rng.normal(size=(3, steps, 3))
    done = rng.random((steps, 3)) < 0.3
    terminated = done & (rng.random((steps, 3)) < 0.5)
    expected = np.zeros((steps, 3))
    for n in range(3):
        for t in range(steps):
            for k in range(t, steps):
                future = 0.0 if terminated[k, n] else gamma * following[k, n]
                expected[t, n] += (gamma * lam) ** (k - t) * (reward[k, n] + future - value[k, n])
                if done[k, n]:
                    break
    advantage, target = generalised_advantage(
        *(torch.from_numpy(x) for x in (reward, value, following, done, terminated)), gamma, lam
    )
    np.testing.assert_allclose(advantage.numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(target.numpy(), expected + value, atol=1e-5)
