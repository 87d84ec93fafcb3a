"""Reward terms by hand; the weights of Table I as the paper prints them."""

from __future__ import annotations

import math

import pytest
import torch
from locorl import RewardConfig, table_i
from locorl.rewards.terms import TERMS, StepState, active_terms, total_reward

PAPER = {  # Table I, quadruped locomotion, typed in from the paper
    "linear_velocity": 1.0,
    "collisions": -1.0,
    "angular_velocity": 0.5,
    "vertical_velocity": -2.0,
    "roll_pitch_rate": -0.05,
    "action_rate": -0.01,
    "hip_position": -0.5,
    "joint_acceleration": -2.5e-7,
    "joint_position": -0.04,
    "torque_rate": -1e-7,
    "torque": -1e-5,
    "air_time": 1.0,
}


def row(*values: float, width: int = 12) -> torch.Tensor:
    """One robot's vector, padded with zeros."""
    return torch.tensor([[*values, *[0.0] * (width - len(values))]])


@pytest.fixture
def state() -> StepState:
    return StepState(
        velocity=row(0.5, -0.1, 0.3, width=3),
        rate=row(0.2, -0.4, 0.6, width=3),
        command=row(0.8, 0.1, 0.1, width=3),
        # hips are the first of each leg's three joints
        q_error=row(0.1, 0.2, 0.3, -0.2, 0.0, 0.1, 0.3, 0.0, 0.0, 0.1),
        joint_acceleration=row(10.0, -20.0),
        action=row(0.3, 1.0),
        last_action=row(0.0, 0.6),
        torque=row(3.0, -4.0, 1.0),
        last_torque=row(1.0, -1.0),
        landed_air_time=row(0.7, 0.2, 5.0, 0.4, width=4),
        landed=row(1.0, 1.0, 0.0, 1.0, width=4),
        colliding_links=torch.tensor([3.0]),
        specific_power=torch.tensor([0.25]),
    )


HAND = {  # the paper's equations with the numbers above
    "linear_velocity": math.exp(-(0.3 + 0.2)),
    "angular_velocity": math.exp(-0.5),
    "collisions": 3.0,
    "vertical_velocity": 0.09,
    "roll_pitch_rate": 0.04 + 0.16,
    "action_rate": 0.5,
    "hip_position": 0.01 + 0.04 + 0.09 + 0.01,
    "joint_acceleration": 500.0,
    "joint_position": 0.01 + 0.04 + 0.09 + 0.04 + 0.01 + 0.09 + 0.01,
    "torque_rate": 4.0 + 9.0 + 1.0,
    "torque": 26.0,
    "air_time": 0.2 - 0.3 - 0.1,
    "specific_power": 0.25,
}


@pytest.mark.parametrize("name", HAND)
def test_term_by_hand(name, state):
    assert TERMS[name](state, table_i()).tolist() == pytest.approx([HAND[name]], rel=1e-5)


def test_table_i_has_the_papers_weights():
    assert active_terms(table_i()) == PAPER


def test_the_total_of_table_i(state):
    reward, parts = total_reward(state, table_i(), dt=0.02)
    expected = {name: 0.02 * weight * HAND[name] for name, weight in PAPER.items()}
    assert {name: part.item() for name, part in parts.items()} == pytest.approx(expected, rel=1e-5)
    assert reward.item() == pytest.approx(sum(expected.values()), rel=1e-5)
    assert reward.item() < 0  # nothing is clipped


def test_the_default_kernels_are_gaussian(state):
    config = RewardConfig(linear_scale=0.2, angular_scale=0.5)
    linear = math.exp(-(0.3**2 + 0.2**2) / 0.2)
    assert TERMS["linear_velocity"](state, config).item() == pytest.approx(linear, rel=1e-5)
    assert TERMS["angular_velocity"](state, config).item() == pytest.approx(math.exp(-0.25 / 0.5), rel=1e-5)


def test_a_negative_total_is_clipped_at_zero_if_asked(state):
    state.colliding_links.fill_(10.0)
    assert total_reward(state, RewardConfig(), dt=0.02)[0].item() == 0.0
    assert total_reward(state, RewardConfig(clip_at_zero=False), dt=0.02)[0].item() < 0.0
    state.colliding_links.zero_()
    assert total_reward(state, RewardConfig(), dt=0.02)[0].item() > 0.0


def test_air_time_is_capped_and_paid_only_under_command(state):
    config = RewardConfig(air_time_offset=0.15, air_time_cap=0.4)
    assert TERMS["air_time"](state, config).item() == pytest.approx((0.4 + 0.2 + 0.4) - 3 * 0.15)
    state.command = row(0.05, 0.05, 0.5, width=3)  # turning on the spot needs no steps of a given length
    assert TERMS["air_time"](state, config).item() == 0.0


def test_a_weight_of_zero_leaves_the_term_out(state):
    _, parts = total_reward(state, RewardConfig(torque=0.0), dt=0.02)
    assert "torque" not in parts
    assert "torque_rate" in parts
