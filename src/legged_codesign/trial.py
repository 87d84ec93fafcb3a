"""One trial: fine-tune the generalist to a body, score it, keep the better policy."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from codesign_bo import EvalRequest, EvalResult
from locorl import CheckpointError, Evaluation, Policy, evaluate, finetune
from locorl.interfaces import Array
from morphgen import BodyFactory

from legged_codesign.config import RunConfig
from legged_codesign.objective import evaluation_config, robot_scores
from legged_codesign.robots import body_factory
from legged_codesign.stages import write_text


@dataclass(frozen=True)
class FineTuneAndScore:
    """The callback of the search (Algorithm 2, lines 2 to 8).

    Fine-tunes for the stated budget. The better of the result and the generalist is the body's policy, so that a
    fine-tune never makes a body worse; it is chosen on starts of its own, as the better of two noisy scores is too
    good on average. Writes `policy.pt` and `result.json` into the request's folder; a request that was already
    answered there is not done again.

    It can be pickled, and carries all that it needs to another process or machine but the robot's own URDF, and the
    folder of the request, which is to be seen from everywhere.

    Attributes:
        config: the run.
        generalist: the policy to start from, on the run's task.
        threads: of simulation and learning; None takes every core.
    """

    config: RunConfig
    generalist: Policy
    threads: int | None = None

    @cached_property
    def factory(self) -> BodyFactory:
        """Makes the bodies; in each process anew."""
        return body_factory(self.config.robot, self.config.bodies)

    def __getstate__(self) -> dict[str, object]:
        """Everything but the factory."""
        return {name: value for name, value in vars(self).items() if name != "factory"}

    def __call__(self, request: EvalRequest) -> EvalResult:
        """Score one body."""
        stored = _stored(request)
        if stored is not None:
            return stored
        if self.threads is not None:
            torch.set_num_threads(self.threads)
        config, threads = self.config, self.threads
        simulator = config.finetune.simulator
        design = np.array([request.params[name] for name in self.factory.space.names])
        tuned = finetune(self.generalist, self.factory, design, config.finetune, request.seed, threads=threads)
        candidates = {"generalist": self.generalist, "fine-tuned": tuned.policy}
        task = tuned.policy.card.task

        def score(name: str, seed: int) -> tuple[Evaluation, Array]:
            protocol = evaluation_config(config.score, seed)
            result = evaluate(
                candidates[name], self.factory, design[None], task, protocol, threads, simulator=simulator
            )
            return result, robot_scores(result, config.objective, config.score)[0]

        other_starts = int(np.random.SeedSequence((request.seed, 1)).generate_state(1)[0])
        chosen = max(candidates, key=lambda name: float(score(name, other_starts)[1].mean()))
        judged = {name: score(name, request.seed) for name in candidates}
        evaluation, scores = judged[chosen]
        result = EvalResult(
            mean=float(scores.mean()),
            sem=float(scores.std(ddof=1) / np.sqrt(len(scores))),
            n=len(scores),
            extras={
                **facts(evaluation),
                "score_generalist": float(judged["generalist"][1].mean()),
                "score_fine_tuned": float(judged["fine-tuned"][1].mean()),
                "fine_tuned": float(chosen == "fine-tuned"),
            },
            curve=tuple((row["samples"], row["reward"]) for row in tuned.curve),
        )
        try:
            candidates[chosen].save(request.workdir / "policy.pt")
        except CheckpointError as error:  # a full disk must not pass for a body that cannot walk
            raise OSError(str(error)) from error
        record = {"params": dict(request.params), "seed": request.seed, "result": json.loads(result.to_json())}
        write_text(request.workdir / "result.json", json.dumps(record, indent=1) + "\n")
        return result


def facts(result: Evaluation) -> dict[str, float]:
    """What stands beside a score: return, tracking, survival, way and energy, as finite numbers."""
    summary = result.summary()
    names = ("return", "tracking_error", "survived", "succeeded", "distance", "energy", "cost_of_transport")
    return {name: summary[name] for name in names if np.isfinite(summary.get(name, np.nan))} | {
        "mean_power": float(result.mean_power.mean())
    }


def _stored(request: EvalRequest) -> EvalResult | None:
    """The result on disk, if it answers this very request and its policy is there."""
    path = request.workdir / "result.json"
    if not path.is_file() or not (request.workdir / "policy.pt").is_file():
        return None
    record = json.loads(path.read_text(encoding="utf-8"))
    if record["params"] != dict(request.params) or record["seed"] != request.seed:
        return None
    return EvalResult.from_json(json.dumps(record["result"]))


def trial_folder(folder: Path, trial: int, repeat: int | None = None) -> Path:
    """Folder of a trial's files, or of one of its confirmation runs."""
    base = folder / "trials" / f"{trial:04d}"
    return base if repeat is None else base / "confirm" / f"{repeat:02d}"
