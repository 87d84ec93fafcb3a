"""One look for all figures, and the way into a page."""

from __future__ import annotations

import base64
import io
from importlib.resources import files

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

INK, MUTED, NOMINAL, BEST, ACCENT, FILL = "#1d2430", "#6b7480", "#8a94a3", "#0b7a75", "#c8553d", "#cfe8e6"
OTHERS = ("#7a5195", "#d9a441", "#3d6fb4", INK)
"""For bodies beyond the nominal and the best."""


def figure(
    width: float, height: float, rows: int = 1, columns: int = 1, sharex: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of `width` x `height` inches with plain axes, row by row; not registered with pyplot."""
    made = Figure((width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(made)
    axes = list(made.subplots(rows, columns, squeeze=False, sharex=sharex).ravel())
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(colors=MUTED, labelsize=9)
        ax.grid(color="#e7eaee", linewidth=0.8)
        ax.set_axisbelow(True)
        for spine in ax.spines.values():
            spine.set_color("#c9ced6")
    return made, axes


def label(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Name the axes."""
    ax.set_xlabel(x, color=MUTED, fontsize=9.5)
    ax.set_ylabel(y, color=MUTED, fontsize=9.5)
    if title:
        ax.set_title(title, color=INK, fontsize=10.5, loc="left")


def svg(made: Figure) -> str:
    """A figure as an SVG element, without the XML prolog."""
    buffer = io.StringIO()
    made.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def png(made: Figure, dpi: int = 110) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    made.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def data_uri(data: bytes, kind: str) -> str:
    """Bytes as a data URI, so that the page needs no other file."""
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def stylesheet() -> str:
    """The CSS of a page."""
    return files("deploy.page").joinpath("page.css").read_text(encoding="utf-8")
