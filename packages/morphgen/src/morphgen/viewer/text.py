"""The viewer's words about a design, as HTML."""

from __future__ import annotations

from html import escape

from morphgen.viewer.picture import Picture

_UNITS = {"m": (1000.0, "mm", 1), "kg": (1.0, "kg", 3)}
"""Unit of a measurement -> factor, unit and decimals to show it with."""
_GOOD, _BAD, _FAINT = "#1b7f3b", "#b3261e", "#868e96"


def verdict(shown: Picture) -> str:
    """Whether the body can stand and whether its links can exist, and why not."""
    stance = _banner("Feasible" if shown.feasible else "Not feasible", shown.feasible, list(shown.problems))
    valid = shown.links - len(shown.invalid_links)
    label = f"Inertia valid: {valid} of {shown.links} links"
    reasons = [f"{link}: {problem}" for link, problem in shown.invalid_links.items()]
    return f'<div style="padding:0.25em 1em">{stance}{_banner(label, not reasons, reasons)}</div>'


def measurements(shown: Picture, nominal: Picture) -> str:
    """A table of the dimensions with their change from the nominal body."""
    rows = []
    for key, value in shown.dimensions.items():
        name, short = key.rsplit("_", 1)
        factor, unit, decimals = _UNITS[short]
        change = (value - nominal.dimensions[key]) * factor
        delta = f"{change:+.{decimals}f}" if abs(change) >= 0.5 * 10**-decimals else "–"
        cell = '<td style="text-align:right;white-space:nowrap;padding:0.1em 0 0.1em 0.6em'
        rows.append(
            f"<tr><td>{escape(name.replace('_', ' '))}</td>"
            f'{cell}">{value * factor:.{decimals}f} {unit}</td>{cell};color:{_FAINT}">{delta}</td></tr>'
        )
    head = f'<tr style="color:{_FAINT}"><td></td><td style="text-align:right">this body</td>'
    head += '<td style="text-align:right">change</td></tr>'
    style = "width:100%;font-size:0.85em;border-collapse:collapse;font-variant-numeric:tabular-nums"
    return f'<div style="padding:0 1em"><table style="{style}">{head}{"".join(rows)}</table></div>'


def failure(message: str) -> str:
    """A design of which no body can be made."""
    return f'<div style="padding:0.25em 1em">{_banner("No body", False, [message])}</div>'


def _banner(label: str, good: bool, reasons: list[str]) -> str:
    color, sign = (_GOOD, "✓") if good else (_BAD, "✗")
    lines = "".join(f'<div style="font-weight:400;font-size:0.85em">{escape(reason)}</div>' for reason in reasons)
    box = f"border-left:4px solid {color};background:{color}14;color:{color}"
    return f'<div style="{box};padding:0.3em 0.6em;margin:0.25em 0;font-weight:600">{sign} {escape(label)}{lines}</div>'
