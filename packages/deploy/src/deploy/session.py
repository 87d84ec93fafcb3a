"""One run from bundle to summary: verify, take control, 50 Hz loop, log, measure."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from deploy.bundles.golden import check_golden
from deploy.bundles.loading import load_bundle
from deploy.bundles.manifest import Bundle
from deploy.control.binding import JointBinding
from deploy.control.controller import Controller, ControllerConfig, Mode
from deploy.control.operator import Interrupts, Operator, Unattended
from deploy.control.schedule import Schedule
from deploy.control.watchdog import Watchdog
from deploy.errors import DeployError, RobotError
from deploy.interfaces import Metered, PolicyRuntime, RobotInterface, Simulated
from deploy.logs.messages import Sample
from deploy.logs.metadata import RunInfo
from deploy.logs.reading import read_log
from deploy.logs.trace import TraceRecorder
from deploy.logs.writer import LogWriter
from deploy.measure.summary import FINISHED, RunSummary, summarise
from deploy.policy.onnx_runtime import OnnxRuntime
from deploy.policy.torchscript_runtime import TorchScriptRuntime
from deploy.robots.specs import ROBOTS, mismatches

FALLEN_SHARE = 0.4
"""A simulated base lower over its feet than this share of its height at the start has fallen."""

_LAST_DAMPS, _LAST_PAUSE_S = 25, 0.02
"""How often, and how far apart, s, a robot of metal is damped before it is left alone."""

RuntimeName: TypeAlias = Literal["onnx", "torchscript"]
Observer: TypeAlias = Callable[[Sample], None]
"""Called after every tick."""


def run(
    bundle_dir: str | Path,
    command: tuple[float, float, float],
    duration: float = 20.0,
    log: str | Path | None = None,
    robot: RobotInterface | None = None,
    seed: int = 0,
    config: ControllerConfig | None = None,
    operator: Operator | None = None,
    dry_run: bool = False,
    runtime: RuntimeName = "onnx",
    design: Mapping[str, float] | None = None,
    on_tick: Observer | None = None,
) -> RunSummary:
    """Run a bundle on a robot.

    The golden trace is checked before anything moves. The robot stands up, holds its stance, lets the policy
    in, and walks for `duration`; then, or as soon as a guard trips, it is damped. Ctrl-C damps it too.

    Args:
        bundle_dir: Folder of the bundle.
        command: (vx, vy, yaw_rate), base frame, m/s and rad/s, inside the trained range.
        duration: Time of full control by the policy, s.
        log: Where to write the MCAP log, None for none.
        robot: The robot; None simulates the bundle's own scene (needs the extra `sim`).
        seed: Seed of the simulated robot's initial joint noise.
        config: Timing and thresholds of the controller.
        operator: Who lets the robot go on and can stop it; None agrees to everything, in simulation alone.
        dry_run: Compute and log everything, but send only damping.
        runtime: What runs the networks; "torchscript" needs the extra `torch`.
        design: Scales that a robot of metal was built with, by parameter; what is missing is 1.
        on_tick: Called after every tick, for a view of the run; it costs time of the loop.

    Returns:
        What it achieved and what it cost.

    Raises:
        BundleError: The bundle is not intact or does not reproduce its golden trace.
        RobotError: The robot does not fit the bundle.
        LogError: The log cannot be written.
        DeployError: The command lies outside of the trained range, a robot of metal has no operator, or `mujoco` is
            missing.

    Example:
        >>> summary = run("bundle", (0.5, 0.0, 0.0), duration=20.0, log="walk.mcap")  # doctest: +SKIP
        >>> summary.distance_m, summary.cost_of_transport  # doctest: +SKIP
    """
    bundle = load_bundle(bundle_dir)
    _check_request(bundle, command, duration)
    networks = open_runtime(bundle, runtime)
    check_golden(bundle, networks)
    robot = robot if robot is not None else _simulate(bundle, seed)
    metal = not robot.clock.virtual
    if metal and operator is None:
        raise DeployError(
            f"{robot.spec.name} is no simulation: name its operator, such as Keyboard(), or Unattended() if nobody is "
            "to be asked before it moves"
        )
    if (metal or robot.spec.name in ROBOTS) and (problems := mismatches(bundle, robot.spec, design)):
        raise RobotError(f"{bundle.name} must not run on {robot.spec.name}: {problems[0]}")
    config = config or ControllerConfig()
    info = RunInfo(
        bundle=bundle.name,
        bundle_sha256=bundle.sha256,
        robot=robot.spec.name,
        design=dict(bundle.robot.design),
        total_mass=bundle.robot.total_mass,
        policy_hz=bundle.policy_hz,
        command=command,
        duration_s=duration,
        seed=seed,
        version=version("legged-deploy"),
    )
    recorder = TraceRecorder()
    observers: list[Observer] = [recorder.add, *([] if on_tick is None else [on_tick])]
    with ExitStack() as stack:
        writer = None
        if log is not None:
            writer = stack.enter_context(LogWriter(log, bundle, info, realtime=metal))
            writer.add_metadata("controller", {**asdict(config), "dry_run": dry_run, "runtime": runtime})
        signals = stack.enter_context(Interrupts(operator or Unattended()))
        controller = Controller(bundle, robot, networks, config, signals, dry_run)
        stack.callback(controller.close)
        stack.callback(robot.stop)
        stack.callback(_leave_damped, robot)
        robot.start()
        if metal:
            away = (config.guards.max_skipped + 1) * bundle.period_ns * 1e-9
            observers.insert(0, stack.enter_context(Watchdog(robot.damp, away)))
        _loop(bundle, robot, controller, info, observers, writer)
        summary = summarise(info, recorder.trace())
        if writer is not None:
            writer.add_metadata("result", summary.to_dict())
    return summary


def open_runtime(bundle: Bundle, name: RuntimeName = "onnx") -> PolicyRuntime:
    """The networks of a bundle in the library called `name`.

    Raises:
        BundleError: The networks cannot be opened, or are not those of the manifest.
        DeployError: The library is missing.
    """
    return OnnxRuntime(bundle) if name == "onnx" else TorchScriptRuntime(bundle)


def report(log: str | Path) -> RunSummary:
    """Read a log back and measure the run again, from its messages alone.

    Args:
        log: A .mcap file that `run` wrote.

    Raises:
        LogError: The file is missing, torn, altered, or not a log of this package.
    """
    read = read_log(log)
    return summarise(read.info, read.trace)


def _leave_damped(robot: RobotInterface) -> None:
    """Damp, and on metal again and again for a while: what comes last must arrive."""
    robot.damp()
    if not robot.clock.virtual:
        for _ in range(_LAST_DAMPS):
            time.sleep(_LAST_PAUSE_S)
            robot.damp()


def _simulate(bundle: Bundle, seed: int) -> RobotInterface:
    try:
        from deploy.robots.mujoco_robot import MujocoRobot
    except ImportError as error:
        raise DeployError("no robot given and mujoco is missing: pip install 'legged-deploy[sim]'") from error
    return MujocoRobot(bundle, seed=seed)


def _check_request(bundle: Bundle, command: tuple[float, float, float], duration: float) -> None:
    trained = bundle.command
    for name, value, low, high in zip(trained.names, command, trained.low, trained.high, strict=True):
        if not low - 1e-9 <= value <= high + 1e-9:
            raise DeployError(
                f"command {name} = {value}: outside of the range [{low}, {high}] that {bundle.name} "
                "was trained for; choose a value inside"
            )
    if not 0 < duration < np.inf:
        raise DeployError(f"duration {duration} s: must be positive and finite")


def _loop(
    bundle: Bundle,
    robot: RobotInterface,
    controller: Controller,
    info: RunInfo,
    observers: list[Observer],
    writer: LogWriter | None,
) -> None:
    """Tick until damped; the damped tick is recorded too, it closes the last period."""
    simulated = robot if isinstance(robot, Simulated) else None
    metered = robot if isinstance(robot, Metered) else None
    command = np.array(info.command)
    remaining = round(info.duration_s * info.policy_hz)
    fallen_below = FALLEN_SHARE * simulated.truth().height_over_feet if simulated else 0.0
    binding = JointBinding.of(bundle, robot.spec)
    schedule = Schedule(robot.clock, bundle.period_ns)
    end = ""
    while True:
        try:
            slot = schedule.wait()
            if end:
                controller.stop(end)
            tick = controller.tick(slot, command)
            sample = Sample(
                tick,
                truth=simulated.truth() if simulated else None,
                energy=None if metered is None else binding.energy(metered.energy()),
            )
            if writer is not None:
                writer.write(sample)
            for observe in observers:
                observe(sample)
            if tick.mode is Mode.DAMP:
                return
            remaining -= tick.mode is Mode.POLICY
            stands = not tick.dry_run and tick.mode in (Mode.READY, Mode.RAMP_IN, Mode.POLICY)
            if writer is not None and writer.failure is not None:
                end = writer.failure
            elif sample.truth is not None and stands and sample.truth.height_over_feet < fallen_below:
                height = sample.truth.height_over_feet
                end = f"fell: base {height:.3f} m over its feet, limit {fallen_below:.3f} m"
            elif remaining <= 0:
                end = FINISHED
        except KeyboardInterrupt:
            controller.stop("operator stop: interrupted")
