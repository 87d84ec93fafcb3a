r"""Put a trained generalist into the package, with its provenance and its evaluation by the walking protocol.

The one that ships was made by these two commands, the second of which makes it thrifty:

    locorl train runs/generalist --iterations 160 --seed 1 --mirror
    locorl train runs/efficient --start runs/generalist/policy.pt --iterations 240 --seed 2 --mirror \
        --task.reward.specific-power -2 --ppo.learning-rate 5e-4
    python tools/ship_generalist.py go2-flat runs/generalist runs/efficient --commits <at which each was trained>
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from locorl import EvalConfig, evaluate, load_policy, sample_designs
from locorl.commands.evaluate import to_json
from locorl.providers import find_factory
from locorl.training.metrics import read_metrics

from legged_codesign.provenance import provenance
from legged_codesign.report.figures import pretraining

PRETRAINED = Path(__file__).parents[1] / "src" / "legged_codesign" / "pretrained"


@dataclass(frozen=True)
class Ship:
    """Options."""

    name: Annotated[str, tyro.conf.Positional]
    """Folder to write under pretrained/: <robot>-<task>."""
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of the training runs, in order; each started from the policy of the one before."""
    commits: tuple[str, ...]
    """Commit that each of them ran at."""
    bodies: int = 100
    """Feasible bodies of the evaluation."""
    seed: int = 7
    """Seed of the evaluation, not used in training."""


def main() -> None:
    """Copy, evaluate, record."""
    options = tyro.cli(Ship, description=__doc__)
    configs = [json.loads((run / "config.json").read_text(encoding="utf-8")) for run in options.runs]
    metrics = [read_metrics(run / "metrics.jsonl") for run in options.runs]
    factory, policy = find_factory(configs[-1]["robot"]), load_policy(options.runs[-1] / "policy.pt")
    designs = sample_designs(factory, options.bodies, np.random.default_rng(options.seed))
    result = to_json(evaluate(policy, factory, designs, policy.card.task, EvalConfig(seed=options.seed)))
    target = PRETRAINED / options.name
    target.mkdir(parents=True, exist_ok=True)
    policy.save(target / "policy.pt")
    (target / "evaluation.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    pretraining(join(metrics)).savefig(target / "curves.png", dpi=120)
    record = {
        "stages": [
            {
                "folder": str(run),
                "commit": commit,
                "minutes": round(sum(row["seconds"] for row in rows) / 60, 1),
                "samples": int(rows[-1]["samples"]),
                "config": config,
            }
            for run, commit, rows, config in zip(options.runs, options.commits, metrics, configs, strict=True)
        ],
        "commands": [line.strip() for line in (__doc__ or "").splitlines() if line.startswith("    ")],
        "samples": policy.card.samples,
        "evaluation": {
            "command": f"locorl evaluate policy.pt --bodies {options.bodies} --evaluation.seed {options.seed}",
            "summary": result["summary"],
        },
        "machine": provenance(),
    }
    (target / "provenance.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(record["evaluation"], indent=1))


def join(runs: list[list[dict[str, float]]]) -> list[dict[str, float]]:
    """Metrics of consecutive runs as one, with samples that go on."""
    rows: list[dict[str, float]] = []
    for run in runs:
        before = rows[-1]["samples"] if rows else 0.0
        rows += [{**row, "samples": row["samples"] + before} for row in run]
    return rows


if __name__ == "__main__":
    main()
