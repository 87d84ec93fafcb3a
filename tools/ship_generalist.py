r"""Put a trained generalist into the package, with its provenance and its evaluation.

    python tools/ship_generalist.py go2-flat --commits <at which each of its trainings ran>

`GENERALISTS` has the commands that train each, to be run first; `--folders` says where, if not where they say.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from locorl import EvalConfig, evaluate, find_factory, load_policy, read_metrics, sample_designs
from locorl.commands.evaluate import to_json

from legged_codesign.provenance import provenance
from legged_codesign.report.training import pretraining

PRETRAINED = Path(__file__).parents[1] / "src" / "legged_codesign" / "pretrained"
BODIES, SEED = 100, 7
"""Feasible bodies of the evaluation, and its seed, not used in training."""


@dataclass(frozen=True)
class Generalist:
    """How a policy is trained and judged."""

    trainings: tuple[str, ...]
    """Arguments of `locorl train`, the folder first; each starts from the policy of the one before."""
    protocol: EvalConfig = EvalConfig(seed=SEED)  # noqa: RUF009 - frozen

    @property
    def commands(self) -> list[str]:
        """What to type."""
        return [f"locorl train {arguments}" for arguments in self.trainings]

    def evaluation(self, robot: str) -> str:
        """The command that evaluates the policy."""
        ours, default = vars(self.protocol), vars(EvalConfig())
        options = [
            f"--evaluation.{name.replace('_', '-')} {' '.join(map(str, np.atleast_1d(value)))}"
            for name, value in ours.items()
            if value != default[name]
        ]
        return " ".join((f"locorl evaluate policy.pt --robot {robot} --bodies {BODIES}", *options))


GENERALISTS: Mapping[str, Generalist] = {
    "go2-flat": Generalist(
        (
            "runs/generalist --iterations 320 --seed 1 --mirror",
            # thrifty
            "runs/efficient --start runs/generalist/policy.pt --iterations 160 --seed 2 --mirror "
            "--task.reward.specific-power -2 --ppo.learning-rate 5e-4",
        )
    ),
    "go2-rough": Generalist(
        ("runs/rough --task locomotion-rough --iterations 320 --seed 1 --mirror",),
        EvalConfig(robots_per_body=10, seed=SEED),
    ),
    "lite3-parkour": Generalist(
        ("runs/parkour --robot lite3 --task parkour-mixed --iterations 800 --seed 1 --mirror",),
        EvalConfig(vx=(0.9, 1.0), robots_per_body=10, seed=SEED),
    ),
}
"""The policies that ship, <robot>-<task>."""


@dataclass(frozen=True)
class Ship:
    """Options."""

    name: Annotated[str, tyro.conf.Positional]
    """One of `GENERALISTS`; the folder to write under pretrained/."""
    commits: tuple[str, ...]
    """Commit that each of its trainings ran at."""
    folders: tuple[Path, ...] = ()
    """Where the trainings are, if not in the folders that their commands name."""


def main() -> None:
    """Copy, evaluate, record."""
    options = tyro.cli(Ship, description=__doc__)
    generalist = GENERALISTS[options.name]
    named = [shlex.split(arguments)[0] for arguments in generalist.trainings]
    folders = options.folders or tuple(map(Path, named))
    configs = [json.loads((folder / "config.json").read_text(encoding="utf-8")) for folder in folders]
    metrics = [read_metrics(folder / "metrics.jsonl") for folder in folders]
    factory, policy = find_factory(configs[-1]["robot"]), load_policy(folders[-1] / "policy.pt")
    designs = sample_designs(factory, BODIES, np.random.default_rng(SEED))
    result = to_json(evaluate(policy, factory, designs, policy.card.task, generalist.protocol))
    target = PRETRAINED / options.name
    target.mkdir(parents=True, exist_ok=True)
    policy.save(target / "policy.pt")
    (target / "evaluation.json").write_text(json.dumps(result) + "\n", encoding="utf-8")
    pretraining(join(metrics)).savefig(target / "curves.png", dpi=120)
    record = {
        "stages": [
            {
                "folder": folder,
                "commit": commit,
                "minutes": round(sum(row["seconds"] for row in rows) / 60, 1),
                "samples": int(rows[-1]["samples"]),
                "config": config,
            }
            for folder, commit, rows, config in zip(named, options.commits, metrics, configs, strict=True)
        ],
        "commands": generalist.commands,
        "samples": policy.card.samples,
        "evaluation": {"command": generalist.evaluation(factory.name), "summary": result["summary"]},
        "machine": provenance(),
    }
    (target / "provenance.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(record["evaluation"], indent=1))


def join(runs: Sequence[Sequence[Mapping[str, float]]]) -> list[Mapping[str, float]]:
    """Metrics of consecutive runs as one, with samples that go on."""
    rows: list[Mapping[str, float]] = []
    for run in runs:
        before = rows[-1]["samples"] if rows else 0.0
        rows += [{**row, "samples": row["samples"] + before} for row in run]
    return rows


if __name__ == "__main__":
    main()
