"""OpenGL, GPU and ffmpeg, each tried in a process of its own: a broken driver ends that process and no other."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import imageio_ffmpeg

from legged_codesign.doctor.finding import Finding

SECONDS = 120
RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='.5' rgba='1 0 0 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 48, 64) as renderer:
    renderer.update_scene(data)
    print(renderer.render().max())
"""
"""Draws a lit ball and prints its brightest value."""
GPU = """
import json, torch
found = {"torch": torch.__version__, "cuda": torch.version.cuda, "devices": [], "warp": None}
if torch.cuda.is_available():
    (torch.ones(4, device="cuda") * 2).sum().item()
    for index in range(torch.cuda.device_count()):
        free, total = torch.cuda.mem_get_info(index)
        found["devices"].append([torch.cuda.get_device_name(index), free / 1e9])
try:
    import mujoco_warp, warp
    warp.config.quiet = True
    warp.init()
    found["warp"] = [device.alias for device in warp.get_cuda_devices()]
except ImportError:
    pass
print(json.dumps(found))
"""
"""Computes on the GPU, and prints what torch and Warp see."""


@dataclass(frozen=True)
class Ended:
    """How a process ended: exit status (negative: the signal), output, errors."""

    status: int
    output: str = ""
    errors: str = ""

    @property
    def reason(self) -> str:
        """Why it failed, in one line."""
        if self.status < 0:
            return f"the process died of {signal.Signals(-self.status).name}"
        lines = [line for line in self.errors.splitlines() if line.strip()]
        return lines[-1].strip() if lines else f"exit status {self.status}"


Runner = Callable[[Sequence[str], Mapping[str, str]], Ended]
"""Runs a command with additions to the environment."""


def execute(command: Sequence[str], environment: Mapping[str, str]) -> Ended:
    """Run a command to its end, for two minutes at most."""
    try:
        done = subprocess.run(
            command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=SECONDS
        )
    except subprocess.TimeoutExpired:
        return Ended(1, "", f"no answer within {SECONDS} s")
    except OSError as error:
        return Ended(1, "", str(error))
    return Ended(done.returncode, done.stdout, done.stderr)


def check_opengl(run: Runner = execute, environment: Mapping[str, str] = os.environ) -> Finding:
    """Render one frame with each backend, until one works."""
    chosen = environment.get("MUJOCO_GL")
    failures = []
    for backend in (chosen,) if chosen else ("egl", "osmesa"):
        ended = run([sys.executable, "-c", RENDER], {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend})
        drawn = ended.output.strip()
        if ended.status == 0 and drawn.isdecimal() and int(drawn) > 0:
            used = "" if backend in (chosen, "egl") else f"; set MUJOCO_GL={backend} to use it"
            return Finding("OpenGL", "ok" if not used else "warn", f"{backend} renders without a screen{used}")
        failures.append(f"{backend}: {'the frame is black' if ended.status == 0 else ended.reason}")
    unset = f"MUJOCO_GL is {chosen}; unset it, or " if chosen else ""
    return Finding(
        "OpenGL",
        "warn",
        f"no picture can be rendered ({'; '.join(failures)})",
        f"{unset}install EGL (Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri); until then the films of a "
        "run are stick figures",
    )


def check_gpu(run: Runner = execute, nvidia: bool | None = None) -> Finding:
    """Whether torch and Warp can compute on a GPU.

    Args:
        run: runs a command.
        nvidia: whether the machine has an NVIDIA driver; None to look.
    """
    ended = run([sys.executable, "-c", GPU], {})
    if nvidia is None:
        nvidia = os.path.exists("/proc/driver/nvidia/version")
    if ended.status != 0:
        return Finding("GPU", "warn", f"asking torch failed: {ended.reason}", "repair driver or torch; CPU runs work")
    found = json.loads(ended.output.strip().splitlines()[-1])
    if not found["devices"]:
        if nvidia and found["cuda"] is None:
            wanted = "pip install --force-reinstall torch from the index for your CUDA, see pytorch.org"
            return Finding("GPU", "warn", f"there is one, but torch {found['torch']} was built without CUDA", wanted)
        if nvidia:
            return Finding("GPU", "warn", "there is a driver, but torch finds no GPU", "see nvidia-smi")
        return Finding("GPU", "ok", "none; runs use the CPU (the presets for a GPU take days on it)")
    names = ", ".join(f"{name} with {free:.0f} GB free" for name, free in found["devices"])
    if not found["warp"]:
        missing = "MuJoCo Warp is not installed" if found["warp"] is None else "MuJoCo Warp does not see it"
        return Finding("GPU", "warn", f"{names}, but {missing}", "pip install 'legged-locorl[gpu]'")
    return Finding("GPU", "ok", f"{names}; torch and MuJoCo Warp compute on it")


def check_ffmpeg(run: Runner = execute, executable: Callable[[], str] | None = None) -> Finding:
    """Whether films can be written: the report needs one.

    Args:
        run: runs a command.
        executable: path of ffmpeg; None for that of imageio-ffmpeg.
    """
    try:
        path = (executable or imageio_ffmpeg.get_ffmpeg_exe)()
    except RuntimeError as error:
        return Finding(
            "ffmpeg",
            "fail",
            str(error),
            "pip install --force-reinstall imageio-ffmpeg, or set IMAGEIO_FFMPEG_EXE to an ffmpeg",
        )
    ended = run([path, "-version"], {})
    if ended.status != 0:
        return Finding("ffmpeg", "fail", f"{path}: {ended.reason}", "set IMAGEIO_FFMPEG_EXE to an ffmpeg that runs")
    version = ended.output.split(" ")[2] if ended.output.startswith("ffmpeg version ") else "of unknown version"
    return Finding("ffmpeg", "ok", f"{version} at {path}")
