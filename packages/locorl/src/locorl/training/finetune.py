"""Fine-tuning: from a generalist to one body (Algorithm 2's inner loop)."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from locorl import checkpoint
from locorl.bodies.designs import repeat_design
from locorl.config import differences, to_dict
from locorl.evaluation.choice import Candidate, best, stalled
from locorl.evaluation.evaluate import EvalConfig, evaluate
from locorl.interfaces import Array, BodyFactory
from locorl.learning.hooks import RolloutHook
from locorl.learning.networks import ActorCritic
from locorl.learning.policy import Policy, policy_from
from locorl.learning.ppo import PPOConfig
from locorl.simulation.make import SimulatorConfig
from locorl.tasks.task import TaskConfig
from locorl.training.metrics import read_metrics
from locorl.training.resume import identity
from locorl.training.trainer import TrainConfig, Trainer


@dataclass(frozen=True)
class FinetuneConfig:
    """A short training of N identical robots from the generalist.

    By default the whole budget is spent and the last policy is the result. With `keep_best`, `patience` or
    `evaluate_every` the policy is evaluated at iteration 0 (the generalist), in between and at the end, always on the
    robots of `choice`; that changes nothing about the training. The best of several noisy evaluations is too good on
    average: report with another seed than `choice` has.
    """

    num_envs: int = 512
    iterations: int = 12
    """Budget: rollouts and updates."""
    ppo: PPOConfig = field(default_factory=lambda: PPOConfig(steps=25, learning_rate=2e-4, max_learning_rate=1e-3))
    specific_power: float | None = None
    """Weight of positive mechanical power over body weight in the reward; None keeps the generalist's."""
    command_vx: tuple[float, float] | None = None
    """Commanded forward speeds to train on, m/s; None keeps the generalist's commands."""
    history: int | None = None
    """Past frames of proprioception that the robots observe, for hooks that read them; None keeps the generalist's."""
    optimizer: Literal["fresh", "keep"] = "fresh"
    """keep goes on with Adam's moments and the learning rate (within the bounds of `ppo`) of the generalist's training;
    that needs its checkpoint.pt."""
    evaluate_every: int | None = None
    """Iterations between evaluations; None evaluates at the start and at the end at most."""
    keep_best: bool = False
    """Return the best policy by undiscounted return (eq. 9), the generalist included, instead of the last one."""
    patience: int | None = None
    """Stop after so many evaluations in a row without improvement (see `evaluation.choice.stalled`); None never."""
    choice: EvalConfig = field(
        default_factory=lambda: EvalConfig(seconds=10.0, robots_per_body=64, reset_joint=0.1, seed=9001)
    )
    """The evaluations that choose and stop."""
    simulator: SimulatorConfig = field(default_factory=SimulatorConfig)

    def __post_init__(self) -> None:
        """Refuse a patience that nothing feeds."""
        for name in ("evaluate_every", "patience"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"FinetuneConfig.{name} is {value}; it must be at least 1, or None")
        if self.patience is not None and self.evaluate_every is None:
            raise ValueError("FinetuneConfig: patience counts evaluations; set evaluate_every too")

    @property
    def samples(self) -> int:
        """Environment steps in one fine-tune."""
        return self.num_envs * self.ppo.steps * self.iterations

    @property
    def chooses(self) -> bool:
        """Whether policies are evaluated while fine-tuning."""
        return self.keep_best or self.evaluate_every is not None

    def judges(self, iteration: int) -> bool:
        """Whether the policy is evaluated after `iteration` iterations."""
        due = iteration in (0, self.iterations)
        if self.evaluate_every is not None:
            due |= iteration % self.evaluate_every == 0
        return self.chooses and due

    def next_stop(self, iteration: int) -> int:
        """Iteration after `iteration` at which the training pauses for an evaluation, or ends."""
        if self.evaluate_every is None:
            return self.iterations
        return min(self.iterations, (iteration // self.evaluate_every + 1) * self.evaluate_every)


@dataclass(frozen=True)
class Finetuned:
    """A fine-tuned policy and how it got there.

    Attributes:
        policy: the result.
        curve: metrics of each iteration.
        candidates: the policies that were evaluated, in order; empty if none was.
        iteration: at which the result was as it is; 0 if the generalist was better than all that came of it.
        stopped: whether a plateau ended the fine-tune before its budget did.
    """

    policy: Policy
    curve: Sequence[dict[str, float]]
    candidates: Sequence[Candidate] = ()
    iteration: int = 0
    stopped: bool = False


def finetune(
    generalist: Policy | Path,
    factory: BodyFactory,
    design: Array,
    config: FinetuneConfig,
    seed: int,
    folder: Path | None = None,
    quiet: bool = True,
    threads: int | None = None,
    hooks: Sequence[RolloutHook] = (),
    attach: Callable[[ActorCritic], object] | None = None,
    adopt: bool = False,
) -> Finetuned:
    """Fine-tune `generalist` on one body; the generalist itself is not changed.

    Every body starts from the same generalist, never from another body's policy: what comes out depends on the
    arguments alone.

    Args:
        generalist: starting point of actor and critic; a path is read anew.
        factory: makes the body.
        design: (d,).
        config: budget and learning rate.
        seed: of the run.
        folder: where to keep checkpoint, metrics and candidates; a run killed there is resumed.
        quiet: no progress on screen.
        threads: simulation threads; None takes those of `config.simulator`.
        hooks: learnt beside the policy, such as an estimator of the velocity; they go on where `folder` stopped.
        attach: given the networks in training before it begins, for hooks that need one of them.
        adopt: take the generalist on even if it was trained on bodies with other rules or gains.

    Raises:
        ValueError: the design is out of bounds, the body has no stance, or the generalist was trained on other bodies
            (see `Policy.check_bodies`).
        checkpoint.CheckpointError: `config.optimizer` is "keep", and the generalist comes without its optimiser's
            state; or `folder` holds another fine-tune.
        ppo.DivergedError: training produced NaN.
    """
    start, learner = _read(generalist, config)
    start = start.adopted(factory) if adopt else start
    candidates = _read_candidates(folder)
    train = TrainConfig(
        num_envs=config.num_envs,
        iterations=config.iterations,
        seed=seed,
        task=_task(start.card.task, config),
        ppo=config.ppo,
        simulator=config.simulator,
    )
    bodies = repeat_design(factory, design, config.num_envs)
    trainer = Trainer(factory, train, folder, designs=bodies, start=start, threads=threads, hooks=hooks)
    if attach is not None:
        attach(trainer.model)
    if folder is not None:
        _check_folder(folder, config, resumed=trainer.iteration > 0)
    if learner is not None and trainer.iteration == 0:
        _keep_optimizer(trainer, learner)

    # what came after the last checkpoint will come again, and the end of a smaller budget is none of this one's
    done = trainer.iteration
    candidates = [each for each in candidates if 0 < done >= each.iteration and config.judges(each.iteration)]
    curve: list[dict[str, float]] = []
    # the progress bar counts to the next evaluation
    title = f"fine-tune ({config.iterations} iterations)" if config.evaluate_every else "fine-tune"
    stopped = False
    while True:
        now = trainer.iteration
        if config.judges(now) and all(candidate.iteration != now for candidate in candidates):
            candidates.append(_judge(trainer, factory, bodies[:1], config, threads))
            _write_candidate(folder, candidates[-1])
        stopped = config.patience is not None and stalled(candidates, config.patience) and now < config.iterations
        if stopped or now >= config.iterations:
            break
        # one Trainer all the time: stopping and going on changes nothing but when it writes its checkpoint
        trainer.config = replace(train, iterations=config.next_stop(now))
        curve += trainer.run(title, quiet=quiet)
    if folder is not None:  # a resumed run has earlier iterations too
        curve = read_metrics(folder / "metrics.jsonl")
    if not config.keep_best:
        return Finetuned(trainer.policy(), curve, candidates, trainer.iteration, stopped)
    chosen = best(candidates)
    return Finetuned(chosen.policy, curve, candidates, chosen.iteration, stopped)


def _task(task: TaskConfig, config: FinetuneConfig) -> TaskConfig:
    """The generalist's task with what the fine-tune changes in it."""
    if config.specific_power is not None:
        task = replace(task, reward=replace(task.reward, specific_power=config.specific_power))
    if config.command_vx is not None:
        narrow = replace(task.command, vx=config.command_vx, vy=(0.0, 0.0), yaw_rate=(0.0, 0.0), standing=0.0)
        task = replace(task, command=narrow)
    if config.history is not None:
        task = replace(task, observation=replace(task.observation, history=config.history))
    return task


def _read(generalist: Policy | Path, config: FinetuneConfig) -> tuple[Policy, Mapping[str, Any] | None]:
    """The policy to start from, and the state of its learner if that is to be kept."""
    if isinstance(generalist, Policy):
        start, learner, where = generalist, None, "a policy in memory"
    else:
        content = checkpoint.load(generalist)
        start, learner, where = policy_from(content, generalist), content.get("ppo"), str(generalist)
    if config.optimizer == "fresh":
        return start, None
    if learner is None:
        raise checkpoint.CheckpointError(
            f"{where} has no optimiser's state to keep: give the path of the checkpoint.pt that its training wrote, "
            'or take optimizer "fresh"'
        )
    return start, learner


def _keep_optimizer(trainer: Trainer, learner: Mapping[str, Any]) -> None:
    """Adam's moments and learning rate from an earlier training; exploration stays that of this run's seed."""
    ppo = trainer.config.ppo
    rate = min(max(float(learner["learning_rate"]), ppo.min_learning_rate), ppo.max_learning_rate)
    kept = {"optimizer": learner["optimizer"], "learning_rate": rate}
    try:
        trainer.ppo.load_state_dict({**trainer.ppo.state_dict(), **kept})
    except ValueError as error:
        raise checkpoint.CheckpointError(
            f"the optimiser of the generalist's training does not fit ({error}): it trained more than the policy; "
            'take optimizer "fresh"'
        ) from error


def _judge(
    trainer: Trainer, factory: BodyFactory, design: Array, config: FinetuneConfig, threads: int | None
) -> Candidate:
    """The trainer's policy as it is now, evaluated on the fine-tune's own task."""
    now = trainer.policy()
    policy = Policy(copy.deepcopy(now.model), now.card)
    result = evaluate(policy, factory, design, now.card.task, config.choice, threads, config.simulator)
    return Candidate(trainer.iteration, policy, result.returns[0], result.energy[0], float(result.survived.mean()))


def _check_folder(folder: Path, config: FinetuneConfig, resumed: bool) -> None:
    """Write down the fine-tune, or refuse to go on with another one than the folder's; the budget may differ."""
    path = folder / "finetune.json"
    mine = identity(to_dict(replace(config, iterations=0)))
    if resumed and path.is_file():
        changes = differences(identity(json.loads(path.read_text(encoding="utf-8"))), mine)
        if changes:
            raise checkpoint.CheckpointError(
                f"{folder} holds another fine-tune; use another folder. Differences:\n  " + "\n  ".join(changes)
            )
    else:
        checkpoint.write_text(path, json.dumps(mine, indent=2) + "\n")


def _write_candidate(folder: Path | None, candidate: Candidate) -> None:
    if folder is None:
        return
    judged = {
        "iteration": candidate.iteration,
        "returns": torch.from_numpy(candidate.returns.copy()),
        "energy": torch.from_numpy(candidate.energy.copy()),
        "survived": candidate.survived,
    }
    path = folder / "candidates" / f"{candidate.iteration:05d}.pt"
    checkpoint.save(path, {**candidate.policy.content(), "judged": judged})


def _read_candidates(folder: Path | None) -> list[Candidate]:
    """The candidates that an earlier session left."""
    if folder is None:
        return []
    candidates = []
    for path in sorted((folder / "candidates").glob("*.pt")):
        content = checkpoint.load(path)
        judged, policy = content["judged"], policy_from(content, path)
        returns, energy = (np.asarray(judged[name].numpy()) for name in ("returns", "energy"))
        candidates.append(Candidate(judged["iteration"], policy, returns, energy, judged["survived"]))
    return candidates
