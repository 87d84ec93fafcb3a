"""How fast do other ways simulate the same robots on this CPU?

Go2's nominal body on flat ground: one model, the same physics steps in a control step, the same initial state, the same
joint targets stance + N(0, 0.15) rad, and every robot makes the same number of control steps.

- LeggedEnv: with observations, rewards, ends and restarts;
- mujoco.batch.Batch: its simulator alone;
- mujoco.rollout: MuJoCo's own threads for open-loop rollouts, called once per control step, as a policy needs it (each
  call forgets the solver's warm start), and once for all steps, as no policy can be run;
- Gymnasium's AsyncVectorEnv (a process for each robot) and SyncVectorEnv, over a plain environment that steps MuJoCo
  and returns qpos and qvel; as such a vector has few robots, one group of robots follows the other;
- MJX on JAX's CPU backend, in an environment of its own (`pip install mujoco-mjx "jax[cpu]"`), whose interpreter
  `--mjx` names. Its model has no contact sensors, which MJX lacks, and fewer robots, as it is far slower.

Prints control steps per second. The median height of the bases at the end shows that all simulate the same.

    python benchmarks/simulators.py
    python benchmarks/simulators.py --mjx /path/to/venv/bin/python
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

# not the folder of this file: it has a morphgen.py, which `import morphgen` would find
sys.path[0] = str(Path(__file__).parents[1])

import gymnasium
import mujoco
import numpy as np
import tyro
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv
from locorl import LeggedEnv, flat_scene, make_task, no_randomisation, repeat_design
from locorl.simulation.cpu import available_cores
from morphgen import BodyFactory, go2
from mujoco.rollout import Rollout
from numpy.typing import NDArray

from benchmarks.measure import bare_batch, joint_targets, machine, noisy_stance


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    envs: int = 1024
    steps: int = 50
    """Control steps of each robot in one run."""
    runs: int = 4
    """Runs of each, in turns; MJX comes last."""
    vector_envs: tuple[int, ...] = (2, 8, 32)
    """Robots, hence processes, in Gymnasium's AsyncVectorEnv; SyncVectorEnv takes the first number."""
    mjx: Path | None = None
    """Python interpreter of an environment that has mujoco-mjx."""
    mjx_envs: int = 128
    """Robots in MJX, on a CPU its rate is the same for 16; with 512 it did not start within four minutes."""
    seed: int = 0


@dataclass(frozen=True)
class Work:
    """What every way has to simulate.

    Attributes:
        model: the robot on its ground, its fields those of the environment.
        qpos: initial state of every robot, at rest, (19,).
        targets: joint targets, (steps, N, 12), rad.
        substeps: physics steps in a control step.
    """

    model: mujoco.MjModel
    qpos: NDArray[np.float64]
    targets: NDArray[np.float64]
    substeps: int


Run = Callable[[], tuple[float, NDArray[np.float64]]]
"""Makes all steps once; seconds, and the heights of the bases at the end."""


class PlainRobot(gymnasium.Env):
    """One robot the plain way: the action is `ctrl`, the observation qpos and qvel."""

    def __init__(self, model: mujoco.MjModel, qpos: NDArray[np.float64], substeps: int) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.start, self.substeps = qpos, substeps
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (model.nq + model.nv,), np.float64)
        self.action_space = gymnasium.spaces.Box(-np.inf, np.inf, (model.nu,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[NDArray[np.float64], dict]:
        """Start at rest."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.start
        return self._observation(), {}

    def step(self, action: NDArray[np.float64]) -> tuple[NDArray[np.float64], float, bool, bool, dict]:
        """Advance one control period."""
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, self.substeps)
        return self._observation(), 0.0, False, False, {}

    def _observation(self) -> NDArray[np.float64]:
        return np.concatenate((self.data.qpos, self.data.qvel))


def run_env(env: LeggedEnv, seed: int, steps: int) -> Run:
    """LeggedEnv."""
    actions = noisy_stance(env, steps, seed)

    def run() -> tuple[float, NDArray[np.float64]]:
        env.reset(seed=seed)
        begin = time.perf_counter()
        for action in actions:
            env.step(action)
        return time.perf_counter() - begin, env.sim.qpos[:, 2].numpy()

    return run


def run_batch(env: LeggedEnv, work: Work) -> Run:
    """mujoco.batch.Batch."""
    batch = bare_batch(env)
    qpos, ctrl = batch.bind("qpos"), batch.bind("ctrl")

    def run() -> tuple[float, NDArray[np.float64]]:
        batch.reset()
        qpos[...] = work.qpos
        begin = time.perf_counter()
        for target in work.targets:
            ctrl[...] = target
            batch.step(nstep=work.substeps)
        return time.perf_counter() - begin, qpos[:, 2]

    return run


def run_rollout(work: Work, together: bool) -> Run:
    """mujoco.rollout, all steps in one call or one call for each."""
    steps, robots, joints = work.targets.shape
    threads = Rollout(nthread=available_cores())
    data = [mujoco.MjData(work.model) for _ in range(available_cores())]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    data[0].qpos[:] = work.qpos
    first = np.zeros(mujoco.mj_stateSize(work.model, kind))
    mujoco.mj_getState(work.model, data[0], first, kind)
    height = int(mujoco.mj_stateSize(work.model, mujoco.mjtState.mjSTATE_TIME)) + 2
    calls = 1 if together else steps
    # each call: (robots, physics steps, joints)
    control = np.repeat(work.targets, work.substeps, axis=0).reshape(calls, -1, robots, joints).swapaxes(1, 2).copy()
    length = control.shape[2]
    states = np.zeros((robots, length, len(first)))
    sensors = np.zeros((robots, length, work.model.nsensordata))

    def run() -> tuple[float, NDArray[np.float64]]:
        states[:, -1] = first
        begin = time.perf_counter()
        for part in control:
            start = states[:, -1].copy()
            threads.rollout(work.model, data, start, part, nstep=length, state=states, sensordata=sensors)
        return time.perf_counter() - begin, states[:, -1, height]

    return run


def run_vector(vector: VectorEnv, work: Work) -> Run:
    """A Gymnasium vector of plain robots: one group of robots after the other."""
    groups = [work.targets[:, at : at + vector.num_envs] for at in range(0, work.targets.shape[1], vector.num_envs)]

    def run() -> tuple[float, NDArray[np.float64]]:
        elapsed, heights = 0.0, []
        for targets in groups:
            observation, _ = vector.reset()
            begin = time.perf_counter()
            for target in targets:
                observation, *_ = vector.step(target)
            elapsed += time.perf_counter() - begin
            heights.append(observation[:, 2].copy())
        return elapsed, np.concatenate(heights)

    return run


def measure_mjx(python: Path, factory: BodyFactory, env: LeggedEnv, work: Work, runs: int) -> dict:
    """What `mjx_worker.py` finds under another interpreter; `failure` is the reason if it finds nothing."""
    spec = factory.spec(factory.space.nominal, flat_scene(env.task.physics))
    for sensor in list(spec.sensors):
        if sensor.type == mujoco.mjtSensor.mjSENS_CONTACT:
            spec.delete(sensor)
    for geom, friction in zip(spec.geoms, work.model.geom_friction, strict=True):
        geom.friction = friction
    spec.compile()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "robot.xml").write_text(spec.to_xml(), encoding="utf-8")
        np.savez(path / "work.npz", qpos=work.qpos, targets=work.targets, substeps=work.substeps, runs=runs)
        worker = Path(__file__).with_name("mjx_worker.py")
        try:
            done = subprocess.run((str(python), str(worker), folder), capture_output=True, text=True)
        except OSError as error:
            return {"failure": str(error)}
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    if done.returncode != 0:
        return {"failure": lines[-1] if lines else f"exit status {done.returncode}"}
    return json.loads(lines[-1])


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    if any(options.envs % count for count in options.vector_envs):
        raise SystemExit(f"--envs {options.envs} must be a multiple of each of --vector-envs {options.vector_envs}")
    factory = go2()
    task = replace(make_task("locomotion-flat"), randomisation=no_randomisation())
    designs = repeat_design(factory, factory.space.nominal, options.envs)
    env = LeggedEnv(factory, designs, task, seed=options.seed)
    env.reset(seed=options.seed)
    targets = joint_targets(env, noisy_stance(env, options.steps, options.seed))
    work = Work(env.sim.model_of(0), env.sim.qpos[0].numpy().copy(), targets, task.physics.substeps)

    plain = partial(PlainRobot, work.model, work.qpos, work.substeps)
    vectors: dict[str, VectorEnv] = {
        f"AsyncVectorEnv, {count} processes": AsyncVectorEnv([plain] * count) for count in options.vector_envs
    }
    vectors["SyncVectorEnv"] = SyncVectorEnv([plain] * options.vector_envs[0])
    ways: dict[str, Run] = {
        "LeggedEnv": run_env(env, options.seed, options.steps),
        "mujoco.batch.Batch": run_batch(env, work),
        "mujoco.rollout, step by step": run_rollout(work, together=False),
        "mujoco.rollout, all at once": run_rollout(work, together=True),
        **{name: run_vector(vector, work) for name, vector in vectors.items()},
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    heights: dict[str, float] = {}
    for turn in range(options.runs + 1):
        for name, run in ways.items():
            elapsed, height = run()
            heights[name] = float(np.median(height))
            if turn > 0:  # the first one warms up
                seconds[name].append(elapsed)
    for vector in vectors.values():
        vector.close()

    count = options.envs * options.steps
    ours = count / float(np.median(seconds["LeggedEnv"]))
    print(f"{options.envs} robots, {options.steps} control steps of {task.physics.substeps} physics steps")
    print(f"{f'median of {options.runs} runs':30} control steps/s  ratio to ours  base height at the end")

    def row(name: str, elapsed: list[float], height: float) -> None:
        rate = count / float(np.median(elapsed))
        print(f"{name:30} {rate:15,.0f}  {rate / ours:13.3f}  {height:20.4f} m", flush=True)

    for name, elapsed in seconds.items():
        row(name, elapsed, heights[name])
    if options.mjx is None:
        print(f"{'MJX on the CPU':30} not measured: --mjx names the interpreter of an environment that has it")
    else:
        few = replace(work, targets=work.targets[:, : options.mjx_envs])
        mjx = measure_mjx(options.mjx, factory, env, few, options.runs)
        if "failure" in mjx:
            print(f"{'MJX on the CPU':30} did not run: {mjx['failure']}")
        else:
            share = options.envs / few.targets.shape[1]
            name = f"MJX on the CPU, {few.targets.shape[1]} robots"
            row(name, [share * elapsed for elapsed in mjx["seconds"]], mjx["height"])
            print(f"MJX: {mjx['versions']}, after {mjx['compilation']:.0f} s of compilation, single precision")
    print(machine())


if __name__ == "__main__":
    main()
