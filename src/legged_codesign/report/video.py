"""Video of a motion: MuJoCo's renderer where OpenGL is found, stick figures by matplotlib elsewhere.

Run as `python -m legged_codesign.report.video SCENE LOG OUT`, in a process of its own: a broken OpenGL
driver then takes down no run.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from legged_codesign.report.motion import Motion, load_scene, read_motion, set_pose
from legged_codesign.report.style import ACCENT, BEST, INK, NOMINAL, figure

Frame = NDArray[np.uint8]
FPS, WIDTH, HEIGHT, SECONDS = 25, 640, 360, 12.0


def make_video(scene: Path, log: Path, out: Path) -> str:
    """Write an MP4 of the motion in `log` and say how it was drawn.

    Returns:
        `rendered by MuJoCo`, or `drawn as stick figures, since no OpenGL was found`.
    """
    command = [sys.executable, "-m", "legged_codesign.report.video", str(scene), str(log), str(out)]
    for backend in _backends():
        environment = {**os.environ, "MUJOCO_GL": backend}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
        if done.returncode == 0 and out.is_file():
            return "rendered by MuJoCo"
    _encode(out, stick_frames(load_scene(scene), read_motion(log)))
    return "drawn as stick figures, since no OpenGL was found"


def _backends() -> tuple[str, ...]:
    chosen = os.environ.get("MUJOCO_GL")
    return (chosen,) if chosen else ("egl",)


def _indices(motion: Motion) -> list[int]:
    """Rows nearest to the times of the frames."""
    times = np.arange(0.0, min(SECONDS, float(motion.time[-1])), 1.0 / FPS)
    return [int(i) for i in np.clip(np.searchsorted(motion.time, times), 0, len(motion.time) - 1)]


def rendered_frames(model: mujoco.MjModel, motion: Motion) -> Iterator[Frame]:
    """Frames by MuJoCo's renderer, the camera following the base from the side."""
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 1.7, 125.0, -14.0
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        for index in _indices(motion):
            set_pose(model, data, motion, index)
            mujoco.mj_forward(model, data)
            camera.lookat[:] = (motion.qpos[index, 0], motion.qpos[index, 1], 0.22)
            renderer.update_scene(data, camera)
            # a sun over an endless floor gives a ragged shadow
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            yield renderer.render()


def stick_frames(model: mujoco.MjModel, motion: Motion) -> Iterator[Frame]:
    """Frames by matplotlib: the skeleton from the side, right legs paler."""
    data = mujoco.MjData(model)
    made, (ax,) = figure(WIDTH / 100, HEIGHT / 100)
    canvas = FigureCanvasAgg(made)
    made.set_dpi(100)
    base = int(model.jnt_bodyid[0])
    chains = [_chain(model, joint) for joint in range(1, model.njnt, 3)]
    for index in _indices(motion):
        set_pose(model, data, motion, index)
        mujoco.mj_kinematics(model, data)
        ax.clear()
        ax.set(xlim=(data.xpos[base, 0] - 0.8, data.xpos[base, 0] + 0.8), ylim=(-0.08, 0.82), aspect="equal")
        ax.axhline(0.0, color=NOMINAL, linewidth=1)
        ends = []
        for chain in chains:
            points = np.array([data.xpos[body] for body in chain])
            ends.append(points[0])
            left = data.xpos[chain[0], 1] > data.xpos[base, 1]
            ax.plot(points[:, 0], points[:, 2], "o-", color=BEST if left else NOMINAL, linewidth=3, markersize=4)
        trunk = np.array(ends)[:, [0, 2]]
        ax.plot(trunk[:, 0], trunk[:, 1], color=INK, linewidth=5)
        ax.set_title(f"{motion.time[index]:.1f} s", color=ACCENT, fontsize=9)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[:HEIGHT, :WIDTH, :3].copy()


def _chain(model: mujoco.MjModel, first_joint: int) -> list[int]:
    """Bodies of a leg from hip to foot."""
    chain = [int(model.jnt_bodyid[first_joint])]
    while True:
        children = [b for b in range(model.nbody) if model.body_parentid[b] == chain[-1] and b != chain[-1]]
        if not children:
            return chain
        chain.append(children[0])


def _encode(out: Path, frames: Iterator[Frame]) -> None:
    """Write frames as H.264, which browsers play; complete or not at all."""
    partial = out.with_suffix(".partial.mp4")
    writer = imageio_ffmpeg.write_frames(
        str(partial), (WIDTH, HEIGHT), fps=FPS, quality=4, output_params=["-preset", "veryfast"]
    )
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
    os.replace(partial, out)


if __name__ == "__main__":
    scene_path, log_path, out_path = (Path(argument) for argument in sys.argv[1:])
    _encode(out_path, rendered_frames(load_scene(scene_path), read_motion(log_path)))
