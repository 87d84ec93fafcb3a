"""Reward terms by hand; the weights of Table I as the paper prints them; what holds for any state."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl.config import differences, from_dict, to_dict
from locorl.rewards.config import RewardConfig, released_code, table_i
from locorl.rewards.state import StepState
from locorl.rewards.terms import TERMS
from locorl.rewards.total import active_terms, total_reward

LOCOMOTION = {  # Table I, left half, typed in from the paper
    "linear_velocity_tracking": 1.0,
    "collisions": -1.0,
    "angular_velocity_tracking": 0.5,
    "linear_velocity_penalty": -2.0,
    "angular_velocity_penalty": -0.05,
    "action_rate": -0.01,
    "hip_position_penalty": -0.5,
    "joint_acceleration": -2.5e-7,
    "joint_position_penalty": -0.04,
    "torque_rate": -1e-7,
    "torque_penalty": -1e-5,
    "feet_air_time": 1.0,
}
PARKOUR = {  # the right half; the printed minus within the clearance equation is part of its weight here
    "goal_tracking": 1.5,
    "clearance": -1.0,
    "angular_velocity_tracking": 0.5,
    "linear_velocity_penalty": -1.0,
    "angular_velocity_penalty": -0.05,
    "action_rate": -0.1,
    "hip_position_penalty": -0.5,
    "joint_acceleration": -2.5e-7,
    "joint_position_penalty": -0.04,
    "torque_rate": -1e-7,
    "torque_penalty": -1e-5,
    "orientation": -1.0,
}
CONFIGS = {
    "default": RewardConfig(),
    "locomotion": table_i("locomotion"),
    "parkour": table_i("parkour"),
    "released": released_code(),
}


def row(*values: float, width: int = 12) -> torch.Tensor:
    """One robot's vector, padded with zeros."""
    return torch.tensor([[*values, *[0.0] * (width - len(values))]])


@pytest.fixture
def state() -> StepState:
    """A robot that walks slower than asked, tilted, with three feet landing."""
    return StepState(
        velocity=row(0.5, -0.1, 0.3, width=3),
        rate=row(0.2, -0.4, 0.6, width=3),
        command=row(0.8, 0.1, 0.1, width=3),
        # hips are the first of each leg's three joints: columns 0, 3, 6, 9
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
        velocity_world=row(0.4, 0.3, -0.2, width=3),
        goal_direction=row(0.6, 0.8, 0.0, width=3),
        heading_error=torch.tensor([-0.7]),
        gravity=row(2 / 7, 3 / 7, -6 / 7, width=3),
        edge_feet=row(1.0, 0.0, 1.0, 0.0, width=4),
        foot_speed=row(1.0, 0.5, 0.25, 2.0, width=4),
        foot_rise=row(0.015, 0.0, 0.06, 0.1, width=4),
        foot_force=torch.tensor([[[3.0, -4.0, 1.2], [0.0, 0.0, 50.0], [4.0, 0.0, -20.0], [0.0, 0.0, 0.0]]]),
    )


HAND = {  # the paper's equations with the numbers above
    "linear_velocity_tracking": math.exp(-(0.3 + 0.2)),
    "angular_velocity_tracking": math.exp(-0.5),  # 0.6 turned, 0.1 asked
    "collisions": 3.0,
    "linear_velocity_penalty": 0.09,  # 0.3^2
    "angular_velocity_penalty": 0.04 + 0.16,
    "action_rate": 0.5,  # |(0.3, 0.4)|
    "hip_position_penalty": 0.01 + 0.04 + 0.09 + 0.01,
    "joint_acceleration": 500.0,  # 100 + 400
    "joint_position_penalty": 0.01 + 0.04 + 0.09 + 0.04 + 0.01 + 0.09 + 0.01,
    "torque_rate": 4.0 + 9.0 + 1.0,
    "torque_penalty": 26.0,  # 9 + 16 + 1
    "feet_air_time": 0.2 - 0.3 - 0.1,  # 0.7, 0.2 and 0.4 s minus 0.5 s; the third foot has not landed
    "goal_tracking": 0.48,  # 0.4 * 0.6 + 0.3 * 0.8, less than the 0.8 asked
    "clearance": 2.0,
    "orientation": 13 / 49,  # (2/7)^2 + (3/7)^2
    "heading_tracking": math.exp(-0.7),
    "stumble": 1.0,  # 5 N sideways, 1.2 N up on the first foot
    "progress": (0.5 * 0.8 - 0.1 * 0.1) / math.hypot(0.8, 0.1),
    "low_swing": 1.0 * 0.75 + 0.5 * 1.0,  # 1.5 and 0 of the 6 cm; the other two are up
    "specific_power": 0.25,
}


@pytest.mark.parametrize("name", TERMS)
def test_term_by_hand(name, state):
    assert TERMS[name](state, table_i()).tolist() == pytest.approx([HAND[name]], rel=1e-5)


def test_every_term_has_a_weight_of_its_name():
    assert set(TERMS) <= {field.name for field in fields(RewardConfig)}
    assert active_terms(RewardConfig(**dict.fromkeys(TERMS, 2.0))) == dict.fromkeys(TERMS, 2.0)


@pytest.mark.parametrize(("task", "paper"), [("locomotion", LOCOMOTION), ("parkour", PARKOUR)])
def test_table_i_has_the_papers_weights_and_its_total(task, paper, state):
    config = table_i(task)
    assert active_terms(config) == paper
    reward, parts = total_reward(state, config, dt=0.02)
    expected = {name: 0.02 * weight * HAND[name] for name, weight in paper.items()}
    assert {name: part.item() for name, part in parts.items()} == pytest.approx(expected, rel=1e-5)
    assert reward.item() == pytest.approx(sum(expected.values()), rel=1e-5)
    assert reward.item() < 0  # nothing is clipped


def test_table_i_names_its_tasks():
    with pytest.raises(ValueError, match=r"'locomotion' and 'parkour', not 'swimming'"):
        table_i("swimming")  # pyright: ignore[reportArgumentType]


def test_the_released_code_differs_from_table_i_where_it_is_said_to():
    off_flat = [
        "angular_velocity_tracking: 0.5 -> 0.0",
        "clip_at_zero: False -> True",
        "collisions: 0.0 -> -10.0",
        "heading_tracking: 0.0 -> 0.5",
        "linear_velocity_penalty: -1.0 -> -0.5",
        "normalise_goal_velocity: False -> True",
        "orientation: -1.0 -> 0.0",
        "stumble: 0.0 -> -1.0",
    ]
    paper = to_dict(table_i("parkour"))
    assert differences(paper, to_dict(released_code())) == off_flat
    on_flat = [line for line in off_flat if not line.startswith(("linear_velocity_penalty", "orientation"))]
    assert differences(paper, to_dict(released_code(flat=True))) == on_flat


def test_the_default_kernels_are_gaussian(state):
    config = RewardConfig(linear_scale=0.2, angular_scale=0.5)
    linear = math.exp(-(0.3**2 + 0.2**2) / 0.2)
    assert TERMS["linear_velocity_tracking"](state, config).item() == pytest.approx(linear, rel=1e-5)
    angular = math.exp(-(0.5**2) / 0.5)
    assert TERMS["angular_velocity_tracking"](state, config).item() == pytest.approx(angular, rel=1e-5)


def test_a_negative_total_is_clipped_at_zero_if_asked_and_its_shares_are_not(state):
    state.colliding_links.fill_(10.0)
    clipped, shares = total_reward(state, RewardConfig(), dt=0.02)
    assert clipped.item() == 0.0
    assert shares["collisions"].item() == pytest.approx(-0.2)
    unclipped = total_reward(state, RewardConfig(clip_at_zero=False), dt=0.02)[0].item()
    assert unclipped == pytest.approx(sum(share.item() for share in shares.values()), rel=1e-5)
    assert unclipped < 0.0
    state.colliding_links.zero_()
    assert total_reward(state, RewardConfig(), dt=0.02)[0].item() == pytest.approx(unclipped + 0.2, rel=1e-4)


def test_air_time_is_capped_and_paid_only_under_command(state):
    config = RewardConfig(air_time_offset=0.15, air_time_cap=0.4)
    assert TERMS["feet_air_time"](state, config).item() == pytest.approx((0.4 + 0.2 + 0.4) - 3 * 0.15)
    state.command = row(0.05, 0.05, 0.5, width=3)  # turning on the spot needs no steps of a given length
    assert TERMS["feet_air_time"](state, config).item() == 0.0
    # the paper prints no such condition
    assert TERMS["feet_air_time"](state, replace(config, air_time_command=0.0)).item() == pytest.approx(0.55)


@pytest.mark.parametrize(
    ("command", "gain", "share"),
    [
        (0.8, 0.48, 0.6),
        (0.3, 0.3, 1.0),  # faster than asked earns what was asked
        (0.05, 0.05, 0.5),  # below 0.1 m/s a share of 0.1
        (0.0, 0.0, 0.0),
    ],
)
def test_goal_tracking_and_the_share_of_the_command_that_the_released_code_rewards(command, gain, share, state):
    state.command = row(command, width=3)
    assert TERMS["goal_tracking"](state, table_i("parkour")).item() == pytest.approx(gain)
    assert TERMS["goal_tracking"](state, released_code()).item() == pytest.approx(share)


def test_moving_away_from_the_goal_costs(state):
    state.velocity_world = -state.velocity_world
    assert TERMS["goal_tracking"](state, table_i("parkour")).item() == pytest.approx(-0.48)


@pytest.mark.parametrize(
    ("force", "stumbles"),
    [
        ((4.1, 0.0, 1.0), 1.0),
        ((0.0, -4.1, -1.0), 1.0),  # pulled down by an overhang
        ((4.0, 0.0, 1.0), 0.0),  # exactly 4
        ((3.0, 3.0, 1.1), 0.0),  # |F_xy| = 4.243 < 4.4
        ((0.0, 0.0, 0.0), 0.0),  # in the air, or no force sensors
    ],
)
def test_a_foot_stumbles_when_it_is_pushed_sideways(force, stumbles, state):
    state.foot_force = torch.zeros(1, 4, 3)
    state.foot_force[0, 2] = torch.tensor(force)
    assert TERMS["stumble"](state, released_code()).tolist() == [stumbles]


def test_two_stumbling_feet_count_once(state):
    state.foot_force = torch.tensor([[9.0, 0.0, 1.0]]).repeat(1, 4, 1)
    assert TERMS["stumble"](state, released_code()).tolist() == [1.0]


def test_a_weight_of_zero_leaves_the_term_out(state):
    _, parts = total_reward(state, RewardConfig(torque_penalty=0.0), dt=0.02)
    assert "torque_penalty" not in parts
    assert "torque_rate" in parts


@pytest.fixture
def own(monkeypatch, tmp_path):
    """A module with a term of one's own, on the path."""
    (tmp_path / "wild_terms.py").write_text("def crouch(state, config):\n    return -state.gravity[:, 2] * 3.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    return (("wild_terms:crouch", -0.5),)


def test_a_term_of_ones_own_counts_like_the_others(own, state):
    plain, _ = total_reward(state, RewardConfig(clip_at_zero=False), dt=0.02)
    both, parts = total_reward(state, RewardConfig(clip_at_zero=False, own=own), dt=0.02)
    expected = -0.5 * 0.02 * 3.0 * -state.gravity[:, 2]
    assert torch.allclose(parts["wild_terms:crouch"], expected)
    assert torch.allclose(both, plain + expected)


def test_terms_of_ones_own_survive_the_disk(own):
    config = RewardConfig(own=own)
    assert active_terms(config)["wild_terms:crouch"] == -0.5
    assert from_dict(RewardConfig, to_dict(config)) == config


@pytest.mark.parametrize(
    ("name", "words"), [("crouch", "module:function"), ("nowhere:crouch", "nowhere"), ("math:crouch", "crouch")]
)
def test_a_term_that_cannot_be_found_is_refused_before_anything_runs(name, words):
    with pytest.raises(ValueError, match=words):
        active_terms(RewardConfig(own=((name, -1.0),)))


def test_progress_pays_up_to_the_commanded_speed_and_nothing_for_standing_still(state):
    still = replace(state, command=row(width=3))
    fast = replace(state, velocity=row(2.0, 0.3, width=3))
    back = replace(state, velocity=row(-0.8, -0.1, width=3))
    earned = [TERMS["progress"](each, table_i()).item() for each in (still, fast, back)]
    assert earned == pytest.approx([0.0, math.hypot(0.8, 0.1), -math.hypot(0.8, 0.1)])


# ------------------------------------------------------------- for any state

seeds = st.integers(0, 2**32 - 1)
robots = st.integers(1, 7)
configs = st.sampled_from(sorted(CONFIGS)).map(CONFIGS.__getitem__)


def any_state(seed: int, n: int) -> StepState:
    """N robots in states that have nothing to do with each other."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int, scale: float = 1.0) -> torch.Tensor:
        return scale * torch.randn(n, *shape, generator=generator)

    def unit() -> torch.Tensor:
        return torch.nn.functional.normalize(normal(3), dim=1)

    return StepState(
        velocity=normal(3),
        rate=normal(3),
        command=normal(3),
        q_error=normal(12),
        joint_acceleration=normal(12, scale=100.0),
        action=normal(12),
        last_action=normal(12),
        torque=normal(12, scale=10.0),
        last_torque=normal(12, scale=10.0),
        landed_air_time=normal(4).abs(),
        landed=(normal(4) > 0).float(),
        colliding_links=(normal(12) > 1).sum(dim=1).float(),
        specific_power=normal().abs(),
        velocity_world=normal(3),
        goal_direction=unit(),
        heading_error=normal(),
        gravity=unit(),
        edge_feet=(normal(4) > 1).float(),
        foot_speed=normal(4).abs(),
        foot_rise=normal(4, scale=0.1).abs(),
        foot_force=normal(4, 3, scale=10.0),
    )


@given(seeds, robots, configs)
def test_penalties_never_pay_and_tracking_never_costs(seed, n, config):
    _, shares = total_reward(any_state(seed, n), config, dt=0.02)
    weights = active_terms(config)
    for name, share in shares.items():
        if weights[name] < 0.0:
            assert (share <= 0.0).all(), name
        elif name.endswith("_tracking") and name != "goal_tracking":
            assert ((share >= 0.0) & (share <= 0.02 * weights[name] * (1 + 1e-6))).all(), name


@given(seeds, robots, configs)
def test_the_reward_of_a_robot_does_not_depend_on_the_others(seed, n, config):
    state = any_state(seed, n)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    moved = StepState(**{name: value[order] for name, value in vars(state).items()})
    alone = StepState(**{name: value[:1] for name, value in vars(state).items()})
    reward = total_reward(state, config, dt=0.02)[0]
    torch.testing.assert_close(total_reward(moved, config, dt=0.02)[0], reward[order])
    torch.testing.assert_close(total_reward(alone, config, dt=0.02)[0], reward[:1])


@given(seeds, robots, configs)
def test_the_state_is_only_read(seed, n, config):
    state, same = any_state(seed, n), any_state(seed, n)
    total_reward(state, config, dt=0.02)
    for name, value in vars(state).items():
        assert torch.equal(value, vars(same)[name]), name


@given(seeds, robots, configs, st.floats(0.005, 0.1))
def test_the_reward_is_proportional_to_the_control_period(seed, n, config, dt):
    state = any_state(seed, n)
    torch.testing.assert_close(total_reward(state, config, dt)[0], total_reward(state, config, 1.0)[0] * dt)


@given(seeds, robots)
def test_goal_tracking_is_at_most_what_was_commanded_and_knows_no_compass(seed, n):
    state = any_state(seed, n)
    term, config = TERMS["goal_tracking"], table_i("parkour")
    gain = term(state, config)
    assert (gain <= state.command[:, :2].norm(dim=1) + 1e-6).all()
    assert (gain <= state.velocity_world.norm(dim=1) + 1e-6).all()
    turn = torch.linalg.qr(any_state(seed, 3).velocity)[0]
    turned = replace(state, velocity_world=state.velocity_world @ turn, goal_direction=state.goal_direction @ turn)
    torch.testing.assert_close(term(turned, config), gain, atol=1e-5, rtol=1e-4)
    normalised = term(replace(state, command=state.command.abs() + 0.1), released_code())
    assert (normalised <= 1.0).all()


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_orientation_is_the_squared_sine_of_the_tilt_whatever_its_direction(tilt, direction):
    sine = math.sin(tilt)
    gravity = row(sine * math.cos(direction), sine * math.sin(direction), -math.cos(tilt), width=3)
    state = replace(any_state(0, 1), gravity=gravity)
    assert TERMS["orientation"](state, table_i("parkour")).item() == pytest.approx(sine**2, rel=1e-4, abs=1e-9)


@given(st.floats(-math.pi, math.pi))
def test_heading_tracking_is_the_same_to_either_side(error):
    state = replace(any_state(0, 2), heading_error=torch.tensor([error, -error]))
    left, right = TERMS["heading_tracking"](state, released_code()).tolist()
    assert left == right == pytest.approx(math.exp(-abs(error)), rel=1e-5)


def test_clipping_leaves_the_share_of_a_single_term_alone(state):
    only = RewardConfig(**dict.fromkeys(active_terms(RewardConfig()), 0.0) | {"torque_penalty": -1.0})
    reward, shares = total_reward(state, only, dt=1.0)
    assert (reward.item(), shares["torque_penalty"].item()) == (0.0, -26.0)
