"""The video of a run, with OpenGL and without."""

from __future__ import annotations

import imageio_ffmpeg
import numpy as np
import pytest
from legged_codesign.report.motion import load_scene, read_motion

from legged_codesign.report import video


@pytest.fixture
def sources(finished):
    return finished.folder / "bundle" / "scene.xml", finished.folder / "rollout.mcap"


def test_without_opengl_a_stick_figure_walks(sources, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "no-such-backend")
    out = tmp_path / "walk.mp4"
    assert video.make_video(*sources, out) == "drawn as stick figures, since no OpenGL was found"
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(out))
    motion = read_motion(sources[1])
    assert frames == len(np.arange(0.0, min(video.SECONDS, motion.time[-1]), 1.0 / video.FPS))
    assert seconds == pytest.approx(frames / video.FPS, abs=0.1)


def test_stick_figure_shows_four_legs_that_move(sources):
    frames = list(video.stick_frames(load_scene(sources[0]), read_motion(sources[1])))
    assert frames[0].shape == (video.HEIGHT, video.WIDTH, 3)
    dark = (frames[0].sum(axis=2) < 300).mean()
    assert 0.001 < dark < 0.2  # lines on white
    assert any((frame != frames[0]).any() for frame in frames[1:])
