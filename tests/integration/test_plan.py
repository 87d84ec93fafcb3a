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
from legged_codesign.tasks import RUN_TASKS

TABLE_I = (
    *("linear_velocity_tracking", "collisions", "angular_velocity_tracking", "linear_velocity_penalty"),
    *("angular_velocity_penalty", "action_rate", "hip_position_penalty", "joint_acceleration"),
    *("joint_position_penalty", "torque_rate", "torque_penalty", "feet_air_time"),
    *("goal_tracking", "clearance", "orientation"),
)
"""The rows of both columns."""


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
    reward = {name.split(".")[-1]: said for name, said in found.items() if name.startswith("pretrain.task.reward.")}
    weights = [said for name, said in reward.items() if name in TABLE_I]
    assert len(weights) == len(TABLE_I)
    assert {source for _, source in weights} == {"Table I"}
    assert {value for value, _ in weights} >= {0.5, -0.05, -0.04, -2.5e-7, -1e-5}
    # with the paper's kernel these say nothing
    assert reward["linear_scale"][1] == reward["angular_scale"][1] == "ours"


IV_A1 = ([0.6, 1.4], "section IV-A1")
IV_C1 = {
    **dict.fromkeys(("front_thigh", "hind_thigh"), (1.0, "section IV-C1")),
    **dict.fromkeys(("front_shank", "hind_shank"), ([1.0, 1.4], "section IV-C1")),
}
BY_COMMAND = "the command; (0.6, 1.4) by section IV-A1"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, dict.fromkeys(IV_C1, IV_A1)),
        ({"hardware": True}, IV_C1),
        # on hardware there was a Go2
        ({"hardware": True, "robot": "lite3"}, {name: (value, BY_COMMAND) for name, (value, _) in IV_C1.items()}),
        (
            {"hardware": True, "bounds": ("front_shank=1:1.3",)},
            {**IV_C1, "front_shank": ([1.0, 1.3], BY_COMMAND)},
        ),
        (
            {"bounds": ("hind_shank=1:1.4", "hind_thigh=0.6:1.4"), "fix": ("front_thigh=1.1",)},
            {
                **dict.fromkeys(IV_C1, IV_A1),
                "hind_shank": IV_C1["hind_shank"],
                "front_thigh": (1.1, BY_COMMAND),
            },
        ),
    ],
)
def test_the_bounds_of_each_parameter_say_who_set_them(options, said) -> None:
    found = sources(Run(preset="paper", task="slope", **options).config())
    assert {name: found[f"search within.{name}"] for name in IV_C1} == said
    assert {"bounds", "fixed"}.isdisjoint(found)
    assert found["body.low"] == ([0.6] * 4, "section IV-A1")  # of the pre-training, whatever is searched


def test_bounds_of_parameters_that_the_paper_lacks_are_ours() -> None:
    config = Run(preset="paper", space="wide", bounds=("trunk_length=0.9:1.1",)).config()
    found = {each.name: each.source for each in settings(config, body_factory(config.robot, config.bodies))}
    assert found["search within.trunk_length"] == "the command"
    assert found["search within.hip_offset"] == "ours"
    assert found["search within.hind_shank"] == "section IV-A1"


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


def test_ground_of_the_pre_training_says_which_kinds_the_paper_has() -> None:
    kinds = {task: sources(preset("paper", "return", task))["pretrain.task.terrain.kinds"][1] for task in RUN_TASKS}
    assert kinds["steps"] == kinds["hills"] == "section IV-A2"
    assert kinds["slope"] == "section IV-A2; section IV-C"
    assert kinds["highjump"] == "section IV-A2; the authors' released code"  # tilted stones
    assert kinds["flat"] == "ours"


def test_numbers_that_no_reference_has_are_ours() -> None:
    """As legged_gym and Extreme Parkour are published."""
    found = {task: sources(preset("paper", "return", task)) for task in ("steps", "highjump")}
    for name in ("distil.robots", "pretrain.ppo.ppg.epochs", "pretrain.task.randomisation.reset_joint"):
        assert found["steps"][name][1] == "ours", name
    for name, task in (("command.heading_gain", "highjump"), ("randomisation.reset_yaw", "steps")):
        other = "steps" if task == "highjump" else "highjump"
        assert found[task][f"pretrain.task.{name}"][1] == "ours"
        assert "legged_gym" in found[other][f"pretrain.task.{name}"][1]


def test_choices_name_their_own_place() -> None:
    said = {name: sources(Run(preset="paper", search=name).config()) for name in ("hyperopt-tpe", "random")}
    assert said["hyperopt-tpe"]["search.method"][1] == "section IV-A2"
    assert said["random"]["search.method"][1] == "ours"
    costs = sources(preset("paper", "cost-of-transport", "steps"))
    assert costs["finetune.specific_power"] == (-2.0, "ours")
    stretched = Run(preset="paper", rule="stretch").config()
    listed = {each.name: each.source for each in settings(stretched, body_factory(stretched.robot, stretched.bodies))}
    assert listed["bodies.rule"] == "ours; paper by Table II"


def test_the_papers_objective_is_its_return_unless_asked_otherwise() -> None:
    assert Run(preset="paper", task="steps").config() == preset("paper", "return", "steps")
    assert Run(preset="paper", task="steps", objective="energy").config().objective == "energy"
    assert Run().config().objective == "cost-of-transport"


@pytest.mark.parametrize("task", ["steps", "hills", "slope", "highjump", "longjump", "flat", "stones"])
def test_dry_run_of_each_task_of_the_paper(codesign, task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    code, output = codesign("run", "--preset", "paper", "--task", task, "--dry-run")
    assert code == 0, output
    for words in ("6000", "section IV-B4", "Table I", "eq. 9", "3 such runs", preset("paper", None, task).robot):
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
    ours = ("body.", "search within.")
    listed = [each for each in settings(config, body_factory(config.robot)) if not each.name.startswith(ours)]
    leaves -= 2  # bounds and fixed are told parameter by parameter
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
