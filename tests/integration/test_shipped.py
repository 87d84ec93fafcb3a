"""What the project ships walks, and says where it came from."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from locorl import EvalConfig, Policy, evaluate, load_policy, sample_designs
from locorl.config import from_dict
from locorl.training.trainer import TrainConfig
from morphgen import BodyFactory

from legged_codesign.pretrained import shipped_policy


@pytest.fixture(scope="module")
def home() -> Path:
    return shipped_policy("go2").parent


@pytest.fixture(scope="module")
def generalist(home: Path) -> Policy:
    return load_policy(home / "policy.pt")


@pytest.fixture(scope="module")
def provenance(home: Path) -> dict:
    return json.loads((home / "provenance.json").read_text())


def test_generalist_is_for_the_whole_design_space(generalist: Policy, go2: BodyFactory) -> None:
    generalist.check_space(go2.name, go2.space)
    card = generalist.card
    assert (card.design_low, card.design_high) == ((0.6,) * 4, (1.4,) * 4)


def test_it_is_small(home: Path) -> None:
    assert sum(path.stat().st_size for path in home.iterdir()) < 10_000_000


def test_provenance_says_how_to_make_it_again(provenance: dict, generalist: Policy) -> None:
    assert provenance["commands"][0].startswith("locorl train")
    commands = " ".join(provenance["commands"])
    stages = [
        (stage, from_dict(TrainConfig, {k: v for k, v in stage["config"].items() if k != "robot"}))
        for stage in provenance["stages"]
    ]
    assert stages
    for stage, config in stages:
        assert stage["folder"] in commands
        assert f"--iterations {config.iterations} --seed {config.seed}" in commands
        assert re.fullmatch(r"[0-9a-f]{7,40}", stage["commit"])
        assert config.samples_per_iteration * config.iterations == stage["samples"]
    last = stages[-1][1]
    assert last.task == generalist.card.task
    assert last.network == generalist.card.network
    assert sum(stage["samples"] for stage, _ in stages) == provenance["samples"] == generalist.card.samples


def test_recorded_evaluation_meets_the_target(provenance: dict, home: Path) -> None:
    summary = provenance["evaluation"]["summary"]
    assert provenance["evaluation"]["command"].startswith("locorl evaluate")
    assert summary["robots"] == 100
    assert summary["survived"] >= 99
    assert summary["tracking_error"] <= 0.06
    recorded = json.loads((home / "evaluation.json").read_text())
    assert recorded["summary"] == summary
    errors = [robot["tracking_error"] for robot in recorded["robots"]]
    assert np.mean(errors) == pytest.approx(summary["tracking_error"])


def test_it_walks_on_bodies_drawn_now(generalist: Policy, go2: BodyFactory) -> None:
    bodies = sample_designs(go2, 12, np.random.default_rng(20_260))
    protocol = EvalConfig(seconds=6.0, vx=(0.6, 0.6), settle=2.0, seed=11)
    result = evaluate(generalist, go2, bodies, generalist.card.task, protocol)
    assert result.survived.all()
    assert result.tracking_error.mean() < 0.08
    assert result.distance.min() > 0.8 * 0.6 * 6.0


def test_unknown_robot_names_what_ships() -> None:
    with pytest.raises(FileNotFoundError, match=r"'spot'.*go2-flat.*--from-scratch"):
        shipped_policy("spot")
