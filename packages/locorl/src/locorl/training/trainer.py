"""Training runs: bodies by a sampler, metrics, checkpoints, resume."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from locorl import checkpoint
from locorl.bodies.samplers import FixedSampler, MorphologyConfig, MorphologySampler, make_sampler
from locorl.config import differences, to_dict
from locorl.env.legged_env import LeggedEnv
from locorl.interfaces import Array, BodyFactory
from locorl.learning.networks import ActorCritic, NetworkConfig
from locorl.learning.policy import Policy, PolicyCard
from locorl.learning.ppo import PPO, PPOConfig
from locorl.tasks.task import TaskConfig
from locorl.training.metrics import MetricsFile, TrainingProgress


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    num_envs: int = 1024
    """Robots trained at once."""
    iterations: int = 500
    """Rollouts and updates."""
    seed: int = 0
    save_every: int = 20
    """Iterations between checkpoints."""
    morphology: MorphologyConfig = field(default_factory=MorphologyConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)

    @property
    def samples_per_iteration(self) -> int:
        """Environment steps in one iteration."""
        return self.num_envs * self.ppo.steps


class Trainer:
    """Trains one policy on N bodies and can be killed and resumed at any moment.

    Files in `folder`: `checkpoint.pt` (everything, for resuming), `policy.pt` (the networks alone),
    `metrics.jsonl`, `config.json`. Without a folder nothing is written.

    Args:
        factory: makes the bodies.
        config: the run.
        folder: where to write; a checkpoint found there is resumed.
        designs: bodies for the whole run, (N, d); by default `config.morphology` deals them.
        start: policy to start from, as in fine-tuning; the optimiser starts fresh.
        threads: simulation threads.

    Raises:
        checkpoint.CheckpointError: the folder holds a checkpoint of another configuration, or a broken one.
        ValueError: the number of designs is not N, a body has no stance, or the bodies cannot be dealt as asked.
    """

    def __init__(
        self,
        factory: BodyFactory,
        config: TrainConfig,
        folder: Path | None = None,
        designs: Array | None = None,
        start: Policy | None = None,
        threads: int | None = None,
    ) -> None:
        self.config, self.folder = config, folder
        self.iteration = 0
        streams = [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(config.seed).spawn(4)]
        resumed = self._read_checkpoint()
        if designs is not None and len(designs) != config.num_envs:
            raise ValueError(f"{len(designs)} designs for {config.num_envs} robots")
        self.sampler: MorphologySampler = (
            make_sampler(config.morphology, factory, config.num_envs, config.iterations, streams[0])
            if designs is None
            else FixedSampler(designs)
        )
        self.env = LeggedEnv(factory, self.sampler.designs, config.task, seed=streams[1], threads=threads)
        if start is not None:
            start.check_space(factory.name, factory.space)
        torch.manual_seed(streams[2])
        network = start.card.network if start else config.network
        self.model = ActorCritic(self.env.group_dims, self.env.num_actions, network)
        if start is not None:
            self.model.load_state_dict(start.model.state_dict())
        self.ppo = PPO(self.model, config.ppo, config.num_envs, self.env.group_dims, seed=streams[3])
        space = factory.space
        self._card = PolicyCard(
            robot=factory.name,
            design_names=tuple(space.names),
            design_low=tuple(float(x) for x in space.low),
            design_high=tuple(float(x) for x in space.high),
            dims=dict(self.env.group_dims),
            task=config.task,
            network=network,
            samples=start.card.samples if start else 0,
            seed=config.seed,
        )
        self._obs: dict[str, Tensor] | None = None
        if resumed is not None:
            self._restore(resumed)

    @property
    def samples(self) -> int:
        """Environment steps taken so far in this run."""
        return self.iteration * self.config.samples_per_iteration

    def policy(self) -> Policy:
        """The policy as it is now; it goes on changing if training goes on."""
        return Policy(self.model, replace(self._card, samples=self._card.samples + self.samples))

    def run(self, title: str = "train", quiet: bool = False) -> list[dict[str, float]]:
        """Train until `config.iterations`, from wherever the run stands.

        Returns:
            The metrics of the iterations run now.

        Raises:
            ppo.DivergedError: training produced NaN; the last checkpoint stands.
        """
        config = self.config
        rows: list[dict[str, float]] = []
        log = None
        if self.folder:
            log = MetricsFile(self.folder / "metrics.jsonl", self.iteration)
            described = {"robot": self._card.robot, **to_dict(config)}
            checkpoint.write_text(self.folder / "config.json", json.dumps(described, indent=2) + "\n")
        if self._obs is None:
            self._obs = self.env.reset()
        with TrainingProgress(title, config.iterations, self.iteration, quiet) as progress:
            while self.iteration < config.iterations:
                started = time.perf_counter()
                designs = self.sampler.next(self.iteration, self.env.score)
                if designs is not None:
                    self._obs = self.env.set_designs(designs)
                self._obs, stats = self.ppo.collect(self.env, self._obs)
                collected = time.perf_counter()
                stats |= self.ppo.update()
                finished = time.perf_counter()
                self.iteration += 1
                rate = config.samples_per_iteration / (finished - started)
                row = {
                    "iteration": self.iteration,
                    "samples": self.samples,
                    "seconds": finished - started,
                    "collect_seconds": collected - started,
                    "samples_per_second": rate,
                    **stats,
                }
                rows.append(row)
                if log:
                    log.write(row)
                progress.update(
                    self.iteration,
                    f"reward {stats['reward']:.2f}/s  error {stats['tracking_error']:.3f} m/s  {rate / 1000:.1f} k/s",
                )
                if self.folder and (self.iteration % config.save_every == 0 or self.iteration == config.iterations):
                    self.save()
        return rows

    def save(self) -> None:
        """Write checkpoint and policy now; a run without a folder has nowhere to write."""
        if self.folder is None:
            raise ValueError("this run has no folder to save to")
        content = {
            **self.policy().content(),
            "config": to_dict(self.config),
            "iteration": self.iteration,
            "ppo": self.ppo.state_dict(),
            "env": self.env.state_dict(),
            "sampler": self.sampler.state_dict(),
            "designs": torch.from_numpy(np.asarray(self.env.bodies.designs).copy()),
        }
        checkpoint.save(self.folder / "checkpoint.pt", content)
        self.policy().save(self.folder / "policy.pt")

    def _read_checkpoint(self) -> Mapping[str, Any] | None:
        if self.folder is None or not (self.folder / "checkpoint.pt").exists():
            return None
        path = self.folder / "checkpoint.pt"
        content = checkpoint.load(path)
        if "config" not in content:
            raise checkpoint.CheckpointError(f"{path} holds a policy but no training to resume; use another folder")
        mine = to_dict(self.config)
        # a longer run of the same configuration is the same run, unless the bodies share the iterations out
        free = {} if self.config.morphology.kind == "temporal" else {"iterations": 0}
        changes = differences({**content["config"], **free}, {**mine, **free})
        if changes:
            raise checkpoint.CheckpointError(
                f"{path} belongs to another configuration; use another folder. Differences:\n  " + "\n  ".join(changes)
            )
        return content

    def _restore(self, content: Mapping[str, Any]) -> None:
        samples = self._card.samples + int(content["iteration"]) * self.config.samples_per_iteration
        changes = differences(content["card"], to_dict(replace(self._card, samples=samples)))
        if changes:
            raise checkpoint.CheckpointError(
                f"{self.folder}: the checkpoint belongs to another robot or another starting policy; use another "
                "folder. Differences:\n  " + "\n  ".join(changes)
            )
        self.sampler.load_state_dict(content["sampler"])
        if not np.array_equal(content["designs"].numpy(), self.sampler.designs):
            raise checkpoint.CheckpointError(f"{self.folder}: the checkpoint was trained on other bodies")
        self.model.load_state_dict(content["model"])
        self.ppo.load_state_dict(content["ppo"])
        self._obs = self.env.load_state_dict(content["env"])
        self.iteration = int(content["iteration"])
