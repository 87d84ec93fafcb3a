"""How fast is a policy's tick, how much of it is the network, and does the loop keep 50 Hz?

Takes the shipped blind Go2, or the folder of another blind student. Four measurements, one thread each:

- network: a batch of one through the student, recurrent state fed back, by onnxruntime (as deployed), by TorchScript
  and by the eager torch module it was exported from, in turns; before that all three must give the same actions;
- whole tick: read, guards, inference, write, log, of a robot that costs nothing to read. Once as the loop feels it,
  where the log is a queue, and once with the log's thread waited for, so that encoding and writing count in full;
- simulation: simulated time, with physics and log, over the time that passed, in runs of two minutes;
- real time: ticks by the wall clock, ten minutes of them, their mean rate, the late and the skipped.

Targets: eager torch over onnxruntime at least 2; whole tick under 2 ms at the 99th percentile; ten minutes simulated in
less; 49.95 to 50.05 Hz over 30000 ticks.

    python benchmarks/deploy.py
    python benchmarks/deploy.py runs/laptop-go2-flat-cost-of-transport --realtime 0
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

# not the folder of this file: `import deploy` would find this file
sys.path[0] = str(Path(__file__).parents[1])
# one thread for every library, as on a robot
os.environ.setdefault("OMP_NUM_THREADS", "1")

import distill
import numpy as np
import torch
import tyro
from deploy import Controller, ControllerConfig, OnnxRuntime, Unattended, load_bundle, run
from deploy.bundles.manifest import Bundle
from deploy.control.clock import WallClock
from deploy.control.guards import GuardLimits
from deploy.control.schedule import Schedule
from deploy.interfaces import Clock, DepthFrame, JointCommand, RobotSpec, RobotState
from deploy.logs.messages import Sample
from deploy.logs.metadata import RunInfo
from deploy.logs.writer import LogWriter
from deploy.policy.torchscript_runtime import TorchScriptRuntime
from locorl import load_policy
from numpy.typing import NDArray

from benchmarks.measure import alternate, machine

COMMAND = (0.5, 0.0, 0.0)
LONGEST = 120.0
"""Of one simulated run, s: at the command's speed the ground ends, and the robot falls off, after 140 s."""
PATIENT = ControllerConfig(guards=GuardLimits(max_skipped=100, max_skipped_per_s=100))
"""Goes on when a virtual machine was away: what that costs is counted, where on a robot it damps."""
PRETRAINED = Path(__file__).parents[1] / "src" / "legged_codesign" / "pretrained"
STUDENTS = ("student.pt", "student/student.pt", "student/student/student.pt")
"""Where folders keep the student: one that ships, a study's, a run's."""
SAME = 1e-4
"""Largest difference of actions between runtimes that are to be compared."""


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    folder: tyro.conf.Positional[Path] = PRETRAINED / "go2-blind"
    """With `bundle/`, `teacher.pt` and the student: one that ships, or of a finished `codesign run`."""
    ticks: int = 2000
    """Ticks of each run of a network, and of the whole tick."""
    runs: int = 8
    """Alternating runs of each network."""
    simulate: float = 600.0
    """Time to simulate, s; 0: none."""
    realtime: int = 30000
    """Ticks by the wall clock, ten minutes; 0: none."""


class VirtualClock:
    """Time that passes at once."""

    virtual = True

    def __init__(self) -> None:
        self._now = 0

    def now_ns(self) -> int:
        """Current time, ns."""
        return self._now

    def sleep_until(self, time_ns: int) -> None:
        """It is `time_ns`."""
        self._now = max(self._now, time_ns)


class StillRobot:
    """Stands in its stance; reading and writing cost next to nothing."""

    def __init__(self, bundle: Bundle, clock: Clock) -> None:
        self.spec = RobotSpec("still", bundle.joint_names, noiseless=True)
        self.clock = clock
        zeros = np.zeros(len(bundle.joints))
        stance, level = bundle.per_joint("stance"), np.array(bundle.start_quat_wxyz)
        self._state = RobotState(0, 0, stance, zeros, zeros, level, np.zeros(3), np.array([0.0, 0.0, 9.81]))

    def start(self) -> None:
        """Nothing to do."""

    def stop(self) -> None:
        """Nothing to do."""

    def read(self) -> RobotState:
        """The stance, now."""
        self._state = replace(self._state, stamp_ns=self.clock.now_ns(), seq=self._state.seq + 1)
        return self._state

    def read_depth(self) -> DepthFrame | None:
        """No camera."""
        return None

    def write(self, command: JointCommand) -> None:
        """Nothing to do."""

    def damp(self) -> None:
        """Nothing to do."""


def compare_networks(bundle: Bundle, student: distill.Student, options: Benchmark) -> dict[str, NDArray[np.float64]]:
    """Microseconds per tick of each runtime, (runs,)."""
    onnx, script = OnnxRuntime(bundle), TorchScriptRuntime(bundle)
    rng = np.random.default_rng(0)
    frames = rng.standard_normal((options.ticks, bundle.observation_size)).astype(np.float32)

    def eager(obs: NDArray[np.float32], history: list[torch.Tensor]) -> NDArray[np.float32]:
        with torch.inference_mode():
            action, _, history[0] = student(torch.from_numpy(obs[None]), history[0])
        return action[0].numpy()

    empty = torch.zeros(1, student.config.history, student.proprio)
    history = [empty]
    for obs in frames[:50]:
        wanted = eager(obs, history)
        for name, runtime in (("onnxruntime", onnx), ("TorchScript", script)):
            error = np.abs(runtime.step(obs).action - wanted).max()
            assert error < SAME, f"{name} gives other actions than eager torch: {error:.1e}"

    def timed(step: Callable[[NDArray[np.float32]], object]) -> Callable[[], float]:
        def measure() -> float:
            begin = time.perf_counter()
            for obs in frames:
                step(obs)
            return time.perf_counter() - begin

        return measure

    steps = {"onnxruntime": onnx.step, "TorchScript": script.step, "eager torch": lambda obs: eager(obs, history)}
    seconds = alternate(options.runs, [timed(step) for step in steps.values()])
    return {name: seconds[:, index] / options.ticks * 1e6 for index, name in enumerate(steps)}


def whole_ticks(bundle: Bundle, ticks: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Milliseconds of each tick under full control, (T,): until the sample is queued, and until it is written."""
    robot = StillRobot(bundle, VirtualClock())
    controller = Controller(bundle, robot, OnnxRuntime(bundle))
    schedule = Schedule(robot.clock, bundle.period_ns)
    info = RunInfo(
        bundle=bundle.name,
        bundle_sha256=bundle.sha256,
        robot="still",
        design=dict(bundle.robot.design),
        total_mass=bundle.robot.total_mass,
        policy_hz=bundle.policy_hz,
        command=COMMAND,
        duration_s=ticks / bundle.policy_hz,
        seed=0,
        version="0",
    )
    queued, written = [], []
    command = np.array(COMMAND)
    with tempfile.TemporaryDirectory() as folder, LogWriter(Path(folder) / "ticks.mcap", bundle, info) as log:
        while len(queued) < ticks:
            slot = schedule.wait()
            begin = time.perf_counter()
            tick = controller.tick(slot, command)
            log.write(Sample(tick))
            middle = time.perf_counter()
            log.drain()
            if tick.mode.value == "policy":
                queued.append(middle - begin)
                written.append(time.perf_counter() - begin)
            assert not tick.reason, tick.reason
    return np.array(queued) * 1e3, np.array(written) * 1e3


def simulate(bundle: Bundle, seconds: float) -> str:
    """A sentence on `seconds` of simulation, logged, in runs that end before the ground does."""
    simulated, falls, seed = 0.0, [], 0
    begin = time.perf_counter()
    while simulated < seconds:
        with tempfile.TemporaryDirectory() as folder:
            left = min(seconds - simulated, LONGEST)
            summary = run(bundle.root, COMMAND, left, log=Path(folder) / "run.mcap", seed=seed)
        simulated += summary.ticks / bundle.policy_hz
        seed += 1
        if summary.fell:
            falls.append(f"{summary.ticks / bundle.policy_hz:.0f} s")
    speed = simulated / (time.perf_counter() - begin)
    return f"{simulated:.0f} s in {seed} runs at {speed:.1f} times real time; falls: {', '.join(falls) or 'none'}"


def keep_time(bundle: Bundle, ticks: int) -> str:
    """A sentence on `ticks` ticks by the wall clock, logged."""
    samples: list[Sample] = []
    with tempfile.TemporaryDirectory() as folder:
        summary = run(
            bundle.root,
            COMMAND,
            duration=ticks / bundle.policy_hz,
            log=Path(folder) / "run.mcap",
            robot=StillRobot(bundle, WallClock()),
            config=PATIENT,
            operator=Unattended(),
            design=bundle.robot.design,
            on_tick=samples.append,
        )
    slots = [sample.tick.slot for sample in samples if sample.tick.mode.value == "policy"]
    if len(slots) < 2:
        return f"no ticks: {summary.reason}"
    rate = (len(slots) - 1) / ((slots[-1].start_ns - slots[0].start_ns) * 1e-9)
    took = [(s.tick.done_ns - s.tick.slot.start_ns) * 1e-6 for s in samples]
    late = [(slot.start_ns - slot.due_ns) * 1e-6 for slot in slots]
    return (
        f"{len(slots)} ticks at {rate:.4f} Hz; {summary.late} late, {summary.skipped} skipped; start after its time "
        f"99 % {np.percentile(late, 99):.2f} ms, worst {max(late):.2f} ms; command out after 99 % "
        f"{np.percentile(took, 99):.2f} ms; ended: {summary.reason}"
    )


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    torch.set_num_threads(1)
    bundle = load_bundle(options.folder / "bundle")
    found = [path for name in STUDENTS if (path := options.folder / name).is_file()]
    if not found:
        sys.exit(f"{options.folder}: holds none of {', '.join(STUDENTS)}; give the folder of a student")
    student = distill.load_student(found[0], load_policy(options.folder / "teacher.pt"))
    print(f"{bundle.name}, {bundle.observation_size} inputs, {options.ticks} ticks a run, {options.runs} runs of each")
    times = compare_networks(bundle, student, options)
    print(f"{'network, batch of one':24}  median, us   eager over it (lowest to highest)")
    for name, values in times.items():
        ratio = times["eager torch"] / values
        print(f"{name:24}  {np.median(values):10.1f}   {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})")
    print(f"\n{'whole tick, ms':24}  median    99 %   worst")
    for name, values in zip(("log queued", "log written"), whole_ticks(bundle, options.ticks), strict=True):
        print(f"{name:24}  {np.median(values):6.3f}  {np.percentile(values, 99):6.3f}  {values.max():6.3f}")
    if options.simulate > 0:
        print(f"\nsimulation: {simulate(bundle, options.simulate)}")
    if options.realtime > 0:
        print(f"\nwall clock: {keep_time(bundle, options.realtime)}")
    print(machine())


if __name__ == "__main__":
    main()
