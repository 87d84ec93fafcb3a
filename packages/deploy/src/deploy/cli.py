"""Command line: `deploy check`, `deploy run`, `deploy report`."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from deploy.bundles.golden import check_golden
from deploy.bundles.loading import load_bundle
from deploy.errors import DeployError
from deploy.logs.commands import Export, Page, Recover
from deploy.measure.commands import Energy
from deploy.measure.summary import RunSummary
from deploy.policy.onnx_runtime import OnnxRuntime
from deploy.session import report, run


@dataclass(frozen=True)
class Check:
    """Verify a bundle: every file against its hash, then the golden trace."""

    bundle: tyro.conf.Positional[Path]
    """Folder of the bundle."""


@dataclass(frozen=True)
class Run:
    """Run a bundle in MuJoCo at its policy rate."""

    bundle: tyro.conf.Positional[Path]
    """Folder of the bundle."""
    command: tuple[float, float, float] = (0.5, 0.0, 0.0)
    """Forward and lateral speed in m/s and yaw rate in rad/s, base frame."""
    duration: float = 20.0
    """Time under full control of the policy, s."""
    log: Path | None = None
    """MCAP file to write."""
    seed: int = 0
    """Seed of the initial joint noise."""
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print the summary as JSON."""


@dataclass(frozen=True)
class Report:
    """Measure a logged run again, from its messages alone."""

    log: tyro.conf.Positional[Path]
    """MCAP file that `deploy run` wrote."""
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print the summary as JSON."""


UNITS = {
    "_m": "m",
    "_j_50hz": "J",
    "_j_physics": "J",
    "_w_ticks": "W·ticks",
    "_w": "W",
    "_s": "s",
    "_speed": "m/s",
    "tracking_error": "m/s",
    "yaw_rate_error": "rad/s",
}

Command = (
    Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Run, tyro.conf.subcommand("run")]
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
        match command:
            case Check():
                _check(command.bundle)
            case Run():
                summary = run(command.bundle, command.command, command.duration, command.log, seed=command.seed)
                _print(summary, command.as_json)
                sys.exit(0 if summary.completed else 2)
            case Report():
                _print(report(command.log), command.as_json)
            case Energy() | Page() | Recover() | Export():
                command.execute()
    except DeployError as error:
        Console(stderr=True, soft_wrap=True).print(f"[bold red]error[/] {escape(str(error))}", highlight=False)
        sys.exit(1)


def _check(folder: Path) -> None:
    bundle = load_bundle(folder)
    result = check_golden(bundle, OnnxRuntime(bundle))
    design = ", ".join(f"{name} {value:g}" for name, value in bundle.robot.design.items())
    table = Table("", Column(overflow="fold"), title=f"{bundle.name}: intact", show_header=False)
    table.add_row("robot", f"{bundle.robot.name}, {bundle.robot.total_mass:.2f} kg ({design})")
    table.add_row("policy", f"{bundle.observation_size} inputs, {len(bundle.policy.state)} recurrent states")
    table.add_row("rate", f"{bundle.policy_hz:g} Hz, physics step {bundle.physics_dt * 1e3:g} ms")
    table.add_row("sha256", bundle.sha256)
    table.add_row(
        "golden trace",
        f"{result.ticks} ticks; largest difference: observation {result.obs:.1e}, "
        f"action {result.action:.1e}, target {result.target:.1e} (allowed {bundle.golden.atol:g})",
    )
    Console().print(table)


def _print(summary: RunSummary, as_json: bool) -> None:
    if as_json:
        print(json.dumps(summary.to_dict(), indent=2, allow_nan=False))
        return
    table = Table("quantity", Column("value", overflow="fold"), title=f"{summary.bundle} on {summary.robot}")
    for name, value in summary.to_dict().items():
        if name in ("bundle", "robot"):
            continue
        unit = next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")
        text = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
        table.add_row(name, f"{text} {unit}".strip())
    Console().print(table)
