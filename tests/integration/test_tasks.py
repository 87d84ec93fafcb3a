"""What a run's task stands for: ground, generalist, robot, student."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from locorl import SimulatorConfig, load_policy, make_task

from legged_codesign.commands.run import Run
from legged_codesign.presets import on_simulator, preset
from legged_codesign.pretrain import shipped_generalist
from legged_codesign.robots import BodyConfig, body_factory
from legged_codesign.tasks import RUN_TASKS, find_task, pretraining_task, searched_task

PRESETS = ("smoke", "laptop", "workstation", "paper")


@pytest.mark.parametrize("task", RUN_TASKS)
def test_a_generalist_ships_for_every_task_and_the_papers_robot(task) -> None:
    """Bodies of the search walk on the task's own ground alone, observed as the generalist has learnt it."""
    config = preset("laptop", "return", task)
    policy = load_policy(shipped_generalist(config))
    assert policy.card.robot == config.robot == ("go2" if "jump" not in task and task != "stones" else "lite3")
    searched = searched_task(task, policy.card.task)
    assert set(searched.terrain.kinds) == set(make_task(find_task(task).task).terrain.kinds)
    assert searched.interface == policy.card.task.interface


@pytest.mark.parametrize("task", RUN_TASKS)
@pytest.mark.parametrize("of", ["laptop", "paper"])
def test_a_generalist_has_seen_the_ground_that_it_is_searched_for(task, of) -> None:
    trained = pretraining_task(task, of)
    wanted = make_task(find_task(task).task, of).terrain.kinds
    assert set(wanted) <= set(trained.terrain.kinds)
    searched = searched_task(task, trained)
    assert set(searched.terrain.kinds) == set(wanted)
    assert (searched.reward, searched.command, searched.goals) == (trained.reward, trained.command, trained.goals)


def test_flat_ground_stays_the_generalists_own_task() -> None:
    """Bit by bit: what the shipped policy was trained on, terrain map and all."""
    task = load_policy(shipped_generalist(preset("laptop"))).card.task
    assert searched_task("flat", task) is task


def test_unknown_task_names_the_others() -> None:
    with pytest.raises(ValueError, match=r"'moon'.*flat, steps, hills"):
        find_task("moon")


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("task", RUN_TASKS)
def test_presets_have_a_student_that_can_know_the_way(name, task) -> None:
    config = preset(name, "return", task)
    parkour = task in ("highjump", "longjump", "stones")
    assert config.distil.depth == (parkour or name == "paper")
    assert config.task == task


def test_paper_is_section_iv() -> None:
    for task in ("steps", "hills", "highjump", "longjump"):
        paper = preset("paper", "return", task)
        assert (paper.pretrain.iterations, paper.search.trials, paper.finetune.iterations) == (6000, 30, 400)
        assert paper.finetune.iterations / paper.pretrain.iterations == pytest.approx(0.0667, abs=1e-4)
        assert paper.pretrain.ppo.gamma_reg == paper.finetune.ppo.gamma_reg == 0.98
        assert paper.search.repeats == 3
        assert paper.pretrain.task.physics.control_dt == pytest.approx(1 / 50)
        assert paper.from_scratch
        factory = body_factory(paper.robot)
        # IV-A1 and IV-A2
        assert (factory.drive.kp, factory.drive.kd) == (40.0, 0.7)
        assert factory.space.low.tolist() == [0.6] * 4
        assert factory.space.high.tolist() == [1.4] * 4


# ---------------------------------------------------------------- options


def test_hardware_is_the_papers_search_on_hardware() -> None:
    config = Run(task="slope", hardware=True).config()
    assert config.bounds == (("front_shank", 1.0, 1.4), ("hind_shank", 1.0, 1.4))
    assert config.fixed == (("front_thigh", 1.0), ("hind_thigh", 1.0))


def test_student_options() -> None:
    assert Run().config().distil.adapt is None
    adapted = Run(student="adapted").config().distil
    assert adapted.adapt is not None
    assert not adapted.depth
    assert Run(student="plain", task="hills").config().distil.adapt is None
    for preset_name, task in (("laptop", "highjump"), ("paper", "hills"), ("paper", "steps")):
        assert Run(preset=preset_name, student="depth", task=task).config().distil.depth


@pytest.mark.parametrize("task", ["flat", "hills", "steps", "slope"])
@pytest.mark.parametrize("size", ["smoke", "laptop", "workstation"])
def test_no_student_looks_for_a_way_that_its_teacher_is_not_told(size: str, task: str) -> None:
    words = rf"task '{task}'.*told no way to go.*--student adapted, a course such as --task highjump, or --preset paper"
    with pytest.raises(ValueError, match=words):
        Run(preset=size, task=task, student="depth").config()  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("student", ["plain", "adapted"])
def test_no_student_is_blind_where_its_teacher_is_told_the_way(student: str) -> None:
    for size, task in (("laptop", "longjump"), ("paper", "hills")):
        with pytest.raises(ValueError, match=rf"task '{task}'.*must see; take --student depth, or leave --student out"):
            Run(preset=size, task=task, student=student).config()  # pyright: ignore[reportArgumentType]


def test_another_simulator_reaches_every_training() -> None:
    warp = SimulatorConfig("warp", "cuda")
    paper = on_simulator(preset("paper", "return", "steps"), warp)
    assert Run(preset="paper", task="steps", objective="return", simulator="warp").config() == paper
    assert paper.distil.adapt is not None
    assert {
        paper.pretrain.simulator,
        paper.finetune.simulator,
        paper.distil.simulator,
        paper.distil.adapt.finetune.simulator,
    } == {warp}


def test_wider_space_and_gains_reach_the_bodies() -> None:
    config = Run(space="wide", gains="stance", from_scratch=True).config()
    factory = body_factory(config.robot, config.bodies)
    assert "trunk_length" in factory.space.names
    assert factory.rule == "paper"
    longer = np.where(np.array(factory.space.names) == "front_shank", 1.2, factory.space.nominal)
    gains = factory.batch(np.stack((factory.space.nominal, longer))).kp
    assert (gains[1] > gains[0]).all(), "longer legs carry more torque for the same weight"


def test_a_robot_with_rules_of_its_own_keeps_them() -> None:
    with pytest.raises(LookupError, match="no robot 'spot'"):
        body_factory("spot", BodyConfig(space="wide"))


@pytest.mark.parametrize(
    ("option", "value", "words"), [("--space", "per-leg", "design parameters"), ("--gains", "stance", "constant gains")]
)
def test_other_bodies_need_a_generalist_of_their_own(codesign, tmp_path, option, value, words) -> None:
    code, output = codesign("run", option, value, "--folder", tmp_path / "run")
    assert code == 1
    assert words in output
    assert "--from-scratch" in output
    assert not (tmp_path / "run").exists()


def test_seeds_change_the_pre_training_too() -> None:
    first, second = (Run(from_scratch=True, seed=seed).config() for seed in (1, 2))
    assert replace(first, seed=2, pretrain=replace(first.pretrain, seed=2)) == second
