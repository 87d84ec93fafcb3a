"""Presets: how much of everything, and where it is meant to run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import distill
import locorl
from locorl import EvalConfig, FinetuneConfig, NetworkConfig, PPOConfig, SimulatorConfig, TrainConfig

from legged_codesign.adapt import AdaptConfig
from legged_codesign.config import (
    DeployConfig,
    DistilConfig,
    Objective,
    RunConfig,
    ScoreConfig,
    ScreenConfig,
    SearchConfig,
)
from legged_codesign.tasks import TaskName, find_task, pretraining_task

HARDWARE_BOUNDS = (("front_shank", 1.0, 1.4), ("hind_shank", 1.0, 1.4))
HARDWARE_FIXED = (("front_thigh", 1.0), ("hind_thigh", 1.0))
"""Section IV-C1: the thighs of a built robot, a Go2, stay, its shanks can be lengthened."""

POWER_WEIGHT = -2.0
"""Reward weight of positive mechanical power over body weight while fine-tuning for energy."""


def default_objective(name: str) -> Objective:
    """What a preset scores bodies by if nothing is said: `paper` by the return of eq. 9, ours by what a walk costs."""
    return "return" if name == "paper" else "cost-of-transport"


def preset(name: str, objective: Objective | None = None, task: TaskName = "flat") -> RunConfig:
    """The configuration of a preset.

    `smoke` proves the plumbing from scratch within 3 minutes on 2 cores and claims no quality. `laptop`
    starts from the shipped generalist and takes at most 15 minutes on 2 cores on level ground. `workstation` is for
    one GPU or many cores, and hours. `paper` is section IV to the letter, for one or several GPUs.

    Args:
        name: of the preset.
        objective: what bodies are scored by, None: see `default_objective`; for energy and cost of transport the
            fine-tuning reward weighs mechanical power as well, so that it optimises what the search scores.
        task: what bodies are searched for.

    Raises:
        ValueError: there is no such preset or task.
    """
    if name not in _PRESETS:
        raise ValueError(f"no preset '{name}'; choose one of {', '.join(_PRESETS)}")
    objective = objective or default_objective(name)
    config = replace(_PRESETS[name](task), preset=name, task=task, robot=find_task(task).robot, objective=objective)
    weight = None if objective == "return" else POWER_WEIGHT
    return replace(config, finetune=replace(config.finetune, specific_power=weight))


def on_simulator(config: RunConfig, simulator: SimulatorConfig) -> RunConfig:
    """The run with its trainings and evaluations on another simulator."""
    adapt = config.distil.adapt
    if adapt is not None:
        adapt = replace(adapt, finetune=replace(adapt.finetune, simulator=simulator))
    return replace(
        config,
        pretrain=replace(config.pretrain, simulator=simulator),
        finetune=replace(config.finetune, simulator=simulator),
        distil=replace(config.distil, adapt=adapt, simulator=simulator),
    )


def _laptop(task: TaskName) -> RunConfig:
    chosen = find_task(task)
    # for --from-scratch; see results/*-from-scratch
    iterations = {"flat": 160, "rough": 320, "parkour": 800}[chosen.shipped]
    config = RunConfig(
        pretrain=TrainConfig(iterations=iterations, ppo=PPOConfig(mirror=True), task=pretraining_task(task, "laptop")),
        finetune=FinetuneConfig(command_vx=(0.4, 0.8)),
        distil=DistilConfig(adapt=None, judged=_judged(robots=16)),
    )
    if task == "flat":
        return config
    # where robots steer themselves their commands stay as they are; obstacles differ, so more robots are asked
    config = replace(
        config,
        finetune=FinetuneConfig(iterations=16),
        score=ScoreConfig(robots=60, max_error=0.15),
        distil=replace(config.distil, adapt=AdaptConfig(), judged=_judged(robots=100)),
    )
    if not chosen.parkour:
        return config
    return replace(
        config,
        screen=ScreenConfig(seconds=16.0),
        score=ScoreConfig(vx=(0.8, 0.8), seconds=20.0, robots=60, max_error=0.3),
        distil=replace(
            config.distil,
            depth=True,
            robots=128,
            vision=distill.VisionTrainConfig(updates=16, batch=64),
            judged=EvalConfig(vx=(0.9, 1.0), robots_per_body=100, reset_joint=0.1, seed=4242),
        ),
        deploy=DeployConfig(speed=0.8),
    )


def _judged(robots: int) -> EvalConfig:
    """Student and teacher side by side, at the speed of the student's final run."""
    speed = DeployConfig().speed
    return EvalConfig(vx=(speed, speed), robots_per_body=robots, reset_joint=0.1, seed=4242)


def _smoke(task: TaskName) -> RunConfig:
    laptop = _laptop(task)
    ppo = PPOConfig(steps=12, epochs=2, minibatches=2)
    return replace(
        laptop,
        from_scratch=True,
        pretrain=replace(laptop.pretrain, num_envs=64, iterations=6, save_every=3, ppo=ppo),
        screen=ScreenConfig(bodies=8, robots=1, seconds=1.0, promote=1),
        search=SearchConfig(trials=4, initial=3, confirm=1, repeats=2),
        finetune=replace(laptop.finetune, num_envs=32, iterations=2, ppo=ppo),
        score=replace(laptop.score, seconds=3.0, robots=4),
        distil=replace(
            laptop.distil,
            adapt=None if laptop.distil.adapt is None else _few(laptop.distil.adapt, 16, 2, ppo),
            robots=16,
            imitation=distill.TrainConfig(
                iterations=4, rollout_steps=12, segment=2, updates=4, batch=256, ring_rollouts=4
            ),
            vision=distill.VisionTrainConfig(iterations=2, rollout_steps=10, segment=1, updates=1, batch=8),
            judged=replace(laptop.distil.judged, seconds=3.0, settle=1.0, robots_per_body=4),
        ),
        deploy=replace(laptop.deploy, seconds=3.0),
    )


def _few(adapt: AdaptConfig, robots: int, iterations: int, ppo: PPOConfig) -> AdaptConfig:
    return replace(adapt, finetune=replace(adapt.finetune, num_envs=robots, iterations=iterations, ppo=ppo))


def _workstation(task: TaskName) -> RunConfig:
    laptop, paper = _laptop(task), _paper(task)
    chosen = find_task(task)
    iterations = {"flat": 400, "rough": 1000, "parkour": 1500}[chosen.shipped]
    ppo = PPOConfig(mirror=True)
    tune = replace(laptop.finetune, num_envs=1024, iterations=60, ppo=replace(laptop.finetune.ppo, mirror=True))
    return replace(
        laptop,
        from_scratch=True,
        pretrain=TrainConfig(
            num_envs=4096, iterations=iterations, ppo=ppo, task=laptop.pretrain.task, network=NetworkConfig.paper()
        ),
        screen=replace(laptop.screen, bodies=512),
        search=SearchConfig(trials=30, repeats=5),
        finetune=tune,
        score=replace(laptop.score, robots=100),
        distil=replace(
            paper.distil,
            depth=chosen.parkour,
            adapt=AdaptConfig(finetune=replace(tune, command_vx=None)),
            robots=256,
            imitation=distill.TrainConfig(iterations=256),
            vision=distill.VisionTrainConfig(iterations=1000, updates=16, batch=64),
            camera=laptop.distil.camera,
            judged=laptop.distil.judged,
        ),
        deploy=laptop.deploy,
    )


def _paper(task: TaskName) -> RunConfig:
    # what the print leaves open is that of the authors' released code
    ppo = PPOConfig(gamma_reg=0.98, steps=24, epochs=5, minibatches=4, entropy=0.01, learning_rate=2e-4)
    tune = FinetuneConfig(num_envs=2048, iterations=400, ppo=ppo)
    speed = (0.3, 0.8)
    return RunConfig(
        from_scratch=True,
        pretrain=TrainConfig(
            num_envs=6144,
            iterations=6000,
            save_every=100,
            ppo=ppo,
            task=pretraining_task(task, "paper"),
            network=NetworkConfig.paper(),
        ),
        screen=ScreenConfig(promote=0),
        search=SearchConfig(trials=30, initial=8, confirm=2, repeats=3),
        finetune=tune,
        score=ScoreConfig(vx=speed, seconds=20.0, robots=250, max_error=0.3),
        distil=DistilConfig(
            depth=True,
            adapt=AdaptConfig(
                finetune=tune,
                networks=distill.AdaptationConfig(estimator_frames=1),
                schedule=distill.RoaSchedule(identification=0.0, every=20),
            ),
            robots=128,
            vision=distill.VisionTrainConfig(iterations=5000, rollout_steps=120, memory=1, updates=1, batch=128),
            vision_student=distill.VisionStudentConfig(depth=distill.DepthEncoderConfig.large()),
            camera=locorl.DepthConfig(),
            judged=EvalConfig(vx=speed, robots_per_body=250, reset_joint=0.1, seed=4242),
        ),
        # section IV-C3: 250 ticks; the speed is ours
        deploy=DeployConfig(seconds=5.0),
    )


_PRESETS: Mapping[str, Callable[[TaskName], RunConfig]] = {
    "smoke": _smoke,
    "laptop": _laptop,
    "workstation": _workstation,
    "paper": _paper,
}
