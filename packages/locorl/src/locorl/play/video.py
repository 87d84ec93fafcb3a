"""Videos of robots at play: a pane for each, numbers in its corner."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
from rich.progress import track

from locorl.play.errors import missing_extra
from locorl.play.renderer import Frame, RobotCamera
from locorl.play.session import Session

MOST_ROBOTS = 16
_INK, _PAPER = (30, 34, 40), (244, 246, 248)
_INSET = 0.28
"""Width of the depth image, in widths of the pane."""


def write_video(
    session: Session,
    path: Path,
    seconds: float,
    size: tuple[int, int] = (960, 540),
    quiet: bool = False,
) -> None:
    """Play `session` for `seconds` and film it at real time, one frame per control step.

    Args:
        session: what to film; all its robots are shown.
        path: .mp4 file; written whole or not at all.
        seconds: length.
        size: width and height of the picture, px; even numbers.
        quiet: no progress bar.

    Raises:
        ValueError: no such video can be made.
        FileNotFoundError: the folder of `path` does not exist.
        PlayError: there is no OpenGL, or a package is missing.
    """
    steps = round(seconds / session.env.dt) if math.isfinite(seconds) else 0
    if path.suffix.lower() != ".mp4":
        raise ValueError(f"{path}: a video is an .mp4 file")
    if steps < 1 or min(size) < 64 or size[0] % 2 or size[1] % 2:
        raise ValueError(f"a video needs at least one frame of even width and height from 64, got {seconds} s, {size}")
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError as error:
        raise missing_extra(error) from error
    with _replacing(path) as temporary, closing(Film(session, size)) as film:
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            size,
            fps=1.0 / session.env.dt,  # pyright: ignore[reportArgumentType]
            quality=7,
            macro_block_size=2,
            ffmpeg_log_level="error",
        )
        writer.send(None)
        try:
            for _ in track(range(steps), description=path.name, disable=quiet):
                session.step()
                writer.send(film.frame())
        finally:
            writer.close()


class Film:
    """Draws all robots of a session, each in a pane of its own.

    Args:
        session: what to draw.
        size: width and height of the picture, px.

    Raises:
        ValueError: too many robots for one picture.
        PlayError: there is no OpenGL, or a package is missing.
    """

    def __init__(self, session: Session, size: tuple[int, int]) -> None:
        try:
            from PIL import ImageFont
        except ModuleNotFoundError as error:
            raise missing_extra(error) from error
        count = session.env.num_envs
        if count > MOST_ROBOTS:
            raise ValueError(f"a video shows at most {MOST_ROBOTS} robots, got {count}")
        self._session, self._size = session, size
        self._columns = math.ceil(math.sqrt(count))
        rows = math.ceil(count / self._columns)
        self._pane = size[0] // self._columns, size[1] // rows
        height = max(10, self._pane[1] // 24)
        self._font, self._margin = ImageFont.load_default(height), height / 2
        self._cameras = [RobotCamera(session.env.sim.model_of(i), *self._pane, session.env.dt) for i in range(count)]

    def frame(self) -> Frame:
        """The robots now, (height, width, 3)."""
        width, height = self._pane
        picture = np.empty((self._size[1], self._size[0], 3), np.uint8)
        picture[:] = _PAPER
        for robot, camera in enumerate(self._cameras):
            row, column = divmod(robot, self._columns)
            pane = camera.draw(self._session.qpos(robot), *self._session.course(robot))
            picture[row * height : (row + 1) * height, column * width : (column + 1) * width] = self._annotate(
                pane, robot
            )
        return picture

    def close(self) -> None:
        """Give back what the graphics driver holds."""
        for camera in self._cameras:
            camera.close()

    def _annotate(self, pane: Frame, robot: int) -> Frame:
        from PIL import Image, ImageDraw

        image = Image.fromarray(pane)
        if (depth := self._session.depth(robot)) is not None:
            width = round(_INSET * image.width)
            inset = Image.fromarray(depth).resize((width, round(width * depth.shape[0] / depth.shape[1])), 0)
            image.paste(inset, (image.width - width - 8, image.height - inset.height - 8))
        text = "\n".join(self._session.caption(robot))
        draw = ImageDraw.Draw(image, "RGBA")
        margin = self._margin
        left, top, right, bottom = draw.textbbox((2 * margin, 2 * margin), text, font=self._font)
        box = (left - margin, top - margin, right + margin, bottom + margin)
        draw.rounded_rectangle(box, margin, fill=(*_PAPER, 190))
        draw.text((2 * margin, 2 * margin), text, fill=_INK, font=self._font)
        return np.asarray(image)


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, which takes its place once it is written."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
