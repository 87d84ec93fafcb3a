"""The command `distill`: from a privileged teacher to a student on onboard sensors, and to a bundle for a robot."""

from __future__ import annotations

import sys

import tyro
from rich.console import Console

from distill.commands.bundles import Inspect, Leapp, Verify
from distill.commands.evaluate import Evaluate
from distill.commands.export import Export
from distill.commands.train import Train
from distill.errors import DistillError

COMMANDS = {
    "train": Train,
    "evaluate": Evaluate,
    "export": Export,
    "inspect": Inspect,
    "verify": Verify,
    "leapp": Leapp,
}


def main() -> None:
    """Entry point of the command."""
    command = tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="distill", description=__doc__)
    try:
        command.run(Console())
    except (DistillError, OSError, ValueError) as error:
        print(f"distill: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("distill: stopped; the same command goes on from the last checkpoint", file=sys.stderr)
        sys.exit(130)
