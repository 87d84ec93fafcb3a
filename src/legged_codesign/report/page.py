"""How a page is put together: pictures with words, numbers, templates; everything inside one file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import jinja2
from deploy.page.style import stylesheet, svg
from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure in a page, or the reason why there is none.

    Attributes:
        markup: an SVG element; empty if there is nothing to draw.
        words: what it shows, or what is missing.
    """

    markup: str
    words: str = ""

    @classmethod
    def of(cls, made: Figure, words: str = "") -> Picture:
        """A figure with its caption."""
        return cls(svg(made), words)


def number(value: Any, form: str = "%.3g") -> str:
    """A number for a table; a dash where there is none or none that is finite."""
    if value is None or not math.isfinite(float(value)):
        return "–"
    return (form % value).replace("-", "−")


def sentence(words: str) -> str:
    """The words with a capital at the start and a full stop at the end."""
    return f"{words[:1].upper()}{words[1:]}".rstrip(".") + "." if words else ""


def render(template: str, **content: Any) -> str:
    """A template of this package, filled in."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("legged_codesign.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number, sentence=sentence)
    css = stylesheet() + files("legged_codesign.report").joinpath("report.css").read_text(encoding="utf-8")
    return environment.get_template(template).render(css=css, **content)
