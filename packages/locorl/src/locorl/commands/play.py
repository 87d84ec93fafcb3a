"""`locorl play`."""

from __future__ import annotations

import contextlib
import io
import webbrowser
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from locorl.commands.evaluate import print_summaries
from locorl.play.choice import Choice
from locorl.play.errors import missing_extra
from locorl.play.video import write_video
from locorl.providers import installed_robots
from locorl.tasks import Preset


@dataclass(frozen=True)
class Play:
    """Watch robots on a task: live in the browser, or with -o as a video."""

    task: str | None = None
    """Task to play; by default the one that the policy was trained on, or locomotion-flat."""
    robot: str = "go2"
    """An installed robot, or the path of a .urdf."""
    policy: str = "stand"
    """stand, random, or the path of a policy.pt or checkpoint.pt."""
    adopt: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Take the policy on even if it was trained on bodies with other rules or gains."""
    design: tuple[float, ...] | None = None
    """Design parameters in the order of the design space; the nominal body by default."""
    bodies: int = 1
    """Robots in the video; without --design, more than one get random bodies."""
    preset: Preset = "laptop"
    """Preset of the task."""
    level: int = 3
    """Level of the terrain, from 0."""
    command: tuple[float, float, float] | None = None
    """Forward and left velocity (m/s) and yaw rate (rad/s); by default the task draws them."""
    camera: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Give the robots the small depth camera, if the task has none, and show what it sees."""
    seconds: float = 10.0
    """Length of the video."""
    size: tuple[int, int] = (640, 360)
    """Width and height of the video, pixels."""
    seed: int = 0
    """Of everything random."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Video to write (.mp4); without it, a page in the browser."""
    port: int = 8080
    """Port of the page; the next free one is taken if it is in use."""
    host: str = "127.0.0.1"
    """Address of the page; 0.0.0.0 lets other machines in."""
    open: bool = True
    """Open the page in your browser."""

    def run(self) -> None:
        """Write the video and print how the robots did, or serve the page until Ctrl-C."""
        choice = Choice(
            robot=self.robot,
            policy=self.policy,
            adopt=self.adopt,
            task=self.task,
            preset=self.preset,
            level=self.level,
            design=self.design,
            bodies=self.bodies,
            command=self.command,
            camera=self.camera,
            seed=self.seed,
        )
        if self.output is None:
            self._serve(choice)
            return
        session = choice.start()
        write_video(session, self.output, self.seconds, self.size)
        print_summaries({Path(self.policy).name: session.score().summary()}, title=session.env.task.name)

    def _serve(self, choice: Choice) -> None:
        try:
            import viser

            from locorl.play.browser import Page
        except ModuleNotFoundError as error:
            raise missing_extra(error) from error
        choice = replace(choice, bodies=1)
        session = choice.start()
        with _quiet():
            server = viser.ViserServer(self.host, self.port, verbose=False)
        with contextlib.suppress(KeyboardInterrupt):  # also while it stops
            try:
                page = Page(server, choice, session, installed_robots())
                host = "localhost" if self.host in ("127.0.0.1", "0.0.0.0") else self.host
                url = f"http://{host}:{server.get_port()}"
                print(f"{session.env.task.name}, {self.robot}: {url} (Ctrl-C ends)", flush=True)
                if self.open:
                    webbrowser.open(url)
                page.run()
            finally:
                with _quiet():
                    server.stop()


def _quiet() -> contextlib.redirect_stdout[io.StringIO]:
    """Keeps the server's own announcements off the terminal."""
    return contextlib.redirect_stdout(io.StringIO())
