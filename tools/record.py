"""Record a finished run under results/: its small files, its bodies side by side, and how to make it again.

python tools/record.py runs/laptop-go2-flat-cost-of-transport go2-flat-cost-of-transport "make demo"
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml
from codesign_bo.records import ConfirmationRecord
from locorl import read_metrics
from scipy import stats

from legged_codesign.choice import Choice
from legged_codesign.provenance import described
from legged_codesign.report.data import read_run
from legged_codesign.run_folder import read_config

RESULTS = Path(__file__).parents[1] / "results"
KEPT = ("config.yaml", "trials.json", "choice.json", "rollout.json", "metrics.jsonl", "student/comparison.json")
MEASURES = {
    "return": "return",
    "tracking_error": "tracking error, m/s",
    "distance": "distance, m",
    "energy": "positive work, J",
    "cost_of_transport": "cost of transport",
}
"""What stands beside a score, by its name in a trial."""


def main() -> None:
    """Copy and describe."""
    folder, name, command = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    target = RESULTS / name
    target.mkdir(parents=True, exist_ok=True)
    for file in KEPT:
        shutil.copyfile(folder / file, target / Path(file).name)
    config = read_config(folder)
    machine = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))["provenance"]
    choice = Choice.from_json((folder / "choice.json").read_text(encoding="utf-8"))
    minutes = sum(row["seconds"] for row in read_metrics(folder / "metrics.jsonl")) / 60
    lines = (
        f"# {name}",
        "",
        f"{choice.sentence(config.objective)}. All stages together took {minutes:.0f} minutes.",
        "",
        *side_by_side(read_run(folder).confirmations, choice.challenger),
        "",
        *described(command, config.seed, machine),
        "",
        "`trials.json` is the trial table, `choice.json` the comparison on fresh seeds, `rollout.json` the run of the",
        "student, `comparison.json` student and teacher on the same starts, `metrics.jsonl` the seconds of each stage.",
    )
    (target / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def side_by_side(runs: Sequence[ConfirmationRecord], body: int) -> list[str]:
    """Table of the nominal body and `body` on the fresh seeds, as Markdown."""
    found = {(run.trial, run.repeat): run.result.extras for run in runs if run.result is not None and run.result.ok}
    seeds = sorted(seed for trial, seed in found if trial == body and (0, seed) in found)
    robots = sum(run.result.n for run in runs if run.trial == body and run.repeat in seeds and run.result is not None)
    lines = [
        f"Nominal and body {body}, fine-tuned alike on {len(seeds)} fresh seeds, {robots} robots each. Differences "
        "are paired by seed, with the 95 % interval of Student's t.",
        "",
        f"| | nominal | body {body} | difference |",
        "|---|---|---|---|",
    ]
    for measure, title in MEASURES.items():
        pair = np.array([[found[trial, seed].get(measure, np.nan) for seed in seeds] for trial in (0, body)])
        apart = pair[1] - pair[0]
        half = stats.t.ppf(0.975, len(seeds) - 1) * stats.sem(apart) if len(seeds) > 1 else np.nan
        low, high = apart.mean() - half, apart.mean() + half
        means = " | ".join(f"{each.mean():.4g}" for each in pair)
        lines.append(f"| {title} | {means} | {apart.mean():+.3g} ({low:+.3g} to {high:+.3g}) |")
    survived = [sum(found[trial, seed]["survived"] for seed in seeds) for trial in (0, body)]
    return [
        *lines,
        f"| survived, of {robots} | {survived[0]:.0f} | {survived[1]:.0f} | {survived[1] - survived[0]:+.0f} |",
    ]


if __name__ == "__main__":
    main()
