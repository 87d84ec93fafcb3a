"""The `codesign` command: from a robot and a task to a better body, its controller, and the proof."""

from __future__ import annotations

import os
import sys

import tyro
from deploy import DeployError
from rich.console import Console
from rich.markup import escape

from legged_codesign.commands.compare import Compare
from legged_codesign.commands.doctor import Doctor
from legged_codesign.commands.report import Report
from legged_codesign.commands.run import Run
from legged_codesign.commands.status import Status
from legged_codesign.commands.student import Student
from legged_codesign.commands.watch import Watch

console = Console()


def main() -> None:
    """Entry point of the `codesign` command."""
    command = tyro.cli(Run | Student | Status | Watch | Report | Compare | Doctor, prog="codesign", description=__doc__)
    try:
        command.run(console)
    except KeyboardInterrupt:
        console.print("\nstopped; the same command goes on from here")
        sys.exit(130)
    except (OSError, RuntimeError, ValueError, LookupError, DeployError) as error:
        if os.environ.get("CODESIGN_TRACEBACK"):
            raise
        console.print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
        sys.exit(1)
