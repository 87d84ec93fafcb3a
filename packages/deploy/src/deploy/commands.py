"""Commands on bundles and robots: `deploy run`, `replay`, `doctor`, `record-golden`, `report`."""

from __future__ import annotations

import json
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Column, Table

from deploy.bundles.loading import load_bundle
from deploy.bundles.manifest import Bundle
from deploy.bundles.recording import TICKS, record_golden
from deploy.comparison import replay
from deploy.control.operator import Keyboard, Operator
from deploy.doctor import Diagnosis, examine
from deploy.errors import DeployError
from deploy.interfaces import RobotInterface
from deploy.live import LiveView
from deploy.logs.messages import Sample
from deploy.measure.summary import RunSummary
from deploy.robots.disturbances import Disturbances
from deploy.robots.opening import Connection, open_robot
from deploy.session import Observer, RuntimeName, open_runtime, report, run

SIMULATION = "mujoco"

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

Json = Annotated[bool, tyro.conf.arg(name="json")]
Out = tyro.conf.arg(aliases=["-o"])


@dataclass(frozen=True)
class Run:
    """Run a bundle on a robot at its policy rate, by default in MuJoCo."""

    bundle: tyro.conf.Positional[Path]
    """Folder of the bundle."""
    robot: str = SIMULATION
    """What to run it on: mujoco, or the name of a robot such as go2."""
    command: tuple[float, float, float] = (0.5, 0.0, 0.0)
    """Forward and lateral speed in m/s and yaw rate in rad/s, base frame."""
    duration: float = 20.0
    """Time under full control of the policy, s."""
    log: Path | None = None
    """MCAP file to write."""
    dry_run: bool = False
    """Compute and log everything, but send only damping."""
    confirm: bool = False
    """Wait for Enter before the robot stands up and before the policy takes over; any other key stops it. Always so
    on a robot of metal."""
    realtime: bool = False
    """Let a simulation run no faster than real time."""
    live: bool = False
    """Show the run in the terminal."""
    runtime: RuntimeName = "onnx"
    """What runs the networks."""
    design: tuple[tuple[str, float], ...] = ()
    """Scales that a robot of metal was built with, as NAME VALUE; what is missing is 1."""
    connect: Connection = field(default_factory=Connection)
    """How to reach a robot of metal and its camera."""
    seed: int = 0
    """Seed of the simulated robot's initial joint noise."""
    disturb: Disturbances = field(default_factory=Disturbances)
    """What a simulated robot does to its controller."""
    as_json: Json = False
    """Print the summary as JSON."""

    def execute(self) -> None:
        """Run, print the summary, exit with 2 if the run fell short."""
        bundle = load_bundle(self.bundle)
        observers: list[Observer] = []
        with ExitStack() as stack:
            operator: Operator | None = None
            if self.confirm or self.robot != SIMULATION:
                operator = stack.enter_context(Keyboard())
                print("Enter: stand up, then hand over to the policy. Any other key: stop.", file=sys.stderr)
            if self.live:
                observers.append(stack.enter_context(LiveView(bundle)))
            if self.realtime and self.robot == SIMULATION:
                observers.append(Pacer())
            summary = run(
                self.bundle,
                self.command,
                self.duration,
                self.log,
                robot=self._open(bundle),
                seed=self.seed,
                operator=operator,
                dry_run=self.dry_run,
                runtime=self.runtime,
                design=dict(self.design),
                on_tick=_all(observers),
            )
        print_summary(summary, self.as_json)
        sys.exit(0 if summary.completed else 2)

    def _open(self, bundle: Bundle) -> RobotInterface:
        if self.robot != SIMULATION:
            return open_robot(self.robot, bundle, self.connect)
        try:
            from deploy.robots.mujoco_robot import MujocoRobot
        except ImportError as error:
            raise DeployError("mujoco is missing: pip install 'legged-deploy[sim]'") from error
        return MujocoRobot(bundle, seed=self.seed, disturbances=self.disturb)


@dataclass(frozen=True)
class Replay:
    """Feed a log to a bundle and compare every action bit by bit."""

    log: tyro.conf.Positional[Path]
    """MCAP file that `deploy run` wrote."""
    bundle: Path
    """Folder of the bundle, the one of the run or another one."""
    runtime: RuntimeName = "onnx"
    """What runs the networks."""

    def execute(self) -> None:
        """Replay, print what was found, exit with 2 if an action differs."""
        bundle = load_bundle(self.bundle)
        result = replay(self.log, bundle, open_runtime(bundle, self.runtime))
        print(f"{result.identical} of {result.ticks} actions are reproduced in every bit")
        if result.first is not None:
            print(f"first difference: {result.first}")
            print(f"largest difference of an action: {result.largest:.3g}")
            for name, difference in result.terms.items():
                print(f"largest difference of {name}: {difference:.3g}")
            sys.exit(2)


@dataclass(frozen=True)
class Doctor:
    """Examine a bundle: files, golden trace, body, and whether it fits a robot."""

    bundle: tyro.conf.Positional[Path]
    """Folder of the bundle."""
    robot: str | None = None
    """Robot that it shall run on, such as go2."""
    design: tuple[tuple[str, float], ...] = ()
    """Scales that this robot was built with, as NAME VALUE; what is missing is 1."""

    def execute(self) -> None:
        """Examine, print what was found, exit with 1 if the bundle must not run."""
        found = examine(self.bundle, self.robot, dict(self.design))
        Console(soft_wrap=True).print(_diagnosis_table(found))
        for problem in found.problems:
            Console(stderr=True, soft_wrap=True).print(f"refused: {problem}", markup=False, highlight=False)
        sys.exit(1 if found.problems else 0)


@dataclass(frozen=True)
class RecordGolden:
    """Copy a bundle and give it a golden trace of what a robot measured."""

    log: tyro.conf.Positional[Path]
    """MCAP file that `deploy run` wrote."""
    bundle: Path
    """Folder of the bundle."""
    out: Annotated[Path, Out]
    """Folder to create."""
    ticks: int = TICKS
    """Most ticks of the trace."""

    def execute(self) -> None:
        """Record and print where it is."""
        print(record_golden(self.log, load_bundle(self.bundle), self.out, self.ticks))


@dataclass(frozen=True)
class Report:
    """Measure a logged run again, from its messages alone."""

    log: tyro.conf.Positional[Path]
    """MCAP file that `deploy run` wrote."""
    as_json: Json = False
    """Print the summary as JSON."""

    def execute(self) -> None:
        """Measure and print."""
        print_summary(report(self.log), self.as_json)


def _all(observers: list[Observer]) -> Observer:
    def observe(sample: Sample) -> None:
        for each in observers:
            each(sample)

    return observe


class Pacer:
    """Holds a simulation back to real time; called after every tick."""

    def __init__(self) -> None:
        self._offset: int | None = None

    def __call__(self, sample: Sample) -> None:
        """Sleep until the wall clock has come as far as the tick."""
        due = sample.tick.slot.start_ns
        if self._offset is None:
            self._offset = time.monotonic_ns() - due
        time.sleep(max(due + self._offset - time.monotonic_ns(), 0) * 1e-9)


def print_summary(summary: RunSummary, as_json: bool) -> None:
    """Print a summary as a table or as JSON."""
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


def _diagnosis_table(found: Diagnosis) -> Table:
    bundle = found.bundle
    design = ", ".join(f"{name} {value:g}" for name, value in bundle.robot.design.items())
    table = Table("", Column(overflow="fold"), title=f"{bundle.name}: intact", show_header=False)
    table.add_row("robot", f"{bundle.robot.name}, {bundle.robot.total_mass:.2f} kg ({design})")
    table.add_row("policy", f"{bundle.observation_size} inputs, {len(bundle.policy.state)} recurrent states")
    table.add_row("rate", f"{bundle.policy_hz:g} Hz, physics step {bundle.physics_dt * 1e3:g} ms")
    if depth := bundle.depth:
        table.add_row(
            "depth",
            f"{depth.optics.rows} x {depth.optics.columns} px at {bundle.policy_hz / depth.period_ticks:g} Hz, "
            f"used {depth.latency_ticks / bundle.policy_hz * 1e3:g} ms after it was taken",
        )
    table.add_row("sha256", bundle.sha256)
    for name, result in found.golden.items():
        table.add_row(
            f"golden trace, {name}",
            f"{result.ticks} ticks; largest difference: observation {result.obs:.1e}, "
            f"action {result.action:.1e}, target {result.target:.1e} (allowed {bundle.golden.atol:g})",
        )
    for text in found.skipped:
        table.add_row("not examined", text)
    return table
