"""Command line: `deploy run`, `replay`, `doctor`, `record-golden`, `report`, `energy`, `page`, `recover`, `export`."""

from __future__ import annotations

import sys
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from deploy.commands import Doctor, RecordGolden, Replay, Report, Run
from deploy.errors import DeployError
from deploy.logs.commands import Export, Page, Recover
from deploy.measure.commands import Energy

Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
    | Annotated[RecordGolden, tyro.conf.subcommand("record-golden")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Energy, tyro.conf.subcommand("energy")]
    | Annotated[Page, tyro.conf.subcommand("page")]
    | Annotated[Recover, tyro.conf.subcommand("recover")]
    | Annotated[Export, tyro.conf.subcommand("export")]
)


def main(args: list[str] | None = None) -> None:
    """Entry point; exits with 1 and one line on errors of the user's data, 2 after a run that fell short."""
    command = tyro.cli(
        Command, prog="deploy", description=__doc__, args=args, config=(tyro.conf.OmitSubcommandPrefixes,)
    )
    try:
        command.execute()
    except DeployError as error:
        Console(stderr=True, soft_wrap=True).print(f"[bold red]error[/] {escape(str(error))}", highlight=False)
        sys.exit(1)
