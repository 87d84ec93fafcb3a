"""What looks on at a training: TensorBoard and films. It changes nothing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from locorl import Trainer, checkpoint, make_task
from locorl.play.errors import PlayError
from locorl.play.renderer import gl_context
from locorl.training.films import Films
from locorl.training.metrics import read_metrics
from locorl.training.tensorboard import TensorBoard


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Every scalar in the event files of `folder`, by TensorBoard's own reader: tag -> (step, value)."""
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    # all that is there, and nothing thinned out
    events = reader.EventAccumulator(str(folder), size_guidance={reader.SCALARS: 0}, purge_orphaned_data=False)
    events.Reload()
    return {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def expected(path: Path) -> dict[str, list[tuple[int, float]]]:
    rows = read_metrics(path)
    return {
        name: [(int(row["iteration"]), float(np.float32(row[name]))) for row in rows]
        for name in rows[0]
        if name != "iteration"
    }


def test_tensorboard_shows_the_metrics(factory, tiny, tmp_path):
    pytest.importorskip("tensorboard")
    Trainer(factory, tiny, tmp_path, threads=1).run(quiet=True, watchers=[TensorBoard(tmp_path / "tensorboard")])
    found = scalars(tmp_path / "tensorboard")
    assert found == expected(tmp_path / "metrics.jsonl")
    assert [step for step, _ in found["reward"]] == [1, 2, 3, 4]


def test_a_resumed_run_writes_no_iteration_twice(factory, tiny, tmp_path):
    pytest.importorskip("tensorboard")

    class Killed(BaseException):
        pass

    class Killer:
        def begin(self, rows) -> None: ...

        def end(self) -> None: ...

        def watch(self, trainer, row) -> None:
            if trainer.iteration == 3:
                raise Killed

    board = tmp_path / "tensorboard"
    with pytest.raises(Killed):
        Trainer(factory, tiny, tmp_path, threads=1).run(quiet=True, watchers=[TensorBoard(board), Killer()])
    assert [step for step, _ in scalars(board)["reward"]] == [1, 2, 3]
    resumed = Trainer(factory, tiny, tmp_path, threads=1)
    assert resumed.iteration == 2
    resumed.run(quiet=True, watchers=[TensorBoard(board)])
    assert scalars(board) == expected(tmp_path / "metrics.jsonl")
    assert len(scalars(board)["reward"]) == 4
    assert len(list(board.iterdir())) == 1


def test_a_run_that_gets_tensorboard_late_has_all_iterations_there(factory, tiny, tmp_path):
    pytest.importorskip("tensorboard")
    Trainer(factory, replace(tiny, iterations=2), tmp_path, threads=1).run(quiet=True)
    Trainer(factory, tiny, tmp_path, threads=1).run(quiet=True, watchers=[TensorBoard(tmp_path / "board")])
    assert scalars(tmp_path / "board") == expected(tmp_path / "metrics.jsonl")
    assert len(scalars(tmp_path / "board")["kl"]) == 4


def test_without_tensorboard_its_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(LookupError, match=r"pip install 'legged-locorl\[tensorboard\]'"):
        TensorBoard(tmp_path)


@pytest.fixture
def opengl(monkeypatch):
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        gl_context(64, 64).free()
    except PlayError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("task", ["locomotion-flat", pytest.param("parkour-stones", marks=pytest.mark.slow)])
def test_films_change_nothing_in_the_training(factory, tiny, tmp_path, opengl, task):
    imageio = pytest.importorskip("imageio.v3")
    config = replace(tiny, task=make_task(task))
    for name in ("without", "with"):
        watchers = [Films(tmp_path / "films", 2, seconds=0.04)] if name == "with" else []
        Trainer(factory, config, tmp_path / name, threads=1).run(quiet=True, watchers=watchers)
    ends = [checkpoint.load(tmp_path / name / "checkpoint.pt") for name in ("without", "with")]
    for part in ("model", "ppo", "env", "torch_generator"):
        torch.testing.assert_close(ends[0][part], ends[1][part], rtol=0, atol=0)
    assert sorted(path.name for path in (tmp_path / "films").iterdir()) == ["000002.mp4", "000004.mp4"]
    frames = imageio.imread(tmp_path / "films" / "000004.mp4")
    assert frames.shape == (2, 270, 640, 3)
    assert all(pane.std() > 5.0 for pane in (frames[:, :, :320], frames[:, :, 320:]))  # two robots, no blanks


def test_films_that_cannot_be_made_are_refused_before_the_training(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="at least one iteration between films, got -1"):
        Films(tmp_path, -1)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(PlayError, match=r"imageio_ffmpeg: pip install 'legged-locorl\[play\]'"):
        Films(tmp_path, 1)
