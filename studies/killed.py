r"""Whether a run that is killed in the middle of every stage ends as one that nothing disturbed.

    make demo
    python studies/killed.py runs/laptop-go2-flat-cost-of-transport --preset laptop

Starts the same `codesign run` in another folder, kills it with all its children (kill -9) half-way through each stage,
going by the time that the stage took in the finished run, and starts it again after each kill. Compares what both
leave behind. Works in runs/studies/killed, which must not exist, and writes results/killed.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from lxml import html
from study import RUNS, markdown_table, write_results

from legged_codesign.run_folder import Files
from legged_codesign.run_log import PROGRESS, Progress

FOLDER = RUNS / "killed"
SAME = ("screening.json", "trials.json", "choice.json", "best.urdf")
CHANGES = re.compile(r"\d{4}-\d\d-\d\d|\b\d+(\.\d+)? ?(s|min|minutes|seconds|MB)\b|[0-9a-f]{7,64}")
"""Dates, durations, sizes and hashes, which differ between any two runs."""


def main() -> None:
    """Kill, go on, compare, record."""
    if len(sys.argv) < 3 or not Files(Path(sys.argv[1])).report.is_file():
        sys.exit(__doc__)
    whole, options = Files(Path(sys.argv[1])), sys.argv[2:]
    if FOLDER.exists():
        sys.exit(f"{FOLDER} exists; remove it, the killed run begins from nothing")
    FOLDER.mkdir(parents=True)
    command = [str(Path(sys.executable).with_name("codesign")), "run", *options, "--folder", str(FOLDER / "run")]
    killed = Files(FOLDER / "run")
    rows = []
    for row in map(json.loads, (whole.folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()):
        lived = live(command, killed, row["stage"], row["seconds"] / 2)
        rows.append(
            (row["stage"], f"{row['seconds']:.1f}", "too short to be caught" if lived is None else f"{lived:.1f}")
        )
        print(*rows[-1], flush=True)
    with (FOLDER / "output.txt").open("ab") as output:
        subprocess.run(command, check=True, stdout=output, stderr=subprocess.STDOUT)
    verdicts = [(name, alike(whole.folder / name, killed.folder / name)) for name in SAME]
    verdicts.append(("rollout.json, without the bundle's hash", said(rollout(whole) == rollout(killed))))
    verdicts.append(("report.html, words without dates, durations, sizes and hashes", report(whole, killed)))
    lines = [
        f"`codesign run {' '.join(options)}`, killed half-way through each stage and started again, against the same "
        "command undisturbed.",
        "",
        *markdown_table(("stage", "seconds, undisturbed", "killed after, s"), rows),
        "",
        *markdown_table(("what", "in both runs"), verdicts),
    ]
    folder = write_results("killed", lines, {"stages": rows, "verdicts": verdicts}, [0])
    print("\n".join(lines), f"-> {folder}", sep="\n")


def live(command: list[str], files: Files, stage: str, seconds: float) -> float | None:
    """Start the run, kill it after so many seconds of a stage; returns how long it was in it, None if it got away."""
    progress, done = files.folder / "stages" / PROGRESS, files.folder / "stages" / f"{stage}.json"
    with (FOLDER / "output.txt").open("ab") as output:
        run = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        while not done.exists():
            if run.poll() is not None:
                raise RuntimeError(f"the run ended by itself, see {FOLDER / 'output.txt'}")
            since = in_stage(progress, stage)
            if since is not None and time.time() - since >= seconds:
                return time.time() - since
            time.sleep(0.01)
        return None
    finally:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()


def in_stage(progress: Path, stage: str) -> float | None:
    """Unix time since when the run is in a stage, None if it is in another."""
    try:
        found = Progress.from_json(progress.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found.since if found.stage == stage else None


def alike(one: Path, other: Path) -> str:
    """Whether two files have the same bytes."""
    return said(one.read_bytes() == other.read_bytes())


def said(same: bool) -> str:
    """In a word."""
    return "identical" if same else "DIFFERENT"


def rollout(files: Files) -> dict[str, object]:
    """What the student did; the bundle's manifest has a date, so its hash is left out."""
    content = json.loads(files.rollout.read_text(encoding="utf-8"))
    del content["bundle_sha256"]
    return content


def report(one: Files, other: Files) -> str:
    """How many pieces of text of two reports differ."""
    texts = [words(each.report) for each in (one, other)]
    if len(texts[0]) != len(texts[1]):
        return f"DIFFERENT: {len(texts[0])} and {len(texts[1])} pieces of text"
    pairs = [f"'{a}' / '{b}'" for a, b in zip(*texts, strict=True) if a != b]
    return f"{len(pairs)} of {len(texts[0])} pieces differ: {'; '.join(pairs[:5])}" if pairs else said(True)


def words(page: Path) -> list[str]:
    """Pieces of text that a reader of a page sees, without what differs between any two runs."""
    tree = html.parse(page, html.HTMLParser(huge_tree=True, encoding="utf-8"))
    texts = tree.xpath("//body//text()[normalize-space() and not(parent::script or parent::style)]")
    return [CHANGES.sub("#", text.strip()) for text in texts]


if __name__ == "__main__":
    main()
