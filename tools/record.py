"""Record a finished run under results/: its small files, and how to make it again.

python tools/record.py runs/laptop-go2-flat-cost-of-transport go2-flat-cost-of-transport "make demo"
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import yaml

from legged_codesign.choice import Choice
from legged_codesign.provenance import described
from legged_codesign.run_folder import read_config

RESULTS = Path(__file__).parents[1] / "results"
KEPT = ("config.yaml", "trials.json", "choice.json", "rollout.json", "metrics.jsonl", "student/comparison.json")


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
    lines = (
        f"# {name}",
        "",
        choice.sentence(config.objective) + ".",
        "",
        *described(command, config.seed, machine),
        "",
        "`trials.json` is the trial table, `choice.json` the comparison on fresh seeds, `rollout.json` the run of the",
        "student, `comparison.json` student and teacher on the same starts, `metrics.jsonl` the seconds of each stage.",
    )
    (target / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
