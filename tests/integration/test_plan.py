"""`codesign run --dry-run`: every number with its source, and nothing done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from locorl.config import to_dict
from rich.console import Console

from legged_codesign import RunConfig, pipeline
from legged_codesign.commands.run import Run
from legged_codesign.plan import settings
from legged_codesign.presets import preset
from legged_codesign.robots import body_factory
from legged_codesign.run_folder import Files


def sources(config) -> dict[str, tuple[object, str]]:
    return {each.name: (each.value, each.source) for each in settings(config, body_factory(config.robot))}


@pytest.mark.parametrize("task", ["steps", "hills", "slope", "highjump", "longjump"])
def test_the_papers_numbers_name_their_place(task) -> None:
    found = sources(preset("paper", "return", task))
    assert found["pretrain.iterations"] == (6000, "section IV-B4")
    assert found["finetune.iterations"] == (400, "section IV-B4")
    assert found["search.trials"] == (30, "section IV-A2")
    assert found["pretrain.ppo.gamma_reg"] == (0.98, "Table III")
    assert found["body.kp"] == (40.0, "section IV-A2")
    assert found["body.low"] == ([0.6] * 4, "section IV-A1")
    weights = {name: source for name, (_, source) in found.items() if name.startswith("pretrain.task.reward.")}
    assert len(weights) > 20
    assert set(weights.values()) == {"Table I"}


@pytest.mark.parametrize(
    ("task", "objective", "said"),
    [
        ("steps", "return", ("section IV-A2", "eq. 9")),
        ("slope", "energy", ("section IV-C", "eq. 10")),
        ("flat", "cost-of-transport", ("ours", "ours")),
        ("stones", "return", ("the authors' released code", "eq. 9")),
    ],
)
@pytest.mark.parametrize("name", ["paper", "laptop"])
def test_tasks_and_objectives_that_the_paper_lacks_are_ours(name, task, objective, said) -> None:
    found = sources(preset(name, objective, task))
    assert (found["task"][1], found["objective"][1]) == said
    if name == "paper":
        assert found["pretrain.task.terrain.kinds"][1] == said[0]


def test_the_papers_objective_is_its_return_unless_asked_otherwise() -> None:
    assert Run(preset="paper", task="steps").config() == preset("paper", "return", "steps")
    assert Run(preset="paper", task="steps", objective="energy").config().objective == "energy"
    assert Run().config().objective == "cost-of-transport"


@pytest.mark.parametrize("task", ["steps", "hills", "slope", "highjump", "longjump", "flat"])
def test_dry_run_of_each_task_of_the_paper(codesign, task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    code, output = codesign("run", "--preset", "paper", "--task", task, "--dry-run")
    assert code == 0, output
    for words in ("6000", "section IV-B4", "Table I", "eq. 9", "3 such runs", "lite3" if "jump" in task else "go2"):
        assert words in output


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({}, [("runs/paper-go2-steps-return/seed-0", 0), ("runs/paper-go2-steps-return/seed-1", 1)]),
        ({"seeds": (4,)}, [("runs/paper-go2-steps-return/seed-4", 4)]),
        ({"seed": 5}, [("runs/paper-go2-steps-return", 5)]),
    ],
)
def test_the_paper_is_run_three_times(options, wanted, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    def run(config: RunConfig, folder: Path, *_: object) -> Files:
        started.append((str(folder), config.seed))
        return Files(folder)

    monkeypatch.setattr(pipeline, "run", run)
    Run(preset="paper", task="steps", **options).run(Console(quiet=True))
    assert started[:2] == wanted
    assert len(started) == (1 if options else 3)


def test_what_differs_from_the_paper_says_so() -> None:
    found = sources(preset("laptop", "return", "steps"))
    assert found["finetune.iterations"] == (16, "ours; 400 by section IV-B4")
    assert found["pretrain.ppo.gamma_reg"] == (0.98, "Table III")
    assert found["pretrain.save_every"][1] == "ours"


def test_every_number_is_there() -> None:
    config = preset("paper", "energy", "highjump")
    text = json.dumps(to_dict(config))
    leaves = text.count(": ") - text.count(": {")
    listed = [each for each in settings(config, body_factory(config.robot)) if not each.name.startswith("body.")]
    # dictionaries within lists are shown whole
    nested = sum(str(each.value).count("': ") for each in listed)
    assert len(listed) + nested == leaves


@pytest.mark.slow
def test_dry_run_prints_and_does_nothing(codesign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    code, output = codesign("run", "--preset", "laptop", "--dry-run", "--folder", tmp_path / "run")
    assert code == 0
    assert "Table III" in output
    assert "GB of memory" in output
    assert "GB of disk" in output
    assert not (tmp_path / "run").exists()


def test_dry_run_refuses_what_a_run_would_refuse(codesign) -> None:
    code, output = codesign("run", "--dry-run", "--robot", "spot")
    assert code == 1
    assert "spot" in output


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--bounds front_shin=1:1.4", "front_shin"),
        ("--robot lite3 --task hills", "lite3"),
        ("--rule stretch", "'paper', not 'stretch'"),
        ("--task hills --student depth", "way"),
    ],
)
def test_dry_run_refuses_settings_that_do_not_fit(codesign, options: str, named: str) -> None:
    code, output = codesign("run", "--preset", "laptop", "--dry-run", *options.split())
    assert code == 1
    assert named in output


def test_default_is_no_dry_run() -> None:
    assert not Run().dry_run
