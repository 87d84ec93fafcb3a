"""Writes report.html: everything inside one file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from morphgen import BodyFactory
from morphgen.views.drawing import draw_bodies

from legged_codesign.choice import Choice
from legged_codesign.config import Objective, RunConfig
from legged_codesign.objective import UNITS, physical
from legged_codesign.report import screening, training
from legged_codesign.report.bodies import changed_parts, length_rows, total_mass
from legged_codesign.report.confirmation import confirmation, confirmed_rows, separability
from legged_codesign.report.data import RunData, read_run
from legged_codesign.report.page import Picture, render
from legged_codesign.report.search import search
from legged_codesign.report.walk import walk
from legged_codesign.run_folder import Files
from legged_codesign.stages import write_text

HEADINGS = {
    "convergence": "Convergence",
    "landscape": "Landscape",
    "pairs": "Landscapes of all pairs",
    "slices": "Along each parameter",
    "sensitivity": "Sensitivity",
    "calibration": "Calibration",
    "pareto": "Compromises",
    "timeline": "Time line",
}


def write_report(folder: Path, config: RunConfig, factory: BodyFactory) -> Path:
    """Write `folder/report.html` from what the run left on disk; what is missing is said in words.

    Returns:
        Its path.
    """
    data, files = read_run(folder), Files(folder)
    objective = config.objective
    page = render(
        "report.html.j2",
        **_head(data, config),
        **_bodies(data, factory),
        **_screened(data, config),
        **_confirmed(data, objective),
        config=config,
        unit=UNITS[objective],
        space=factory.space.names,
        walk=walk(data),
        comparison=data.comparison,
        judged=f"{config.distil.judged.robots_per_body} robots, {config.distil.judged.seconds:g} s",
        optimises=training.optimises(config),
        search=search(files.study, objective),
        headings=HEADINGS,
        fine_tuning=_fine_tuning(data, objective),
        trials=trial_rows(data, objective),
        pretraining=Picture.of(training.pretraining(data.pretrain)) if data.pretrain else None,
        provenance=provenance_rows(data),
        stages=data.stages,
    )
    write_text(files.report, page)
    return files.report


def _head(data: RunData, config: RunConfig) -> dict[str, Any]:
    choice = data.choice
    subtitle = [
        f"task {config.task}",
        f"preset {config.preset}",
        f"seed {config.seed}",
        f"{len(data.trials)} bodies in the search",
    ]
    if choice is not None:
        subtitle.append(f"{len(data.gains)} confirmed against the nominal one on {choice.seeds} fresh seeds")
    return {
        "title": f"Co-design of {config.robot} for {config.objective}",
        "subtitle": ", ".join(subtitle),
        "verdict": verdict(data, config.objective),
        "improved": bool(choice and choice.trial and choice.significant),
        "choice": choice,
        "chosen_trial": None if choice is None else choice.trial,
        "rollout": data.rollout,
    }


def verdict(data: RunData, objective: Objective) -> str:
    """What came out, or how far the run got."""
    if data.choice is not None:
        return data.choice.sentence(objective)
    finished = [t for t in data.trials if t.result is not None]
    if finished and all(t.failed for t in finished):
        return f"no body was chosen: all {len(finished)} trials failed; their messages are in the trial table"
    return f"no body was chosen yet: the run stopped after {len(finished)} trials; its command goes on from there"


def _bodies(data: RunData, factory: BodyFactory) -> dict[str, Any]:
    names = factory.space.names
    first = data.nominal or dict(zip(names, factory.space.nominal, strict=True))
    nominal = np.array([first[name] for name in names])
    caption = "Each in its stance, seen from the right; the front is on the right. Lengths in mm with their scales."
    choice = data.choice
    if choice is None:
        return {"drawing": Picture.of(draw_bodies(factory, nominal[None], ["nominal"]), caption)}
    chosen = choice.design(names)
    bodies = np.array([nominal, chosen])
    return {
        "drawing": Picture.of(draw_bodies(factory, bodies, ["nominal", _chosen_label(choice)]), caption),
        "lengths": length_rows(factory, bodies),
        "parts": changed_parts(factory, nominal, chosen),
        "masses": [total_mass(factory, body) for body in bodies],
    }


def _chosen_label(choice: Choice) -> str:
    return "chosen" if choice.trial else "chosen (the nominal body)"


def _screened(data: RunData, config: RunConfig) -> dict[str, Any]:
    rows, objective, robots = data.screening, config.objective, config.screen.robots
    if not rows:
        return {"screened": Picture("", "no body has been screened"), "failures": None}
    caption = f"Zero-step scores of {len(rows)} bodies under the generalist; the best became the first trials."
    shown = Picture.of(screening.scores(rows, objective), caption)
    if not screening.told(rows):
        return {
            "screened": shown,
            "failures": Picture("", "this run's screening kept scores only: who failed is not known"),
            "failing": [],
        }
    fell = screening.failing(rows, robots)
    return {
        "screened": shown,
        "failures": Picture.of(screening.failures(rows, robots), screening.in_words(rows, robots)),
        "failing": [
            {**row, "body": "nominal" if i == 0 else i, "score": physical(row["score"], objective), "robots": robots}
            for i, row in fell[: screening.WORST]
        ],
        "failing_total": len(fell),
    }


def _confirmed(data: RunData, objective: Objective) -> dict[str, Any]:
    if not data.gains:
        return {"confirmed": []}
    labels = {t.trial: ("nominal" if t.trial == 0 else f"body {t.trial}") for t in data.trials}
    return {
        "confirmed": confirmed_rows(data, objective),
        "confirmation": Picture.of(confirmation(data.confirmations, data.gains, labels, objective)),
        "separable": separability(data),
    }


def _fine_tuning(data: RunData, objective: Objective) -> Picture:
    made = training.fine_tuning(data.trials, objective)
    return Picture("", "no trial has a learning curve") if made is None else Picture.of(made)


def trial_rows(data: RunData, objective: Objective) -> list[dict[str, Any]]:
    """The trial table."""
    rows = []
    for t in data.trials:
        result = t.result if t.ok else None
        rows.append(
            {
                "trial": t.trial,
                "params": t.params,
                "origin": t.origin,
                "status": t.status,
                "message": t.result.message if t.result is not None else "",
                "score": None if result is None else physical(result.mean, objective),
                "sem": None if result is None else result.sem,
                "extras": {} if result is None else result.extras,
                "survived": "" if result is None else f"{result.extras.get('survived', float('nan')):.0f}/{result.n}",
            }
        )
    return rows


def provenance_rows(data: RunData) -> list[tuple[str, str]]:
    """How to make the run again: command, seed, commit, machine, versions."""
    facts = dict(data.provenance)
    machine = f"{facts.pop('processor', 'unknown')}, {facts.pop('cores', '?')} cores, {facts.pop('system', '')}"
    first = {
        "command": data.command or "not recorded",
        "seed": str(data.settings.get("seed", "unknown")),
        "commit": facts.pop("commit", "unknown (not run from a checkout)"),
        "machine": machine,
    }
    versions = ", ".join(f"{name} {value}" for name, value in facts.items())
    return [*first.items(), ("versions", versions)]
