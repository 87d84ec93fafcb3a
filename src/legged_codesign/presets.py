"""Presets: how much of everything, and where it is meant to run."""

from __future__ import annotations

from dataclasses import replace

import distill
import locorl

from legged_codesign.config import DeployConfig, Objective, RunConfig, ScoreConfig, ScreenConfig, SearchConfig

POWER_WEIGHT = -2.0
"""Reward weight of positive mechanical power over body weight while fine-tuning for energy."""


def preset(name: str, objective: Objective = "cost-of-transport") -> RunConfig:
    """The configuration of a preset.

    `smoke` proves the plumbing from scratch within 3 minutes on 2 cores and claims no quality. `laptop`
    starts from the shipped generalist and takes at most 15 minutes on 2 cores.

    Args:
        name: `smoke` or `laptop`.
        objective: what bodies are scored by; for energy and cost of transport the fine-tuning reward weighs
            mechanical power as well, so that it optimises what the search scores.

    Raises:
        ValueError: there is no such preset.
    """
    presets = {"smoke": _smoke, "laptop": _laptop}
    if name not in presets:
        raise ValueError(f"no preset '{name}'; choose one of {', '.join(presets)}")
    config = replace(presets[name](), preset=name, objective=objective)
    weight = None if objective == "return" else POWER_WEIGHT
    return replace(config, finetune=replace(config.finetune, specific_power=weight))


def _laptop() -> RunConfig:
    return RunConfig(
        # for --from-scratch; see results/go2-flat-from-scratch
        pretrain=locorl.TrainConfig(iterations=160, ppo=locorl.PPOConfig(mirror=True)),
        finetune=locorl.FinetuneConfig(command_vx=(0.4, 0.8)),
    )


def _smoke() -> RunConfig:
    ppo = locorl.PPOConfig(steps=12, epochs=2, minibatches=2)
    return RunConfig(
        from_scratch=True,
        pretrain=locorl.TrainConfig(num_envs=64, iterations=6, save_every=3, ppo=ppo),
        screen=ScreenConfig(bodies=8, robots=1, seconds=1.0, promote=1),
        search=SearchConfig(trials=4, initial=3, confirm=1, repeats=2),
        finetune=locorl.FinetuneConfig(num_envs=32, iterations=2, ppo=ppo, command_vx=(0.4, 0.8)),
        score=ScoreConfig(seconds=3.0, robots=4),
        imitation=distill.TrainConfig(iterations=4, rollout_steps=12, segment=2, updates=4, batch=256, ring_rollouts=4),
        distill_envs=16,
        deploy=DeployConfig(seconds=3.0),
    )
