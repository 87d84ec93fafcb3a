"""A film of several policies on the same robot and ground, side by side."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from distill.errors import InterfaceError, ProviderError
from distill.evaluate import MemoryPolicy, Score, evaluate
from distill.interfaces import FilmedEnv, StudentEnv, Teacher

Frame = NDArray[np.uint8]

FRAMES_PER_SECOND = 25
PANE = (480, 360)
"""Width and height of a policy's part of the picture, px."""
_BAR = 24
"""Height of the line with its name, px."""


def evaluate_on_film(
    env: StudentEnv, policies: Mapping[str, MemoryPolicy | Teacher], steps: int, seed: int, path: Path, robot: int = 0
) -> dict[str, Score]:
    """Score policies as `evaluate` does, and film one of the robots under each.

    Args:
        env: the environment, which must draw pictures (`FilmedEnv`).
        policies: name -> policy.
        steps: horizon in control steps.
        seed: of the episodes, the same for all.
        path: .mp4 file, written whole or not at all.
        robot: which one is filmed.

    Raises:
        InterfaceError: the environment draws no pictures, or has no such robot.
        ProviderError: a package of the extra `video` is missing.
    """
    if path.suffix.lower() != ".mp4":
        raise InterfaceError(f"{path}: a film is an .mp4 file")
    if not isinstance(env, FilmedEnv):
        raise InterfaceError("this environment draws no pictures (`distill.interfaces.FilmedEnv`); leave --video out")
    if not 0 <= robot < env.num_envs:
        raise InterfaceError(f"there is no robot {robot} of {env.num_envs} to film")
    _check_extra()
    every = max(1, round(1.0 / (FRAMES_PER_SECOND * env.control_dt)))
    scores: dict[str, Score] = {}
    panes: list[_Pane] = []
    for name, policy in policies.items():
        panes.append(_Pane(env, robot, name, every))
        scores[name] = evaluate(env, policy, steps, seed, panes[-1].watch)
    frames = (np.concatenate(row, axis=1) for row in zip(*(pane.frames for pane in panes), strict=True))
    write_film(path, frames, 1.0 / (every * env.control_dt))
    return scores


class _Pane:
    """The part of the picture that belongs to one policy: a frame at each `every`th step."""

    def __init__(self, env: FilmedEnv, robot: int, name: str, every: int) -> None:
        self._env, self._robot, self._name, self._every = env, robot, name, every
        self._tick = 0
        self.frames: list[Frame] = []

    def watch(self) -> None:
        """A step is about to be taken."""
        if self._tick % self._every == 0:
            self.frames.append(labelled(self._env.picture(self._robot, *PANE), self._name))
        self._tick += 1


def labelled(picture: Frame, name: str) -> Frame:
    """A picture (H, W, 3) with a line above it that holds `name`, (H + 24, W, 3)."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (picture.shape[1], picture.shape[0] + _BAR), (244, 246, 248))
    image.paste(Image.fromarray(picture), (0, _BAR))
    ImageDraw.Draw(image).text((8, 4), name, fill=(30, 34, 40), font=ImageFont.load_default(14))
    return np.asarray(image)


def write_film(path: Path, frames: Iterator[Frame], rate: float) -> None:
    """Encode frames (H, W, 3), H and W even, at `rate` per second as H.264."""
    import imageio_ffmpeg

    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.mp4")
    writer = None
    try:
        for frame in frames:
            if writer is None:
                size = frame.shape[1], frame.shape[0]
                writer = imageio_ffmpeg.write_frames(
                    str(temporary),
                    size,
                    fps=rate,  # pyright: ignore[reportArgumentType]
                    quality=6,
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(frame))
        if writer is not None:
            writer.close()
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _check_extra() -> None:
    """Hours of evaluation should not end at the first picture."""
    try:
        import imageio_ffmpeg  # noqa: F401  # pyright: ignore[reportUnusedImport]
        import PIL  # noqa: F401  # pyright: ignore[reportUnusedImport]
    except ModuleNotFoundError as error:
        raise ProviderError(f"a film needs {error.name}: pip install 'legged-distill[video]'") from error
