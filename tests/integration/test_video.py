"""The film of a run, with OpenGL and without."""

from __future__ import annotations

import io

import imageio_ffmpeg
import numpy as np
import pytest
from deploy.logs.reading import read_log
from deploy.page.video import FPS, HEIGHT, WIDTH
from matplotlib.image import imread

from legged_codesign.report import video


@pytest.fixture(scope="module")
def log(finished):
    return read_log(finished.folder / "rollout.mcap")


def test_without_opengl_a_stick_figure_walks(log, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "no-such-backend")
    out = tmp_path / "walk.mp4"
    assert video.film(log, out) == "drawn as stick figures, since no OpenGL was found"
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(out))
    under_control = log.trace.time[log.trace.mode == "policy"]
    shown = min(video.SECONDS, log.trace.time[-1] - under_control[0])
    assert frames == len(np.arange(0.0, shown, 1.0 / FPS))
    assert seconds == pytest.approx(frames / FPS, abs=0.1)
    still = imread(io.BytesIO(video.still_frame(out)))
    assert still.shape[:2] == (HEIGHT, WIDTH)
    assert (still[..., :3].sum(axis=2) < 1.2).any()  # dark lines on white


def test_stick_figure_shows_four_legs_that_move(log):
    frames = list(video.stick_frames(log))
    assert frames[0].shape == (HEIGHT, WIDTH, 3)
    dark = (frames[0].sum(axis=2) < 300).mean()
    assert 0.001 < dark < 0.2  # lines on white
    assert any((frame != frames[0]).any() for frame in frames[1:])
