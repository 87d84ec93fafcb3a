"""What a run will cost, from a short measurement on this machine."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from locorl import PPO, ActorCritic, LeggedEnv
from locorl.interfaces import BodyFactory
from locorl.training.cost import in_words

from legged_codesign.config import RunConfig
from legged_codesign.machines import Machines
from legged_codesign.tasks import searched_task

_FIXED_SECONDS = 45.0
"""Start-up, Gaussian process, export, video and report; hardly depends on the machine."""
_ROBOTS, _STEPS = 512, 6
"""Most robots and steps of the trial run."""
_SEEING = 5.0
"""Times that a student's step with depth camera and recurrent encoder takes of one without, on 2 cores."""


@dataclass(frozen=True)
class Prediction:
    """Predicted cost of a run from its beginning.

    Attributes:
        training_steps: environment steps of pre-training, fine-tuning and imitation.
        evaluation_steps: environment steps of screening and scoring.
        minutes: wall time.
        memory_gb: peak memory.
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

    Measured with few robots: many cost a little less each. Trials on other machines are taken to be as fast as here.
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
    seconds = (
        pretraining / train_rate + (trials * tune.samples / train_rate + scoring / evaluation_rate) / machines.workers
    )
    seconds += screening / evaluation_rate + slower * (distil.samples / train_rate + judging / evaluation_rate)
    # buffers of the largest stage, beside what is loaded already
    stored = max(tune.num_envs * tune.ppo.steps, config.pretrain.samples_per_iteration if pretraining else 0)
    columns = sum(env.group_dims.values())
    memory = _peak_gb() + 4e-9 * (3 * stored * columns + 16 * distil.robots * 24 * columns) + 0.3
    policy = 4e-9 * sum(each.numel() for each in model.parameters())
    disk = policy * (trials + 8) + 0.02
    steps = (int(pretraining + trials * tune.samples + distil.samples), int(scoring + screening + judging))
    return Prediction(*steps, seconds / 60 + _FIXED_SECONDS / 60, memory, disk)


def _peak_gb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)
