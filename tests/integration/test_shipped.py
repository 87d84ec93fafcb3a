"""What the project ships walks, and says where it came from."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from locorl import EvalConfig, Policy, evaluate, load_policy, sample_designs
from locorl.config import from_dict
from locorl.training.trainer import TrainConfig
from morphgen import BodyFactory, go2, lite3

from legged_codesign.pretrained import shipped_policy

ROBOTS = {"go2": go2, "lite3": lite3}
WALKERS = {"go2-flat": (0.99, 0.06), "go2-rough": (0.85, 0.15)}  # hills and stairs of up to 11 cm
"""Share that must survive, and highest mean tracking error, m/s."""
SHIPPED = sorted(path.parent.name for path in shipped_policy("go2").parents[1].glob("*/policy.pt"))


@pytest.fixture(scope="module", params=SHIPPED)
def home(request: pytest.FixtureRequest) -> Path:
    robot, task = request.param.split("-")
    return shipped_policy(robot, task).parent


@pytest.fixture(scope="module")
def robot(home: Path) -> BodyFactory:
    return ROBOTS[home.name.split("-")[0]]()


@pytest.fixture(scope="module")
def generalist(home: Path) -> Policy:
    return load_policy(home / "policy.pt")


@pytest.fixture(scope="module")
def provenance(home: Path) -> dict:
    return json.loads((home / "provenance.json").read_text())


def test_generalist_is_for_the_whole_design_space(generalist: Policy, robot: BodyFactory) -> None:
    generalist.check_bodies(robot)
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
    recorded = json.loads((home / "evaluation.json").read_text())
    assert recorded["summary"] == summary
    assert len({tuple(robot["design"]) for robot in recorded["robots"]}) == 100
    errors = [robot["tracking_error"] for robot in recorded["robots"]]
    assert np.mean(errors) == pytest.approx(summary["tracking_error"])
    if home.name in WALKERS:
        survived, error = WALKERS[home.name]
        assert summary["survived"] >= survived * summary["robots"]
        assert summary["tracking_error"] <= error
    else:
        # every level of the course, the hardest of which it need not pass
        assert summary["succeeded"] >= 0.5 * summary["robots"]


def test_it_walks_on_bodies_drawn_now(generalist: Policy, robot: BodyFactory) -> None:
    bodies = sample_designs(robot, 12, np.random.default_rng(20_260))
    task = generalist.card.task
    level = 0 if task.goals is not None else None
    protocol = EvalConfig(seconds=6.0, vx=(0.6, 0.6), settle=2.0, seed=11, level=level)
    result = evaluate(generalist, robot, bodies, task, protocol)
    assert result.survived.all()
    assert result.tracking_error.mean() < (0.08 if task.goals is None else 0.2)
    assert result.distance.min() > 0.8 * 0.6 * 6.0


def test_unknown_robot_names_what_ships() -> None:
    with pytest.raises(FileNotFoundError, match=r"'spot'.*go2-flat.*--from-scratch"):
        shipped_policy("spot")


def test_the_policy_acts_as_its_weights_say():
    path = shipped_policy("go2", "flat")
    policy = load_policy(path)
    torch.manual_seed(0)
    obs = {group: torch.randn(5, size) for group, size in policy.card.dims.items()}
    weights = torch.load(path, weights_only=True)["model"]

    def forward(network: str, x: torch.Tensor) -> torch.Tensor:
        numbers = sorted({int(name.split(".")[1]) for name in weights if name.startswith(f"{network}.")})
        for number in numbers:
            x = x @ weights[f"{network}.{number}.weight"].T + weights[f"{network}.{number}.bias"]
            x = x if number == numbers[-1] else torch.where(x > 0, x, x.exp() - 1)
        return x

    seen = torch.cat((obs["proprio"], obs["explicit"], forward("encoder", obs["implicit"])), dim=1)
    torch.testing.assert_close(policy.act(obs), forward("actor", seen))
