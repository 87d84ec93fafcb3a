"""Films of the policy as it learns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from locorl.play.choice import at_level, calm
from locorl.play.errors import missing_extra
from locorl.play.renderer import gl_context
from locorl.play.session import Session
from locorl.play.video import write_video

if TYPE_CHECKING:
    from locorl.training.trainer import Trainer

_SIZE = (640, 270)
"""px; drawing takes as long as the simulation of many robots where there is no GPU."""


class Films:
    """Films the mean action on the first few robots' bodies every so many iterations; a `Watcher`.

    The film has an environment of its own, without randomisation and on the training's mean terrain level, so
    that training takes the same course with films and without. Files are named after the iteration: `000200.mp4`.

    Args:
        folder: where the films go.
        every: iterations between two.
        robots: how many are in it, each in a pane of its own.
        seconds: length.

    Raises:
        ValueError: `every` is not positive.
        PlayError: there is no OpenGL, or a package of the extra `play` is missing.
    """

    def __init__(self, folder: Path, every: int, robots: int = 2, seconds: float = 4.0) -> None:
        if every < 1:
            raise ValueError(f"there must be at least one iteration between films, got {every}")
        # hours of training should not end at the first film
        try:
            import imageio_ffmpeg  # noqa: F401  # pyright: ignore[reportUnusedImport]
        except ModuleNotFoundError as error:
            raise missing_extra(error) from error
        gl_context(*_SIZE).free()
        self._folder, self._every, self._robots, self._seconds = folder, every, robots, seconds

    def begin(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def watch(self, trainer: Trainer, row: Mapping[str, float]) -> None:
        """Film when it is time."""
        if trainer.iteration % self._every:
            return
        env = trainer.env
        level = round(float(env.curriculum.level.float().mean()))
        with torch.random.fork_rng(devices=[]):
            session = Session(
                env.factory,
                env.bodies.designs[: self._robots],
                at_level(calm(env.task), level),
                trainer.policy(),
                seed=trainer.config.seed,
            )
            write_video(session, self._folder / f"{trainer.iteration:06d}.mp4", self._seconds, _SIZE, quiet=True)

    def end(self) -> None:
        """Nothing is open between films."""
