"""One look for all figures, and the way into the page."""

from __future__ import annotations

import base64
import io

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, MUTED, NOMINAL, BEST, ACCENT, FILL = "#1d2430", "#6b7480", "#8a94a3", "#0b7a75", "#c8553d", "#cfe8e6"


def figure(width: float, height: float, columns: int = 1, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure of `width` x `height` inches with plain axes, row by row; not registered with pyplot."""
    made = Figure((width, height), layout="constrained", facecolor="white")
    axes = list(made.subplots(rows, columns, squeeze=False).ravel())
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


def data_uri(data: bytes, kind: str) -> str:
    """Bytes as a data URI, so that the page needs no other file."""
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
