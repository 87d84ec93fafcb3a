"""Writes report.html: everything inside one file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from morphgen import BodyFactory
from morphgen.views.dimensions import dimensions
from morphgen.views.drawing import draw_bodies

from legged_codesign.config import RunConfig
from legged_codesign.objective import UNITS, physical
from legged_codesign.report import figures
from legged_codesign.report.data import RunData, read_run
from legged_codesign.report.motion import read_motion
from legged_codesign.report.style import data_uri, svg
from legged_codesign.report.video import make_video
from legged_codesign.stages import write_text


def write_report(folder: Path, config: RunConfig, factory: BodyFactory) -> Path:
    """Write `folder/report.html` from what the run left on disk.

    Returns:
        Its path.
    """
    data = read_run(folder)
    video = folder / "video.mp4"
    drawn = make_video(folder / "bundle" / "scene.xml", folder / "rollout.mcap", video)
    names = factory.space.names
    nominal = {name: float(data.trials[0].params[name]) for name in names}
    bodies = np.array([[nominal[name] for name in names], data.choice.design(names)])
    drawing = draw_bodies(factory, bodies, ["nominal", "best" if data.choice.trial else "best (the nominal body)"])
    labels = {t.trial: ("nominal" if t.trial == 0 else f"body {t.trial}") for t in data.trials}
    objective = config.objective
    images = {
        "bodies": svg(drawing),
        "history": svg(figures.search_history(data.trials, objective)),
        "confirmation": svg(figures.confirmation(data.confirmations, data.gains, labels, objective)),
        "fine_tuning": svg(figures.fine_tuning(data.trials, objective)),
        "landscape": svg(figures.landscape(data.slices, data.choice.params, objective)),
        "screening": svg(figures.screening(data.screening, objective)),
        "power": svg(figures.joint_power(read_motion(folder / "rollout.mcap"))),
        "pretraining": svg(figures.pretraining(data.pretrain)) if data.pretrain else "",
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("legged_codesign.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("template.html.j2").render(
        config=config,
        data=data,
        choice=data.choice,
        verdict=data.choice.sentence(objective),
        images=images,
        video=data_uri(video.read_bytes(), "video/mp4"),
        video_note=drawn,
        unit=UNITS[objective],
        separable=separability(data),
        confirmed=confirmed_rows(data, objective),
        trials=trial_rows(data, config),
        lengths=length_rows(factory, bodies),
        space=names,
        optimises=optimises(config),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def separability(data: RunData) -> str:
    """Could the search tell bodies apart beyond its noise? In words."""
    scored = [t.result for t in data.trials if t.ok and t.result is not None]
    spread = float(np.std([result.mean for result in scored]))
    within = [
        np.var([r.result.mean for r in data.confirmations if r.trial == body and r.result and r.result.ok], ddof=1)
        for body in {r.trial for r in data.confirmations}
    ]
    noise = float(np.sqrt(np.mean(within)))
    times = spread / noise if noise > 0 else float("inf")
    verdict = "could" if times > 2 else "could hardly"
    return (
        f"The search {verdict} tell bodies apart: their scores spread by {spread:.4f} (standard deviation), "
        f"{times:.0f} times the {noise:.4f} by which one body's score varies between fine-tuning seeds. "
        f"{100 * data.loo:.0f} % of the trials lie inside the 95 % interval that the Gaussian process predicts for "
        "them from the others."
    )


def optimises(config: RunConfig) -> str:
    """Does fine-tuning optimise what the search scores? In words."""
    weight = config.finetune.specific_power
    if config.objective == "return":
        return "Fine-tuning maximises the discounted reward whose undiscounted sum the search scores (eq. 9)."
    return (
        f"Fine-tuning does not optimise {config.objective} alone: its reward is the generalist's (velocity tracking "
        f"and smoothness) plus {weight:g} times positive mechanical power over body weight, which is cost of transport "
        "times speed. The search scores the latter only, with a penalty on tracking errors "
        f"above {config.score.max_error:g} m/s."
    )


def confirmed_rows(data: RunData, objective: Any) -> list[dict[str, Any]]:
    """Means over the fresh seeds for the nominal body and each confirmed one."""
    rows = []
    gains = {gain.trial: gain for gain in data.gains}
    for body in (0, *gains):
        results = [r.result for r in data.confirmations if r.trial == body and r.result is not None and r.result.ok]
        extras = {name: float(np.mean([r.extras.get(name, np.nan) for r in results])) for name in results[0].extras}
        rows.append(
            {
                "name": "nominal" if body == 0 else f"body {body}",
                "params": data.trials[body].params,
                "score": physical(float(np.mean([r.mean for r in results])), objective),
                "gain": gains.get(body),
                "robots": sum(r.n for r in results),
                "survived": sum(r.extras["survived"] for r in results),
                **{name: extras.get(name, float("nan")) for name in ("return", "tracking_error", "distance", "energy")},
                "cost_of_transport": extras.get("cost_of_transport", float("nan")),
            }
        )
    return rows


def trial_rows(data: RunData, config: RunConfig) -> list[dict[str, Any]]:
    """The trial table."""
    rows = []
    for t in data.trials:
        result = t.result
        ok = result is not None and result.ok
        rows.append(
            {
                "trial": t.trial,
                "params": t.params,
                "origin": t.origin,
                "status": t.status,
                "score": physical(result.mean, config.objective) if ok and result else None,
                "sem": result.sem if ok and result else None,
                "tracking_error": result.extras.get("tracking_error") if ok and result else None,
                "survived": f"{result.extras['survived']:.0f}/{result.n}" if ok and result else "",
            }
        )
    return rows


def length_rows(factory: BodyFactory, bodies: np.ndarray) -> list[Mapping[str, Any]]:
    """Dimensions of both bodies, in mm and kg."""
    nominal, best = (dimensions(factory, body) for body in bodies)
    rows = []
    for key, value in nominal.items():
        name, unit = key.rsplit("_", 1)
        scale, shown = (1000.0, "mm") if unit == "m" else (1.0, unit)
        change = 100 * (best[key] / value - 1) if value else 0.0
        rows.append(
            {
                "name": name.replace("_", " "),
                "unit": shown,
                "nominal": scale * value,
                "best": scale * best[key],
                "change": change,
            }
        )
    return rows
