"""Training runs: bodies by a sampler, metrics, checkpoints, resume."""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from locorl import checkpoint
from locorl.bodies.family import BodyFamily
from locorl.bodies.samplers import FixedSampler, MorphologySampler, make_sampler
from locorl.config import config_hash, to_dict
from locorl.env.legged_env import LeggedEnv
from locorl.env.symmetry import Symmetry
from locorl.interfaces import Array, BodyFactory
from locorl.learning.distributed import Processes
from locorl.learning.divergence import DivergedError
from locorl.learning.hooks import RolloutHook
from locorl.learning.networks import ActorCritic
from locorl.learning.policy import Policy, PolicyCard
from locorl.learning.ppo import PPO
from locorl.training.config import TrainConfig
from locorl.training.metrics import MetricsFile, TrainingProgress
from locorl.training.resume import check_origin, identity, read_checkpoint
from locorl.training.share import Share
from locorl.training.watcher import Watcher

__all__ = ["TrainConfig", "Trainer"]


class Trainer:
    """Trains one policy on N bodies and can be killed and resumed at any moment.

    Files in `folder`: `checkpoint.pt` (everything, for resuming), `checkpoint.previous.pt` (the one before, which
    takes over if the newest cannot be read), `policy.pt` (the networks alone), `metrics.jsonl`, `config.json`; and
    `fault.pt` if training produced NaN, for `faults.replay`. Without a folder nothing is written.

    Args:
        factory: makes the bodies.
        config: the run.
        folder: where to write; a checkpoint found there is resumed.
        designs: bodies for the whole run, (N, d); by default `config.morphology` deals them.
        start: policy to start from, as in fine-tuning; the optimiser starts fresh.
        threads: simulation threads; None takes those of `config.simulator`.
        hooks: learnt beside the policy.
        group: the processes that train together, each on its share of the robots; the first one writes the files.

    Raises:
        checkpoint.CheckpointError: the folder holds a checkpoint of another configuration, or none that can be read.
        ValueError: the number of designs is not N, a body has no stance, or bodies or robots cannot be dealt as asked;
            or `start` was trained on another robot, design space or family of bodies (see `Policy.check_bodies`).
    """

    def __init__(
        self,
        factory: BodyFactory,
        config: TrainConfig,
        folder: Path | None = None,
        designs: Array | None = None,
        start: Policy | None = None,
        threads: int | None = None,
        hooks: Sequence[RolloutHook] = (),
        group: Processes | None = None,
    ) -> None:
        self.config, self.folder, self.threads = config, folder, threads
        self.share = Share(config.num_envs, group)
        self.iteration, self._crowded = 0, False
        streams = [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(config.seed).spawn(4)]
        resumed = read_checkpoint(folder / "checkpoint.pt", config, quiet=not self.share.first) if folder else None
        if designs is not None and len(designs) != config.num_envs:
            raise ValueError(f"{len(designs)} designs for {config.num_envs} robots")
        self.sampler: MorphologySampler = (
            make_sampler(config.morphology, factory, config.num_envs, config.iterations, streams[0])
            if designs is None
            else FixedSampler(designs)
        )
        mine = self.sampler.designs[self.share.rows]
        self.env = LeggedEnv(
            factory,
            mine,
            config.task,
            seed=self.share.seed(streams[1]),
            threads=threads,
            simulator=config.simulator,
        )
        if start is not None:
            start.check_bodies(factory)
        torch.manual_seed(streams[2])
        network = start.card.network if start else config.network
        self.model = ActorCritic(self.env.group_dims, self.env.num_actions, network)
        if start is not None:
            self.model.load_state_dict(start.model.state_dict())
        self.model.to(self.env.device)  # made on the CPU: equal seeds, equal networks on every device
        self.ppo = PPO(
            self.model,
            config.ppo,
            self.env.num_envs,
            self.env.group_dims,
            seed=self.share.seed(streams[3]),
            hooks=hooks,
            mirror=Symmetry.of(self.env) if config.ppo.mirror else None,
            group=group,
        )
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
            family=BodyFamily.of(factory),
        )
        self._obs: dict[str, Tensor] | None = None
        if resumed is not None:
            check_origin(resumed, self._card, int(resumed["iteration"]) * config.samples_per_iteration, folder)
            self.restore(resumed)

    @property
    def samples(self) -> int:
        """Environment steps taken so far in this run."""
        return self.iteration * self.config.samples_per_iteration

    def policy(self) -> Policy:
        """The policy as it is now; it goes on changing if training goes on."""
        return Policy(self.model, replace(self._card, samples=self._card.samples + self.samples))

    def run(
        self, title: str = "train", quiet: bool = False, watchers: Sequence[Watcher] = ()
    ) -> list[dict[str, float]]:
        """Train until `config.iterations`, from wherever the run stands.

        Args:
            title: of the progress bar.
            quiet: no progress on screen.
            watchers: look on, such as `TensorBoard` and `Films`; of several processes, those of the first.

        Returns:
            The metrics of the iterations run now.

        Raises:
            DivergedError: training produced NaN; the last checkpoint stands, `fault.pt` repeats it.
            checkpoint.CheckpointError: something could not be written; what was there before stands.
        """
        config, first = self.config, self.share.first
        folder = self.folder if first else None
        watchers = watchers if first else ()
        rows: list[dict[str, float]] = []
        log = None
        if folder:
            checkpoint.sweep(folder)
            log = MetricsFile(folder / "metrics.jsonl", self.iteration)
            described = {"robot": self._card.robot, **to_dict(config)}
            checkpoint.write_text(folder / "config.json", json.dumps(described, indent=2) + "\n")
        with ExitStack() as stack:
            for watcher in watchers:
                watcher.begin(log.rows if log else [])
                stack.callback(watcher.end)
            progress = TrainingProgress(title, config.iterations, self.iteration, quiet or not first)
            stack.enter_context(progress)
            while self.iteration < config.iterations:
                row = self.step()
                rows.append(row)
                if log:
                    log.write(row)
                progress.update(self.iteration, _note(row))
                if self.folder and (self.iteration % config.save_every == 0 or self.iteration == config.iterations):
                    self.save()
                for watcher in watchers:
                    watcher.watch(self, row)
        return rows

    def step(self) -> dict[str, float]:
        """One iteration: a rollout and the update that follows.

        Returns:
            Its metrics.

        Raises:
            DivergedError: it produced NaN; `fault.pt` repeats it.
        """
        started = time.perf_counter()
        if self._obs is None:
            self._obs = self.env.reset()
        designs = self.sampler.next(self.iteration, self.share.all(self.env.score))
        if designs is not None:
            self._obs = self.env.set_designs(designs[self.share.rows])
        before = copy.deepcopy(self._content()) if self.folder else None
        try:
            self._obs, stats = self.ppo.collect(self.env, self._obs)
            collected = time.perf_counter()
            stats |= self.ppo.update()
        except DivergedError as error:
            dumped = self._dump(error, before)
            error.args = (f"iteration {self.iteration + 1}: {error}{dumped}",)
            raise
        seconds = time.perf_counter() - started
        self.iteration += 1
        if self.config.simulator.backend == "warp" and not self._crowded:  # reading warns with the way out: once
            self._crowded = any(self.env.sim.overflows.values())
        return {
            "iteration": self.iteration,
            "samples": self.samples,
            "seconds": seconds,
            "collect_seconds": collected - started,
            "samples_per_second": self.config.samples_per_iteration / seconds,
            **stats,
        }

    def save(self) -> None:
        """Write checkpoint and policy now; all processes together. A run without a folder has nowhere to write.

        Raises:
            checkpoint.CheckpointError: disk or memory is full; the checkpoints of before stand.
        """
        if self.folder is None:
            raise ValueError("this run has no folder to save to")
        everyone = self.share.collect(checkpoint.on_cpu(self._content()))
        if self.share.first:
            # the policy first: if the run is killed in between, it will write it again
            self.policy().save(self.folder / "policy.pt")
            others = {"others": everyone[1:]} if len(everyone) > 1 else {}
            checkpoint.save_next(self.folder / "checkpoint.pt", {**everyone[0], **others})

    def restore(self, content: Mapping[str, Any]) -> None:
        """Go to where the checkpoint `content` of this configuration was taken.

        Raises:
            checkpoint.CheckpointError: it was taken with other bodies, or by another number of processes.
        """
        everyone = (content, *content.get("others", ()))
        if len(everyone) != self.share.size:
            raise checkpoint.CheckpointError(
                f"{self.folder}: the checkpoint is one of {len(everyone)} processes, here are {self.share.size}"
            )
        mine = everyone[self.share.rank]
        self.sampler.load_state_dict(mine["sampler"])
        if not np.array_equal(mine["designs"].numpy(), self.sampler.designs[self.share.rows]):
            raise checkpoint.CheckpointError(f"{self.folder}: the checkpoint was trained on other bodies")
        self.model.load_state_dict(mine["model"])
        self.ppo.load_state_dict(mine["ppo"])
        self._obs = self.env.load_state_dict(mine["env"])
        torch.set_rng_state(mine["torch_generator"])
        self.iteration = int(mine["iteration"])

    def _content(self) -> dict[str, Any]:
        """Everything that the next iteration depends on, as far as this process is concerned."""
        config = to_dict(self.config)
        return {
            **self.policy().content(),
            "config": config,
            "config_hash": config_hash(identity(config)),
            "iteration": self.iteration,
            "ppo": self.ppo.state_dict(),
            "env": self.env.state_dict(),
            "sampler": self.sampler.state_dict(),
            "designs": torch.from_numpy(np.asarray(self.env.bodies.designs).copy()),
            "torch_generator": torch.get_rng_state(),  # hooks may draw from the default stream
        }

    def _dump(self, error: DivergedError, before: Mapping[str, Any] | None) -> str:
        """Write the state `before` the iteration that failed, as `fault.pt`. Returns what to tell the user."""
        if self.folder is None or before is None:
            return ""
        path = self.folder / ("fault.pt" if self.share.first else f"fault.{self.share.rank}.pt")
        fault = {"message": str(error), "what": error.what, "robots": list(error.robots), "step": error.step}
        try:
            checkpoint.save(path, {**before, "fault": {**fault, "iteration": self.iteration + 1}})
        except checkpoint.CheckpointError as failed:
            return f"\nNo dump was made: {failed}"
        return f"\n{path} repeats it: `locorl train {self.folder} --replay`, or locorl.training.faults.replay"


def _note(row: Mapping[str, float]) -> str:
    """What the progress bar shows of an iteration."""
    rate = row["samples_per_second"] / 1000
    return f"reward {row['reward']:.2f}/s  error {row['tracking_error']:.3f} m/s  {rate:.1f} k/s"
