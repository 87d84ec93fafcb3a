"""The command `locorl train`, through `main()`."""

from __future__ import annotations

import re
import sys

import locorl.cli
import locorl.providers
import pytest
from locorl import DivergedError, Trainer, load_policy, make_task
from locorl.training.metrics import read_metrics
from locorl_box import BoxQuadruped

NETWORK = ["--network.actor", "16", "--network.critic", "16", "--network.encoder", "8", "--network.latent", "4"]
PPO = ["--ppo.steps", "6", "--ppo.epochs", "1", "--ppo.minibatches", "2"]
TRAIN = ["--robot", "box", "--num-envs", "8", *PPO, *NETWORK]


class EntryPoint:
    """Stands in for an installed package that makes a robot."""

    name = "box"

    def load(self):
        return BoxQuadruped


@pytest.fixture
def locorl_train(monkeypatch, capsys):
    """Runs the command and returns what it printed."""
    monkeypatch.setattr(
        locorl.providers, "entry_points", lambda group: [EntryPoint()] if group == "legged.bodies" else []
    )

    def run(*arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", ["locorl", "train", *map(str, arguments)])
        capsys.readouterr()
        try:
            locorl.cli.main()
        except SystemExit as end:
            captured = capsys.readouterr()
            return f"status {end.code}: " + " ".join((captured.out + captured.err).split())
        return " ".join(capsys.readouterr().out.split())

    return run


def test_the_cost_is_told_before_the_start(locorl_train, tmp_path):
    out = locorl_train(tmp_path, "--iterations", 2, *TRAIN)
    cost = r"2 iterations = 0\.0 M environment steps -> .* less than a minute at [\d.]+ k steps/s, [\d.]+ GB of memory"
    assert re.search(cost, out)
    assert re.search(r"from iteration 2: less than a minute", locorl_train(tmp_path, "--iterations", 3, *TRAIN))
    assert "nothing is left to do" in locorl_train(tmp_path, "--iterations", 3, *TRAIN)
    assert [row["iteration"] for row in read_metrics(tmp_path / "metrics.jsonl")] == [1, 2, 3]


def test_task_regulariser_mirror_and_tensorboard_by_name(locorl_train, tmp_path):
    pytest.importorskip("tensorboard")
    what = ["--task", "locomotion-hills", "--regulariser", "activation", "--mirror", "--tensorboard"]
    locorl_train(tmp_path, "--iterations", 1, *what, *TRAIN)
    assert load_policy(tmp_path / "policy.pt").card.task == make_task("locomotion-hills")
    out = locorl_train(tmp_path, "--iterations", 2, "--task", "locomotion-hills", *TRAIN)
    assert "ppo.mirror: True -> False" in out
    assert "ppo.regulariser: activation -> discount" in out
    assert len(list((tmp_path / "tensorboard").glob("events.out.tfevents.*"))) == 1


def test_a_policy_to_start_from(locorl_train, tmp_path):
    locorl_train(tmp_path / "first", "--iterations", 1, *TRAIN)
    start = ["--start", tmp_path / "first" / "policy.pt"]
    locorl_train(tmp_path / "second", "--iterations", 2, *start, *TRAIN)
    assert load_policy(tmp_path / "second" / "policy.pt").card.samples == 3 * 48
    out = locorl_train(tmp_path / "second", "--iterations", 2, *TRAIN)
    assert "status 1: error: " in out
    assert "another starting policy" in out


def test_a_fault_is_repeated(locorl_train, tmp_path, monkeypatch):
    locorl_train(tmp_path, "--iterations", 1, *TRAIN)
    update = locorl.PPO.update

    def fail(ppo) -> None:
        raise DivergedError("NaN somewhere", "update")

    def only_the_second(ppo):
        return fail(ppo) if ppo.rollout.steps == 6 and ppo.iteration == 1 else update(ppo)

    monkeypatch.setattr(locorl.PPO, "update", only_the_second)
    out = locorl_train(tmp_path, "--iterations", 2, *TRAIN)
    assert "error: iteration 2: NaN somewhere" in out
    assert f"locorl train {tmp_path} --replay" in out
    assert "status 1: error: iteration 2: NaN somewhere" in locorl_train(tmp_path, "--replay", "--robot", "box")
    monkeypatch.undo()


def test_a_fault_that_is_mended(locorl_train, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(locorl.PPO, "update", lambda ppo: (_ for _ in ()).throw(DivergedError("NaN somewhere")))
        trainer = Trainer(BoxQuadruped(), locorl.TrainConfig(num_envs=8, ppo=locorl.PPOConfig(steps=4)), tmp_path)
        with pytest.raises(DivergedError):
            trainer.run(quiet=True)
    assert "this time the iteration went well" in locorl_train(tmp_path, "--replay", "--robot", "box")


def test_a_trial_that_diverges_leaves_the_fault_to_the_run(locorl_train, tmp_path):
    wild = ["--ppo.learning-rate", 1e20, "--ppo.max-learning-rate", 1e20]
    out = locorl_train(tmp_path, "--iterations", 5, *TRAIN, *wild)
    assert "the cost is not known: " in out
    assert "status 1: " in out
    assert "--replay" in out
    assert (tmp_path / "fault.pt").is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--films", -2], "at least one iteration between films, got -2"),
        (["--regulariser", "l2"], "invalid choice"),
        (["--replay"], "no checkpoint at"),
    ],
)
def test_what_cannot_be_trained_is_refused_before_anything_is_written(locorl_train, tmp_path, options, message):
    out = locorl_train(tmp_path / "run", *TRAIN, *options)
    assert re.match(r"status [12]: ", out)
    assert message in re.sub(r" │ (│ )?", " ", out)
    assert not (tmp_path / "run").exists()
