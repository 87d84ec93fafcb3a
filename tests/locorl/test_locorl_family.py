"""Policies remember the rules and gains of their bodies and refuse others, unless they are told to go on."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import locorl.cli
import locorl.providers
import numpy as np
import pytest
import torch
from locorl import CheckpointError, LeggedEnv, Policy, TaskConfig, Trainer, checkpoint, finetune, load_policy
from locorl.adapters.student import StudentEnv
from locorl.bodies.family import BodyFamily
from locorl.play.actors import check_fits
from locorl.training.finetune import FinetuneConfig
from locorl_box import KD, KP, Bodies, BoxQuadruped

NOMINAL = np.ones((1, 4))


class Ruled(BoxQuadruped):
    """The box robot, which says by which rules it is scaled and driven, and with other gains."""

    def __init__(self, scaling: str = "paper", gains: str = "none", kp: float = KP, kd: float = KD) -> None:
        super().__init__()
        self.rules = {"scaling": scaling, "gains": gains}
        self.kp, self.kd = kp, kd

    def batch(self, designs, scene=None) -> Bodies:
        bodies = super().batch(designs, scene)
        return replace(bodies, kp=np.full_like(bodies.kp, self.kp), kd=np.full_like(bodies.kd, self.kd))


OTHERS = [
    (Ruled("stretch"), "scaling: paper in its training, stretch here"),
    (Ruled(gains="mass"), "gains: none in its training, mass here"),
    (Ruled(kp=55.0), "kp: 40 in its training, 55 here"),
    (Ruled(kd=1.5), r"kd: 0\.7 in its training, 1\.5 here"),
]
other = pytest.mark.parametrize(("factory", "words"), OTHERS, ids=["scaling", "gains", "kp", "kd"])


@pytest.fixture(scope="module")
def policy(tiny) -> Policy:
    """Untrained, for robots scaled by Table II."""
    return Trainer(Ruled(), tiny, threads=1).policy()


@pytest.fixture(scope="module")
def file(policy, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "policy.pt"
    policy.save(path)
    return path


@pytest.fixture(scope="module")
def older(file, tmp_path_factory) -> Path:
    """The same file in format 3."""
    content = checkpoint.load(file)
    card = {name: value for name, value in content["card"].items() if name != "family"}
    path = tmp_path_factory.mktemp("older") / "policy.pt"
    checkpoint.save(path, {**content, "card_format": 3, "card": card})
    return path


def test_the_file_tells_rules_and_gains(file):
    content = checkpoint.load(file)
    assert content["card_format"] == 4
    assert content["card"]["family"] == {
        "rules": {"scaling": "paper", "gains": "none"},
        "kp": [40.0] * 12,
        "kd": [0.7] * 12,
    }
    assert load_policy(file).card.family == BodyFamily.of(Ruled())


@other
def test_other_bodies_are_refused_wherever_a_policy_starts(file, tiny, factory, words):
    policy = load_policy(file)
    refused = rf"other bodies of 'box' than these \({words}\): .*--adopt"
    with pytest.raises(ValueError, match=refused):
        finetune(file, factory, NOMINAL[0], FinetuneConfig(num_envs=2, iterations=1), seed=0, threads=1)
    with pytest.raises(ValueError, match=refused):
        Trainer(factory, tiny, start=policy, threads=1)
    with pytest.raises(ValueError, match=refused):
        check_fits(policy, LeggedEnv(factory, NOMINAL, TaskConfig(), threads=1))
    with pytest.raises(ValueError, match=rf"\({words}\): take another robot"):
        policy.check_bodies(factory, "take another robot")
    policy.check_bodies(Ruled())


def test_all_that_differs_is_named_and_rounding_does_not_differ(policy):
    with pytest.raises(ValueError, match=r"\(scaling: paper .* lumped here; kp: 40 .* 30 here; kd: 0\.7 .* 2 here\)"):
        policy.check_bodies(Ruled("lumped", kp=30.0, kd=2.0))
    policy.check_bodies(Ruled(kp=40.0 * (1 + 1e-9), kd=0.7 * (1 - 1e-9)))
    knees = BodyFamily.of(Ruled())
    knees = replace(knees, kp=(40.0, 40.0, 55.0) * 4)
    assert BodyFamily.of(Ruled()).differences(knees) == [
        "kp: 40 in its training, (40, 40, 55, 40, 40, 55, 40, 40, 55, 40, 40, 55) here"
    ]


def test_a_factory_that_tells_no_rules_is_known_by_its_gains(policy):
    policy.check_bodies(BoxQuadruped())
    assert BodyFamily.of(BoxQuadruped()).rules == {}
    with pytest.raises(ValueError, match="cannot control 'crate'"):
        policy.check_bodies(BoxQuadruped("crate"))


def test_a_file_of_format_3_holds_the_same_policy(file, older):
    new, old = load_policy(file), load_policy(older)
    assert old.card == replace(new.card, family=None)
    assert all(torch.equal(values, old.model.state_dict()[name]) for name, values in new.model.state_dict().items())


@other
def test_a_file_of_format_3_is_checked_for_nothing_that_it_does_not_say(older, factory, words):
    old = load_policy(older)
    assert old.card.family is None
    old.check_bodies(factory)
    check_fits(old, LeggedEnv(factory, NOMINAL, TaskConfig(), threads=1))
    tuned = finetune(older, factory, NOMINAL[0], FinetuneConfig(num_envs=2, iterations=1), seed=0, threads=1)
    assert tuned.policy.card.family == BodyFamily.of(factory)  # it is known from here on


def test_a_policy_that_is_adopted_goes_on_with_other_bodies(policy, tiny):
    stiff = Ruled(kp=55.0)
    adopted = policy.adopted(stiff)
    adopted.check_bodies(stiff)
    assert Trainer(stiff, tiny, start=adopted, threads=1).policy().card.family == BodyFamily.of(stiff)
    assert policy.card.family == BodyFamily.of(Ruled())
    with pytest.raises(ValueError, match="kp: 55 in its training, 40 here"):
        adopted.check_bodies(Ruled())


def test_a_training_goes_on_with_the_same_bodies_alone(tiny, tmp_path):
    short = replace(tiny, iterations=2)
    Trainer(Ruled(), short, tmp_path, threads=1).run(quiet=True)
    with pytest.raises(CheckpointError, match=r"another robot(.|\n)*kp: 40 in its training, 55 here"):
        Trainer(Ruled(kp=55.0), tiny, tmp_path, threads=1)
    for same in (Ruled(), Ruled(kp=KP * (1 + 1e-12))):  # as another machine would size it
        assert Trainer(same, tiny, tmp_path, threads=1).iteration == 2
    content = checkpoint.load(tmp_path / "checkpoint.pt")
    del content["card"]["family"]  # begun by an earlier version
    checkpoint.save(tmp_path / "checkpoint.pt", {**content, "card_format": 3})
    assert Trainer(Ruled(), tiny, tmp_path, threads=1).iteration == 2


def test_students_and_teachers_compare_families(policy, older):
    def here(factory):
        return StudentEnv(LeggedEnv(factory, NOMINAL, TaskConfig(), threads=1)).signature

    assert {name: policy.signature[name] for name in here(Ruled())} == here(Ruled())
    assert here(Ruled("stretch", kp=55.0)) == {**policy.signature, "scaling": "stretch", "kp": "55"}
    assert not {"scaling", "gains", "kp", "kd"} & set(load_policy(older).signature)


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys):
    """The `locorl` command with a stiff robot installed; gives its output."""

    class EntryPoint:
        name = "box"

        def load(self):
            return lambda: Ruled(kp=55.0)

    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: [EntryPoint()])

    def run(*arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", ["locorl", *map(str, arguments), "--robot", "box"])
        locorl.cli.main()
        return capsys.readouterr().out

    return run


SHORT = ("--evaluation.seconds", 0.4, "--evaluation.settle", 0.1)
TINY = ("--config.num-envs", 4, "--config.iterations", 1, "--config.ppo.steps", 4)
PPO = ("--ppo.steps", 6, "--ppo.epochs", 1, "--ppo.minibatches", 2, "--num-envs", 8, "--iterations", 1)


@pytest.mark.parametrize("name", ["evaluate", "finetune", "train", "play"])
def test_commands_refuse_other_gains_and_go_on_if_told_to(command, capsys, monkeypatch, file, tmp_path, name):
    arguments = {
        "evaluate": ("evaluate", file, "--bodies", 1, *SHORT),
        "finetune": ("finetune", file, tmp_path, "--design", 1, 1, 1, 1, *TINY, *SHORT),
        "train": ("train", tmp_path, "--start", file, *PPO),
        "play": ("play", "--policy", file, "-o", tmp_path / "film.mp4"),
    }[name]
    filmed = []
    monkeypatch.setattr("locorl.commands.play.write_video", lambda session, *rest: filmed.append(session))
    with pytest.raises(SystemExit, match="1"):
        command(*arguments)
    said = " ".join(capsys.readouterr().out.split())
    assert "kp: 40 in its training, 55 here" in said
    assert "--adopt" in said
    assert not filmed
    command(*arguments, "--adopt")
    if name in ("finetune", "train"):
        assert load_policy(tmp_path / "policy.pt").card.family == BodyFamily.of(Ruled(kp=55.0))
    assert bool(filmed) == (name == "play")
