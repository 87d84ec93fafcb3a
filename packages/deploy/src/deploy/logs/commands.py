"""Commands on logs: `deploy recover`, `deploy export`, `deploy page`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deploy.logs.export import export_rosbag2
from deploy.logs.recovery import recover
from deploy.logs.storage import RESERVE_SUFFIX

Out = tyro.conf.arg(aliases=["-o"])


@dataclass(frozen=True)
class Recover:
    """Make a torn or damaged log readable again and say what is lost."""

    log: tyro.conf.Positional[Path]
    """The damaged file; it is not changed."""
    out: Annotated[Path | None, Out] = None
    """The readable copy; beside the log, ending in .recovered.mcap, by default."""

    def execute(self) -> None:
        """Recover and print what was kept."""
        print("\n".join(recover(self.log, self.out).sentences()))
        reserve = self.log.with_name(self.log.name + RESERVE_SUFFIX)
        if reserve.is_file():
            print(f"{reserve} only kept room; delete it if the run is over.")


@dataclass(frozen=True)
class Export:
    """Write a log as a rosbag2 folder, for `ros2 bag play`."""

    log: tyro.conf.Positional[Path]
    """MCAP file that `deploy run` wrote."""
    out: Annotated[Path, Out]
    """Folder to create."""

    def execute(self) -> None:
        """Export and print the number of messages."""
        print(f"{self.out}: {export_rosbag2(self.log, self.out)} messages")


@dataclass(frozen=True)
class Page:
    """Write a log as one HTML file: video, safety, joint tracking, power, timing, depth."""

    log: tyro.conf.Positional[Path]
    """MCAP file that `deploy run` wrote."""
    out: Annotated[Path, Out] = Path("page.html")
    """The page."""
    video: float = 12.0
    """Length of the video of a simulated run, s; 0: none."""

    def execute(self) -> None:
        """Write the page and print where it is."""
        from deploy.page.render import write_page  # matplotlib comes with an extra

        print(write_page(self.log, self.out, self.video))
