"""The viewer's words about a design, as HTML."""

from __future__ import annotations

from html import escape

from morphgen.viewer.picture import Picture

_UNITS = {"m": (1000.0, "mm", 1), "kg": (1.0, "kg", 3)}
"""Unit of a measurement: factor, unit and decimals to show it with."""
_GOOD, _BAD, _FAINT = "#1b7f3b", "#b3261e", "#868e96"


def verdict(shown: Picture) -> str:
    """Whether the body can stand and whether its links can exist, and why not."""
    stance = _banner("Feasible" if shown.feasible else "Not feasible", shown.feasible, shown.problems)
    label = f"Inertia valid: {shown.links - len(shown.invalid_links)} of {shown.links} links"
    reasons = tuple(f"{link}: {problem}" for link, problem in shown.invalid_links.items())
    missing = "".join(
        f'<div style="color:{_FAINT};font-size:0.85em">{escape(reason)}</div>' for reason in shown.missing
    )
    return _block(stance + _banner(label, not reasons, reasons) + missing)


def failure(message: str) -> str:
    """What to say of a design of which no body can be made."""
    return _block(_banner("No body", False, (message,)))


def measurements(shown: Picture, nominal: Picture) -> str:
    """A table of the dimensions with their change from the nominal body."""
    number = "text-align:right;white-space:nowrap;padding:0.1em 0 0.1em 0.6em"
    rows = [
        f'<tr style="color:{_FAINT}"><td></td><td style="{number}">this body</td><td style="{number}">change</td></tr>'
    ]
    for key, value in shown.dimensions.items():
        name, short = key.rsplit("_", 1)
        factor, unit, decimals = _UNITS[short]
        change = f"{(value - nominal.dimensions[key]) * factor:+.{decimals}f}"
        if not float(change):
            change = "–"
        rows.append(
            f"<tr><td>{escape(name.replace('_', ' '))}</td>"
            f'<td style="{number}">{value * factor:.{decimals}f} {unit}</td>'
            f'<td style="{number};color:{_FAINT}">{change}</td></tr>'
        )
    style = "width:100%;font-size:0.85em;border-collapse:collapse;font-variant-numeric:tabular-nums"
    return _block(f'<table style="{style}">{"".join(rows)}</table>')


def _block(content: str) -> str:
    return f'<div style="padding:0.25em 1em">{content}</div>'


def _banner(label: str, good: bool, reasons: tuple[str, ...]) -> str:
    color, sign = (_GOOD, "✓") if good else (_BAD, "✗")
    lines = "".join(f'<div style="font-weight:400;font-size:0.85em">{escape(reason)}</div>' for reason in reasons)
    box = f"border-left:4px solid {color};background:{color}14;color:{color}"
    return f'<div style="{box};padding:0.3em 0.6em;margin:0.25em 0;font-weight:600">{sign} {escape(label)}{lines}</div>'
