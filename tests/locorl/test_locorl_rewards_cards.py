"""Policy cards: those of earlier formats, with other names and fewer reward terms, are still read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from locorl import CheckpointError, NetworkConfig, RewardConfig, checkpoint, load_policy
from locorl.learning.networks import ActorCritic

DIMS = {"proprio": 5, "explicit": 3, "implicit": 4}
SMALL: dict[str, Any] = {"actor": [8], "critic": [8], "encoder": [4], "latent": 2}

OLD_REWARD = {  # every weight of format 1, each with a value of its own
    "linear_velocity": 2.5,
    "angular_velocity": 1.25,
    "collisions": -1.5,
    "vertical_velocity": -0.75,
    "roll_pitch_rate": -0.03,
    "action_rate": -0.02,
    "hip_position": -0.4,
    "joint_acceleration": -1e-7,
    "joint_position": -0.05,
    "torque_rate": -2e-7,
    "torque": -3e-5,
    "air_time": 4.0,
    "specific_power": -2.0,
    "kernel": "l1",
    "linear_scale": 0.2,
    "angular_scale": 0.3,
    "air_time_offset": 0.1,
    "air_time_cap": 0.6,
    "clip_at_zero": False,
}
MEANT = RewardConfig(
    linear_velocity_tracking=2.5,
    angular_velocity_tracking=1.25,
    collisions=-1.5,
    linear_velocity_penalty=-0.75,
    angular_velocity_penalty=-0.03,
    action_rate=-0.02,
    hip_position_penalty=-0.4,
    joint_acceleration=-1e-7,
    joint_position_penalty=-0.05,
    torque_rate=-2e-7,
    torque_penalty=-3e-5,
    feet_air_time=4.0,
    specific_power=-2.0,
    kernel="l1",
    linear_scale=0.2,
    angular_scale=0.3,
    air_time_offset=0.1,
    air_time_cap=0.6,
    clip_at_zero=False,
    # terms that came later earned nothing then
    progress=0.0,
    low_swing=0.0,
    fall=0.0,
)


def content(reward: dict[str, Any], **extra: Any) -> dict[str, Any]:
    """A policy as locorl's first version saved it, which wrote no card format."""
    card = {
        "robot": "box",
        "design_names": ["length"],
        "design_low": [0.6],
        "design_high": [1.4],
        "dims": DIMS,
        "task": {"name": "locomotion-flat", "reward": reward},
        "network": SMALL,
        "samples": 9,
        "seed": 3,
    }
    network = NetworkConfig(actor=(8,), critic=(8,), encoder=(4,), latent=2)
    return {"kind": "policy", "card": card, "model": ActorCritic(DIMS, 12, network).state_dict(), **extra}


def saved(path: Path, policy: dict[str, Any]) -> Path:
    checkpoint.save(path, policy)
    return path


def test_a_card_of_format_1_keeps_the_meaning_of_every_weight(tmp_path):
    old = content(OLD_REWARD)
    policy = load_policy(saved(tmp_path / "old.pt", old))
    assert policy.card.task.reward == MEANT
    assert policy.card.design_names == ("length",)
    assert all(torch.equal(old["model"][name], value) for name, value in policy.model.state_dict().items())

    policy.save(tmp_path / "new.pt")
    assert checkpoint.load(tmp_path / "new.pt")["card_format"] == 4
    assert load_policy(tmp_path / "new.pt").card == policy.card


def test_a_card_of_format_2_earned_nothing_by_terms_that_came_later(tmp_path):
    names = {"feet_air_time": 4.0, "specific_power": -2.0}
    reward = load_policy(saved(tmp_path / "old.pt", content(names, card_format=2))).card.task.reward
    assert reward == RewardConfig(**names, progress=0.0, low_swing=0.0, fall=0.0)


@pytest.mark.parametrize(
    ("policy", "complaint"),
    [
        (content({"bonus": 1.0}), r"RewardConfig has no field \['bonus'\]"),
        (content({"torque": -1e-5}, card_format=2), r"RewardConfig has no field \['torque'\]"),
        (content({"torque": -1e-5}, card_format=3), r"RewardConfig has no field \['torque'\]"),
        (content({}, card_format=5), r"card has format 5, this version reads up to 4; update locorl"),
    ],
)
def test_other_cards_are_refused(tmp_path, policy, complaint):
    with pytest.raises(CheckpointError, match=rf"odd\.pt holds no policy .*{complaint}"):
        load_policy(saved(tmp_path / "odd.pt", policy))
