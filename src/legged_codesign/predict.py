"""What a run will cost, from a short measurement on this machine."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from locorl import PPO, ActorCritic, LeggedEnv, SimulatorConfig
from locorl.interfaces import BodyFactory
from locorl.simulation.cpu import available_cores
from locorl.training.cost import in_words
from torch import Tensor

from legged_codesign.config import DistilConfig, RunConfig
from legged_codesign.machines import Machines
from legged_codesign.tasks import searched_task

_FIXED_SECONDS = 45.0
"""Start-up, Gaussian process, export, video and report; hardly depends on the machine."""
_ROBOTS, _STEPS = 512, 6
"""Most robots and steps of the trial run."""
_SEEING = 5.0
"""Times that a student's step with depth camera and recurrent encoder takes of one without, on 2 cores."""
_FIXED_BYTES = 4e6
"""Report, bundle, study, and other small files of a run."""
_LOGGED = 8e4
"""Bytes of a second of the student's run in its log."""
_MARGIN_GB = 0.3
"""For what the trial run does not show: pictures, the Gaussian process, export."""


@dataclass(frozen=True)
class Prediction:
    """Predicted cost of a run from its beginning.

    Attributes:
        training_steps: environment steps of pre-training, fine-tuning and imitation.
        evaluation_steps: environment steps of screening and scoring.
        minutes: wall time.
        memory_gb: peak memory on this machine, its workers included.
        disk_gb: size of the run folder.
    """

    training_steps: int
    evaluation_steps: int
    minutes: float
    memory_gb: float
    disk_gb: float

    def __str__(self) -> str:
        """One line for people."""
        return (
            f"{(self.training_steps + self.evaluation_steps) / 1e6:.1f} M environment steps, "
            f"{in_words(60 * self.minutes)}, {self.memory_gb:.1f} GB of memory and {self.disk_gb:.2f} GB of disk "
            "on this machine"
        )


def predict(config: RunConfig, factory: BodyFactory, machines: Machines | None = None) -> Prediction:
    """Time a few steps of fine-tuning and add up what the run will do.

    Measured with few robots: many cost a little less each. Cores and GPUs of other machines are taken to be as fast as
    those here.
    """
    machines = machines or Machines()
    tune, search, screen, score = config.finetune, config.search, config.screen, config.score
    task = searched_task(config.task, config.pretrain.task)
    robots = min(tune.num_envs, _ROBOTS)
    designs = np.tile(factory.space.nominal, (robots, 1))
    env = LeggedEnv(factory, designs, task, simulator=tune.simulator)
    model = ActorCritic(env.group_dims, env.num_actions, config.pretrain.network).to(env.device)
    ppo = PPO(model, replace(tune.ppo, steps=min(_STEPS, tune.ppo.steps)), robots, env.group_dims, 0)
    obs, _ = ppo.collect(env, env.reset())
    ppo.update()
    start = time.perf_counter()
    ppo.collect(env, obs)
    collected = time.perf_counter()
    ppo.update()
    updated = time.perf_counter()
    samples = ppo.rollout.steps * robots
    train_rate, evaluation_rate = samples / (updated - start), samples / (collected - start)

    trials = search.trials + (search.confirm + 1) * search.repeats
    per_second = 1.0 / env.dt
    pretraining = config.pretrain.samples_per_iteration * config.pretrain.iterations if config.from_scratch else 0
    # generalist and fine-tuned policy, to choose and to report
    scoring = trials * 4 * score.robots * score.seconds * per_second
    screening = (screen.bodies + 1) * screen.robots * screen.seconds * per_second
    distil = config.distil
    judging = distil.judged.robots_per_body * distil.judged.seconds * per_second * (2 if distil.adapt is None else 3)
    slower = _SEEING if distil.depth else 1.0
    seconds = pretraining / train_rate
    seconds += (trials * tune.samples / train_rate + scoring / evaluation_rate) / speedup(machines, tune.simulator)
    seconds += screening / evaluation_rate + slower * (distil.samples / train_rate + judging / evaluation_rate)
    policy = 4 * sum(each.numel() for each in model.parameters())
    state = _bytes(env.state_dict()) / robots
    columns = sum(env.group_dims.values())

    def training(robots: int, steps: int) -> float:
        """Buffers of a training, bytes."""
        return 3 * 4 * columns * robots * steps + robots * state

    student = student_data(distil, env.group_dims["proprio"], model.latent_dim, per_second)
    pretrained = training(config.pretrain.num_envs, config.pretrain.ppo.steps) if pretraining else 0.0
    trial = training(tune.num_envs, tune.ppo.steps)
    memory = memory_gb(machines, _peak_gb(), trial, max(pretrained, student))
    disk = _FIXED_BYTES + (trials + 5) * policy + student + _LOGGED * config.deploy.seconds
    # the last checkpoint and the one before, each with Adam's two moments and the robots' state
    trainings = [config.pretrain.num_envs] if pretraining else []
    trainings += [] if distil.adapt is None else [distil.adapt.finetune.num_envs]
    disk += sum(policy + 2 * (3 * policy + state * each) for each in trainings)
    steps = (int(pretraining + trials * tune.samples + distil.samples), int(scoring + screening + judging))
    return Prediction(*steps, seconds / 60 + _FIXED_SECONDS / 60, memory, 1e-9 * disk)


def speedup(machines: Machines, simulator: SimulatorConfig) -> float:
    """How much sooner trials are done than one after the other on all of this machine.

    Workers on this machine share its cores, or the GPU if they have none each, and so gain nothing from being many.
    """
    local, cores = machines.executor == "local", available_cores()
    if simulator.backend == "cpu":
        share = machines.workers * (machines.threads or cores) / cores
        return min(1.0, share) if local else share
    return 1.0 if local and not machines.gpus else float(machines.workers)


def memory_gb(machines: Machines, process: float, trial: float, other: float) -> float:
    """Peak memory on this machine, GB.

    Args:
        machines: what the trials run on.
        process: what is loaded and held already, GB; so much has each worker, too.
        trial: buffers of a trial, bytes.
        other: of the largest other stage, bytes.
    """
    if machines.here:
        return process + 1e-9 * max(trial, other) + _MARGIN_GB
    search = machines.workers * (process + 1e-9 * trial) if machines.executor == "local" else 0.0
    return process + max(search, 1e-9 * other) + _MARGIN_GB


def student_data(config: DistilConfig, proprio: int, latent: int, per_second: float) -> float:
    """What a student learns from, in memory and in its checkpoint, bytes.

    Args:
        config: the student.
        proprio: columns of a frame of its observation.
        latent: columns of the teacher's latent.
        per_second: control steps.
    """
    labels = 3 + 12  # velocity and action
    if config.depth:
        train, camera = config.vision, config.camera
        images = train.rollout_steps / per_second / camera.period * camera.rows * camera.columns
        return 4.0 * config.robots * train.memory * (train.rollout_steps * (proprio + labels) + images)
    imitation = config.imitation
    frames = imitation.ring_rollouts * imitation.rollout_steps + config.student.history
    return config.robots * frames * (4.0 * (proprio + labels + latent) + 8.0)


def _bytes(content: object) -> int:
    """Of all tensors in nested mappings and sequences."""
    if isinstance(content, Tensor):
        return content.numel() * content.element_size()
    if isinstance(content, Mapping):
        return sum(map(_bytes, content.values()))
    return sum(map(_bytes, content)) if isinstance(content, list | tuple) else 0


def _peak_gb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)
