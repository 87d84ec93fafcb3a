"""One page that shows a study: what is recommended, its health, and every picture with a sentence."""

from __future__ import annotations

import base64
import contextlib
import html
import io
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from codesign_bo.errors import StudyError
from codesign_bo.health import Check, health
from codesign_bo.plots.gallery import PICTURES
from codesign_bo.plots.picture import NothingToShowError
from codesign_bo.plots.style import PLAIN, Labels
from codesign_bo.view import StudyView

_DPI = 110


@dataclass(frozen=True)
class Report:
    """What was written.

    Attributes:
        page: `index.html`, which needs no other file.
        pictures: PNG files by the name of the picture.
        sentences: What each picture says.
        missing: Pictures that could not be drawn, with the reason.
        checks: Health checks.
    """

    page: Path
    pictures: Mapping[str, Path]
    sentences: Mapping[str, str]
    missing: Mapping[str, str]
    checks: Sequence[Check]


def write_report(view: StudyView, out: Path | str, only: Iterable[str] = (), labels: Labels = PLAIN) -> Report:
    """Write a PNG for each picture, and `index.html` with all of them.

    Files of an earlier report are replaced, and pictures that can no longer be drawn are deleted.

    Args:
        view: The study.
        out: Folder; made if it does not exist.
        only: Names of the pictures; none means all.
        labels: Names and units.

    Raises:
        ValueError: There is no picture of a name.
        StudyError: The folder cannot be written.
    """
    names = tuple(dict.fromkeys(only)) or tuple(PICTURES)
    unknown = [n for n in names if n not in PICTURES]
    if unknown:
        raise ValueError(f"there is no picture {unknown}; choose from {list(PICTURES)}")
    images: dict[str, bytes] = {}
    sentences: dict[str, str] = {}
    missing: dict[str, str] = {}
    for name in names:
        try:
            picture = PICTURES[name](view)
        except NothingToShowError as reason:
            missing[name] = str(reason)
            continue
        buffer = io.BytesIO()
        picture.figure(labels).savefig(buffer, format="png", dpi=_DPI)
        images[name], sentences[name] = buffer.getvalue(), picture.sentence(labels)
    checks = health(view)
    page = _page(view, images, sentences, missing, checks)
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths = {name: _write(folder / f"{name}.png", image) for name, image in images.items()}
        for name in missing:
            (folder / f"{name}.png").unlink(missing_ok=True)
        index = _write(folder / "index.html", page.encode())
    except OSError as error:
        raise StudyError(f"cannot write pictures into {folder} ({error}); choose another folder with --out") from error
    return Report(index, paths, sentences, missing, checks)


def _write(path: Path, content: bytes) -> Path:
    """Write a file, all of it or nothing."""
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(part, 0o644)
        os.replace(part, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part)
        raise
    return path


def _page(
    view: StudyView,
    images: Mapping[str, bytes],
    sentences: Mapping[str, str],
    missing: Mapping[str, str],
    checks: Sequence[Check],
) -> str:
    figures = "".join(_figure(name, image, sentences[name]) for name, image in images.items())
    absent = "".join(f"<li>{html.escape(name)}: {html.escape(why)}</li>" for name, why in missing.items())
    rows = "".join(_check(c) for c in checks)
    title = html.escape(str(view.path.name))
    return _TEMPLATE.format(
        title=title,
        facts=html.escape(_facts(view)),
        recommended=html.escape(_recommended(view)),
        checks=rows,
        figures=figures,
        absent=f"<h2>Not drawn</h2><ul>{absent}</ul>" if absent else "",
        trials=_trials(view),
    )


def _facts(view: StudyView) -> str:
    trials = view.trials()
    finished = sum(t.result is not None for t in trials)
    failed = sum(t.failed for t in trials)
    goal = "maximised" if view.maximize else "minimised"
    words = [f"{finished} trials finished", f"{failed} failed", f"{len(trials) - finished} unfinished"]
    words += [f"{view.space.dim} free parameters", f"the objective is {goal}", f"seed {view.seed}"]
    return ", ".join(words) + "."


def _recommended(view: StudyView) -> str:
    if not any(t.ok for t in view.trials()):
        return "No trial has a score yet, so nothing is recommended."
    sentence = view.recommend().sentence()
    return f"{sentence[:1].upper()}{sentence[1:]}."


def _check(check: Check) -> str:
    way = f' <span class="way">{html.escape(check.way_out)}</span>' if check.way_out else ""
    return (
        f'<tr class="{check.severity}"><th scope="row">{check.severity}</th><td>{html.escape(check.name)}</td>'
        f"<td>{html.escape(check.sentence)}{way}</td></tr>"
    )


def _figure(name: str, image: bytes, sentence: str) -> str:
    data = base64.b64encode(image).decode("ascii")
    words = html.escape(sentence)
    return (
        f'<figure id="{html.escape(name)}"><h2>{html.escape(name.capitalize())}</h2>'
        f'<img src="data:image/png;base64,{data}" alt="{words}"><figcaption>{words}</figcaption></figure>'
    )


def _trials(view: StudyView) -> str:
    names = ("trial", "origin", *view.space.names, "mean", "standard error", *view.objectives, "status")
    head = "".join(f"<th>{html.escape(n)}</th>" for n in names)
    rows: list[str] = []
    for t in view.trials():
        mean, sem = "", ""
        if t.ok and t.result is not None:
            mean, sem = _cell(t.result.mean), "" if t.result.sem is None else f"{t.result.sem:.2g}"
        further = [_cell(t.result.extras[n]) if t.ok and t.result is not None else "" for n in view.objectives]
        cells = (t.trial, t.origin, *map(_cell, t.params.values()), mean, sem, *further, t.status)
        rows.append("".join(f"<td>{html.escape(str(c))}</td>" for c in cells))
    return f"<tr>{head}</tr>" + "".join(f"<tr>{row}</tr>" for row in rows)


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


_TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1d2430; background: #fff; max-width: 1160px; margin: 2rem auto;
  padding: 0 1rem; }}
h1 {{ font-size: 1.5rem; margin-bottom: .2rem; }}
h2 {{ font-size: 1.15rem; margin: 0 0 .5rem; }}
figure {{ margin: 2.2rem 0; }}
img {{ max-width: 100%; height: auto; display: block; }}
figcaption {{ max-width: 70ch; margin-top: .4rem; }}
table {{ border-collapse: collapse; }}
.health th {{ text-align: left; padding: .35rem .8rem .35rem .5rem; border-left: 5px solid; white-space: nowrap;
  font-weight: 600; }}
.health td {{ padding: .35rem .8rem .35rem 0; vertical-align: top; border-bottom: 1px solid #e7eaee; }}
.health th {{ vertical-align: top; border-bottom: 1px solid #e7eaee; }}
.error th {{ border-left-color: #882255; }} .warning th {{ border-left-color: #d55e00; }}
.info th {{ border-left-color: #0072b2; }} .ok th {{ border-left-color: #009e73; }}
.way {{ color: #59616d; }}
.wide {{ overflow-x: auto; }}
.trials td, .trials th {{ padding: .15rem .7rem .15rem 0; text-align: right; font-variant-numeric: tabular-nums;
  font-size: .87rem; white-space: nowrap; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{facts}</p>
<p><strong>{recommended}</strong></p>
<h2>Health</h2>
<table class="health">{checks}</table>
{figures}
{absent}
<details><summary>All trials</summary><div class="wide"><table class="trials">{trials}</table></div></details>
</body>
</html>
"""
