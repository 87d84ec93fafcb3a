"""What a run will cost, from a short measurement on this machine."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from locorl import PPO, ActorCritic, LeggedEnv
from locorl.interfaces import BodyFactory

from legged_codesign.config import RunConfig

_FIXED_SECONDS = 45.0
"""Start-up, Gaussian process, export, video and report; hardly depends on the machine."""


@dataclass(frozen=True)
class Prediction:
    """Predicted cost of a run from scratch.

    Attributes:
        training_steps: environment steps of pre-training, fine-tuning and imitation.
        evaluation_steps: environment steps of screening and scoring.
        minutes: wall time.
        memory_gb: peak memory.
    """

    training_steps: int
    evaluation_steps: int
    minutes: float
    memory_gb: float

    def __str__(self) -> str:
        """One line for people."""
        return (
            f"{(self.training_steps + self.evaluation_steps) / 1e6:.1f} M environment steps, "
            f"about {self.minutes:.0f} min and {self.memory_gb:.1f} GB on this machine"
        )


def predict(config: RunConfig, factory: BodyFactory) -> Prediction:
    """Time one iteration of fine-tuning and a few steps of evaluation, and add up what the run will do."""
    tune, search, screen, score = config.finetune, config.search, config.screen, config.score
    task = config.pretrain.task
    env = LeggedEnv(factory, np.tile(factory.space.nominal, (tune.num_envs, 1)), task)
    model = ActorCritic(env.group_dims, env.num_actions, config.pretrain.network)
    ppo = PPO(model, replace(tune.ppo, steps=min(6, tune.ppo.steps)), env.num_envs, env.group_dims, 0)
    obs, _ = ppo.collect(env, env.reset())
    ppo.update()
    start = time.perf_counter()
    ppo.collect(env, obs)
    collected = time.perf_counter()
    ppo.update()
    updated = time.perf_counter()
    samples = ppo.rollout.steps * env.num_envs
    train_rate, evaluation_rate = samples / (updated - start), samples / (collected - start)

    evaluations = search.trials + (search.confirm + 1) * search.repeats
    per_second = 1.0 / env.dt
    pretraining = config.pretrain.samples_per_iteration * config.pretrain.iterations if config.from_scratch else 0
    imitation = config.distill_envs * config.imitation.rollout_steps * config.imitation.iterations
    training = pretraining + evaluations * tune.samples + imitation
    scoring = evaluations * 2 * score.robots * score.seconds * per_second
    scoring += screen.bodies * screen.robots * screen.seconds * per_second
    seconds = training / train_rate + scoring / evaluation_rate + _FIXED_SECONDS
    # buffers of the largest stage, beside what is loaded already
    stored = max(tune.num_envs * tune.ppo.steps, pretraining and config.pretrain.samples_per_iteration)
    memory = _peak_gb() + (stored * 150 * 4 * 3 + imitation / config.imitation.iterations * 16 * 90 * 4) / 1e9
    return Prediction(int(training), int(scoring), seconds / 60, memory + 0.3)


def _peak_gb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)
