"""Each task of the paper through the whole loop in the paper's own configuration, with few robots and 2 iterations."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import deploy
import pytest
from locorl import FinetuneConfig, SimulatorConfig, load_policy
from rich.console import Console

from legged_codesign.config import RunConfig, ScreenConfig, SearchConfig
from legged_codesign.pipeline import run
from legged_codesign.presets import on_simulator, preset
from legged_codesign.run_folder import Files
from legged_codesign.tasks import TaskName

ROBOTS = 8


def small(task: TaskName) -> RunConfig:
    """The paper's run with everything as it is but how much there is of it."""
    paper = preset("paper", "return", task)
    assert paper.distil.adapt is not None

    def few(tune: FinetuneConfig) -> FinetuneConfig:
        return replace(tune, num_envs=ROBOTS, iterations=2)

    distil = replace(
        paper.distil,
        adapt=replace(paper.distil.adapt, finetune=few(paper.distil.adapt.finetune)),
        robots=ROBOTS,
        vision=replace(paper.distil.vision, iterations=2, rollout_steps=10, batch=4),
        judged=replace(paper.distil.judged, seconds=1.0, settle=0.2, robots_per_body=ROBOTS),
    )
    return replace(
        paper,
        pretrain=replace(paper.pretrain, num_envs=ROBOTS, iterations=2),
        screen=ScreenConfig(bodies=4, robots=1, seconds=0.4, promote=0),
        search=SearchConfig(trials=3, initial=2, confirm=1, repeats=2),
        finetune=few(paper.finetune),
        score=replace(paper.score, seconds=1.0, robots=ROBOTS),
        distil=distil,
        deploy=replace(paper.deploy, seconds=1.0),
    )


def finished(config: RunConfig, folder: Path) -> Files:
    text = io.StringIO()
    files = run(config, folder, Console(file=text, width=200))
    assert "9/10 deploy" in text.getvalue()
    return files


@pytest.mark.slow
@pytest.mark.parametrize("task", ["steps", "hills", "slope", "highjump", "longjump"])
def test_the_whole_loop(task: TaskName, tmp_path: Path) -> None:
    files = finished(small(task), tmp_path / task)
    card = load_policy(files.generalist).card
    assert card.robot == ("lite3" if "jump" in task else "go2")
    assert (card.task.observation.history, card.network.actor) == (10, (512, 256, 128))
    bundle = deploy.load_bundle(files.bundle)
    assert bundle.depth is not None, "the paper's student sees"
    assert (bundle.depth.optics.rows, bundle.depth.optics.columns) == (58, 87)
    trials = json.loads(files.trials.read_text())
    assert [trial["trial"] for trial in trials] == [0, 1, 2]
    assert trials[0]["params"] == dict.fromkeys(("front_thigh", "front_shank", "hind_thigh", "hind_shank"), 1.0)
    means = json.loads((files.student / "comparison.json").read_text())["means"]
    assert set(means) == {"teacher", "teacher on history latent", "student"}
    assert files.report.stat().st_size > 100_000


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_whole_loop_on_warp(tmp_path: Path) -> None:
    """Warp's CPU device stands in for a GPU."""
    pytest.importorskip("mujoco_warp")
    config = on_simulator(small("slope"), SimulatorConfig("warp", "cpu"))
    files = finished(config, tmp_path / "warp")
    assert load_policy(files.teacher).card.robot == "go2"
