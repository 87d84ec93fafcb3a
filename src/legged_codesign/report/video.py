"""Film of the student's run: deploy's where OpenGL is found, stick figures by matplotlib elsewhere."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import io
import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mujoco
import numpy as np
from deploy import DeployError
from deploy.logs.reading import Log
from deploy.page.style import ACCENT, BEST, INK, NOMINAL, figure
from deploy.page.video import FPS, HEIGHT, WIDTH, make_video
from matplotlib.image import imsave
from numpy.typing import NDArray

from legged_codesign.stages import write_bytes

Frame = NDArray[np.uint8]
SECONDS = 12.0
"""Length of the film."""


def film(log: Log, out: Path) -> str:
    """Write an MP4 of a simulated run, from full control on, and say how it was drawn.

    Returns:
        `rendered by MuJoCo`, or `drawn as stick figures, since no OpenGL was found`.
    """
    try:
        write_bytes(out, make_video(log, SECONDS))
        return "rendered by MuJoCo"
    except DeployError:
        _encode(out, stick_frames(log))
        return "drawn as stick figures, since no OpenGL was found"


def still_frame(clip: Path) -> bytes:
    """The picture in the middle of a film, as PNG; a page shows it where nothing moves."""
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(clip))
    frames: Any = imageio_ffmpeg.read_frames(str(clip))
    width, height = next(frames)["size"]
    raw = next(islice(frames, (count or 0) // 2, None))
    frames.close()
    buffer: Any = io.BytesIO()
    imsave(buffer, np.frombuffer(raw, np.uint8).reshape(height, width, 3), format="png")
    return buffer.getvalue()


def frame_rows(log: Log) -> list[int]:
    """Ticks nearest to the times of the frames, from full control on."""
    time = log.trace.time
    active = np.flatnonzero(log.trace.mode == "policy")
    start = float(time[active[0] if len(active) else 0])
    times = np.arange(start, min(start + SECONDS, float(time[-1])), 1.0 / FPS)
    return [int(i) for i in np.clip(np.searchsorted(time, times), 0, len(time) - 1)]


def stick_frames(log: Log) -> Iterator[Frame]:
    """Frames by matplotlib: the skeleton from the side, right legs paler."""
    model = mujoco.MjModel.from_xml_string(log.scene)
    data, trace = mujoco.MjData(model), log.trace
    made, (ax,) = figure(WIDTH / 100, HEIGHT / 100)
    made.set_dpi(100)
    canvas = made.canvas
    root = int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
    base, pose = int(model.jnt_bodyid[root]), model.jnt_qposadr[root]
    joints = [model.joint(name).qposadr[0] for name in log.joint_names]
    chains = [_chain(model, int(model.joint(name).bodyid[0])) for name in log.joint_names[::3]]
    for row in frame_rows(log):
        data.qpos[pose : pose + 3], data.qpos[pose + 3 : pose + 7] = trace.position[row], trace.quat_wxyz[row]
        data.qpos[joints] = trace.q[row]
        mujoco.mj_kinematics(model, data)
        x, y, z = data.xpos[base]
        ax.clear()
        ax.set(xlim=(x - 0.8, x + 0.8), ylim=(z - 0.4, z + 0.5), aspect="equal")
        ax.axhline(0.0, color=NOMINAL, linewidth=1)
        hips = []
        for chain in chains:
            points = data.xpos[chain]
            hips.append(points[0])
            ax.plot(
                points[:, 0], points[:, 2], "o-", color=BEST if points[0, 1] > y else NOMINAL, linewidth=3, markersize=4
            )
        trunk = np.array(hips)
        ax.plot(trunk[:, 0], trunk[:, 2], color=INK, linewidth=5)
        ax.set_title(f"{trace.time[row]:.1f} s", color=ACCENT, fontsize=9)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[:HEIGHT, :WIDTH, :3].copy()


def _chain(model: mujoco.MjModel, hip: int) -> list[int]:
    """Bodies of a leg from hip to foot."""
    chain = [hip]
    while True:
        children = [b for b in range(model.nbody) if model.body_parentid[b] == chain[-1] and b != chain[-1]]
        if not children:
            return chain
        chain.append(children[0])


def _encode(out: Path, frames: Iterator[Frame]) -> None:
    """Write frames as H.264, which browsers play; complete or not at all."""
    partial = out.with_suffix(".partial.mp4")
    writer = imageio_ffmpeg.write_frames(
        str(partial), (WIDTH, HEIGHT), fps=FPS, quality=4, macro_block_size=8, output_params=["-preset", "veryfast"]
    )
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
    os.replace(partial, out)
