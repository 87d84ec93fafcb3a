"""The command on energy: `deploy energy`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Column, Table

from deploy.errors import DeployError
from deploy.logs.reading import read_log
from deploy.measure.account import EnergyAccount, account


@dataclass(frozen=True)
class Energy:
    """Compare what runs cost: eq. 10 as printed, joules with their sampling errors, cost of transport, legs, joints."""

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """MCAP files that `deploy run` wrote; the nominal body, or else the first, is the reference."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Plot of instantaneous and cumulative power (paper Fig. 9): .png, .svg or .pdf."""
    seconds: float | None = None
    """Count only so long from full control on, s; the paper's Fig. 9 shows 5."""
    joints: bool = False
    """List every joint too."""
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print JSON."""

    def execute(self) -> None:
        """Measure, print, plot."""
        if not self.logs:
            raise DeployError("no log given: deploy energy nominal.mcap best.mcap -o power.png")
        accounts = [account(read_log(path), self.seconds) for path in self.logs]
        if self.as_json:
            print(json.dumps([body.to_dict() for body in accounts], indent=2, allow_nan=False))
        else:
            Console().print(table(accounts, self.joints))
            for warning in warnings(accounts):
                Console().print(f"[yellow]note[/] {warning}")
        if self.out is not None:
            _plot(accounts, self.out)


def cheapest_of(accounts: Sequence[EnergyAccount]) -> int:
    """Index of the body that costs least; runs that fell short only count where none was completed."""
    costs = [body.summary.cost_of_transport for body in accounts]
    by_distance = all(cost is not None for cost in costs)
    values = [
        cost if by_distance and cost is not None else body.energy_j for cost, body in zip(costs, accounts, strict=True)
    ]
    return min(range(len(accounts)), key=lambda i: (not accounts[i].summary.completed, values[i]))


def reference_of(accounts: Sequence[EnergyAccount]) -> int:
    """Index of the nominal body, or of the first."""
    return next((index for index, body in enumerate(accounts) if body.nominal), 0)


def names(accounts: Sequence[EnergyAccount]) -> list[str]:
    """A name for each: its log's, and whether its body is the nominal one or the cheapest."""
    cheapest = cheapest_of(accounts) if len(accounts) > 1 else None
    named = []
    for index, body in enumerate(accounts):
        is_nominal = body.nominal and body.summary.design and body.name != "nominal"
        notes = ["nominal"] * bool(is_nominal) + ["cheapest"] * (index == cheapest)
        named.append(f"{body.name} ({', '.join(notes)})" if notes else body.name)
    return named


def warnings(accounts: Sequence[EnergyAccount]) -> list[str]:
    """What makes a comparison lame."""
    said = [f"{body.name}: {body.summary.reason}" for body in accounts if not body.summary.completed]
    if len({body.summary.command for body in accounts}) > 1:
        said.append("the commands differ")
    if len({round(body.seconds, 6) for body in accounts}) > 1:
        said.append("the times under full control differ: compare costs of transport, not joules, or give --seconds")
    return said


def table(accounts: Sequence[EnergyAccount], joints: bool) -> Table:
    """The comparison, a column per run."""
    made = Table("", *(Column(name, justify="right", overflow="fold") for name in names(accounts)), title="energy")
    reference = accounts[reference_of(accounts)]

    def row(what: str, *values: str) -> None:
        made.add_row(what, *values)

    row("body", *(", ".join(f"{k} {v:g}" for k, v in body.summary.design.items()) or "-" for body in accounts))
    row("robot", *(f"{body.summary.robot}, {body.mass:.2f} kg" for body in accounts))
    row("command", *(f"{body.summary.command} for {body.seconds:g} s" for body in accounts))
    row("distance", *(_unit(body.summary.distance_m, "m") for body in accounts))
    row("eq. 10 (50 Hz samples)", *(_unit(body.summary.eq10_w_ticks, "W·ticks") for body in accounts))
    row("energy, policy rate", *(_bar(body.summary.energy_j_50hz, body.error_50hz_j) for body in accounts))
    row(
        "energy, rate of the state",
        *(
            f"{_bar(body.summary.energy_j_physics, body.error_state_j)}"
            + ("" if body.state_hz is None else f" at {body.state_hz:.0f} Hz")
            for body in accounts
        ),
    )
    row("mean power", *(_unit(body.summary.mean_power_w, "W") for body in accounts))
    row("peak power", *(_unit(body.summary.peak_power_w, "W") for body in accounts))
    row("cost of transport", *(_unit(body.summary.cost_of_transport, "") for body in accounts))
    for leg, values in (
        ("front legs", [body.fore_j for body in accounts]),
        ("hind legs", [body.hind_j for body in accounts]),
    ):
        shares = [
            "-" if value is None else f"{value:.4g} J, {100 * value / max(body.energy_j, 1e-12):.0f} %"
            for value, body in zip(values, accounts, strict=True)
        ]
        row(leg, *shares)
    if len(accounts) > 1:
        row(f"against {reference.name}", *(_change(body, reference) for body in accounts))
    for name in accounts[0].joints_j if joints else ():
        row(name, *(_unit(body.joints_j.get(name), "J") for body in accounts))
    return made


def _unit(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.4g} {unit}".strip()


def _bar(value: float | None, error: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g} J" if error is None else f"{value:.4g} ± {error:.2g} J"


def _change(body: EnergyAccount, reference: EnergyAccount) -> str:
    """Cost of transport against the reference's, energy where that is not defined."""
    if body is reference:
        return "reference"
    here, there = body.summary.cost_of_transport, reference.summary.cost_of_transport
    if here is None or there is None:
        here, there = body.energy_j, reference.energy_j
    return "-" if there <= 0 else f"{100 * (here / there - 1):+.1f} %"


def _plot(accounts: Sequence[EnergyAccount], out: Path) -> None:
    from deploy.page.figures import body_colours, compared_power

    if out.suffix not in (".png", ".svg", ".pdf"):
        raise DeployError(f"{out}: a plot's name ends in .png, .svg or .pdf")
    drawn = compared_power(accounts, names(accounts), body_colours(accounts, cheapest_of(accounts)))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        drawn.savefig(out, dpi=150)
    except OSError as error:
        raise DeployError(f"{out}: cannot write the plot ({error}); choose another path") from error
    print(out)
