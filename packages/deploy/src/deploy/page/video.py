"""Draws a logged run again with MuJoCo, from the pose that the simulator told.

Run as `python -m deploy.page.video LOG OUT`, in a process of its own: a broken OpenGL driver then takes down
nothing else.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.errors import DeployError
from deploy.logs.reading import Log, read_log

FPS, WIDTH, HEIGHT = 25, 640, 360


def make_video(log: Log, seconds: float) -> bytes:
    """An MP4 (H.264) of a run.

    Args:
        log: A log of a simulated run.
        seconds: How much of it, from the start of full control.

    Raises:
        DeployError: The log lacks what a picture needs, or nothing here can draw or encode it.
    """
    if not np.isfinite(log.trace.position).all():
        raise DeployError("the run was not simulated, nobody knows where the robot was")
    if not log.scene:
        raise DeployError("the log holds no scene")
    reasons = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "video.mp4"
        for backend in _backends():
            command = [sys.executable, "-m", "deploy.page.video", str(log.path), str(out), str(seconds)]
            environment = {**os.environ, **({"MUJOCO_GL": backend} if backend else {})}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
            if done.returncode == 0 and out.is_file():
                return out.read_bytes()
            reasons.append((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    raise DeployError(f"MuJoCo could not draw it ({reasons[0]})")


def _backends() -> tuple[str, ...]:
    if chosen := os.environ.get("MUJOCO_GL"):
        return (chosen,)
    return ("egl", "osmesa") if sys.platform.startswith("linux") else ("",)


def frames(log: Log, seconds: float) -> Iterator[NDArray[np.uint8]]:
    """Pictures at `FPS`, the camera following the base from the side, shape (HEIGHT, WIDTH, 3)."""
    import mujoco

    spec = mujoco.MjSpec.from_string(log.scene)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    model = spec.compile()
    data = mujoco.MjData(model)
    trace = log.trace
    root = int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
    base = model.jnt_qposadr[root]
    joints = [model.joint(name).qposadr[0] for name in log.joint_names]
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 1.7, 125.0, -14.0
    active = np.flatnonzero(trace.mode == "policy")
    start = trace.time[active[0] if len(active) else 0]
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        for time in np.arange(start, min(start + seconds, trace.time[-1]), 1.0 / FPS):
            row = int(np.searchsorted(trace.time, time))
            data.qpos[base : base + 3] = trace.position[row]
            data.qpos[base + 3 : base + 7] = trace.quat_wxyz[row]
            data.qpos[joints] = trace.q[row]
            mujoco.mj_forward(model, data)
            camera.lookat[:] = (*trace.position[row, :2], trace.position[row, 2] - 0.08)
            renderer.update_scene(data, camera)
            # a sun over an endless floor gives a ragged shadow
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            yield renderer.render()


def _encode(out: Path, pictures: Iterator[NDArray[np.uint8]]) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(out), (WIDTH, HEIGHT), fps=FPS, quality=4, macro_block_size=8, output_params=["-preset", "veryfast"]
    )
    writer.send(None)
    for picture in pictures:
        writer.send(np.ascontiguousarray(picture))
    writer.close()


if __name__ == "__main__":
    logged = read_log(sys.argv[1])
    _encode(Path(sys.argv[2]), frames(logged, float(sys.argv[3])))
