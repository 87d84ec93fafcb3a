"""The `locorl` command: train a generalist, fine-tune it to a body, evaluate it honestly, compare runs, watch it."""

from __future__ import annotations

import sys

import rich
import tyro
from rich.markup import escape

from locorl.checkpoint import CheckpointError
from locorl.commands.compare import Compare
from locorl.commands.evaluate import Evaluate
from locorl.commands.finetune import Finetune
from locorl.commands.play import Play
from locorl.commands.terrain import Terrain
from locorl.commands.train import Train
from locorl.learning.ppo import DivergedError
from locorl.play.errors import PlayError

Command = Train | Finetune | Evaluate | Compare | Play | Terrain


def main() -> None:
    """Entry point of the `locorl` command."""
    command: Command | None = None
    try:
        command = tyro.cli(Command, description=__doc__)
        command.run()
    except (CheckpointError, DivergedError, PlayError, LookupError, ValueError, OSError) as error:
        rich.get_console().print(f"[red]error:[/red] {escape(str(error))}", highlight=False)
        sys.exit(1)
    except KeyboardInterrupt:
        hint = "; the same command goes on from the last checkpoint" if isinstance(command, Train | Finetune) else ""
        rich.print(f"\nstopped{hint}")
        sys.exit(130)
