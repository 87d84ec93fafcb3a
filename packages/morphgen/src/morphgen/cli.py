"""The `morphgen` command."""

from __future__ import annotations

import sys

import tyro

from morphgen.commands.render import Render
from morphgen.commands.sample import Sample
from morphgen.commands.scale import Export, Scale
from morphgen.errors import MorphologyError
from morphgen.inspection.command import Inspect
from morphgen.viewer.command import View

Command = Inspect | Scale | Sample | Render | Export | View


def main(args: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    chosen: Command = tyro.cli(Command, args=args, prog="morphgen", description=__doc__)
    try:
        return chosen.run() or 0
    except (MorphologyError, ValueError, OSError) as error:
        print(f"morphgen: {error}", file=sys.stderr)
        return 2
