"""`codesign report`: the page of a run, written again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from legged_codesign.robots import body_factory


@dataclass(frozen=True)
class Report:
    """Write the report of a run folder again, from what is on disk."""

    folder: Annotated[Path, tyro.conf.Positional]

    def run(self, console: Console) -> None:
        """Write it."""
        from legged_codesign.report.render import write_report
        from legged_codesign.run_folder import read_config

        config = read_config(self.folder)
        console.print(str(write_report(self.folder, config, body_factory(config.robot, config.bodies))), soft_wrap=True)
