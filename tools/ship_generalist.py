"""Put a trained generalist into the package, with its provenance and its evaluation by the walking protocol.

    locorl train runs/generalist --iterations 400 --seed 1
    python tools/ship_generalist.py runs/generalist go2-flat --commit <commit it was trained at>
"""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from legged_codesign.provenance import provenance
from legged_codesign.report.figures import pretraining
from locorl import EvalConfig, evaluate, load_policy, sample_designs
from locorl.cli import to_json
from locorl.metrics import read_metrics
from locorl.providers import find_factory

PRETRAINED = Path(__file__).parents[1] / "src" / "legged_codesign" / "pretrained"


@dataclass(frozen=True)
class Ship:
    """Options."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of the training run."""
    name: Annotated[str, tyro.conf.Positional]
    """Folder to write under pretrained/: <robot>-<task>."""
    commit: str
    """Commit that the training ran at."""
    bodies: int = 100
    """Feasible bodies of the evaluation."""
    seed: int = 7
    """Seed of the evaluation, not used in training."""


def main() -> None:
    """Copy, evaluate, record."""
    options = tyro.cli(Ship, description=__doc__)
    config = json.loads((options.run / "config.json").read_text(encoding="utf-8"))
    factory, policy = find_factory(config["robot"]), load_policy(options.run / "policy.pt")
    designs = sample_designs(factory, options.bodies, np.random.default_rng(options.seed))
    result = to_json(evaluate(policy, factory, designs, policy.card.task, EvalConfig(seed=options.seed)))
    metrics = read_metrics(options.run / "metrics.jsonl")
    train = ["locorl", "train", "runs/generalist", "--robot", config["robot"]]
    train += ["--iterations", str(config["iterations"]), "--seed", str(config["seed"])]
    target = PRETRAINED / options.name
    target.mkdir(parents=True, exist_ok=True)
    policy.save(target / "policy.pt")
    (target / "evaluation.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    pretraining(metrics).savefig(target / "curves.png", dpi=120)
    record = {
        "command": shlex.join(train),
        "trained_at": options.commit,
        "samples": policy.card.samples,
        "minutes": round(sum(row["seconds"] for row in metrics) / 60, 1),
        "config": config,
        "evaluation": {
            "command": f"locorl evaluate {options.name}/policy.pt --bodies {options.bodies} "
            f"--evaluation.seed {options.seed}",
            "summary": result["summary"],
        },
        "machine": provenance(),
    }
    (target / "provenance.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(record["evaluation"], indent=1))


if __name__ == "__main__":
    main()
