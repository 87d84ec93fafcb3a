"""Pictures of a study. They need matplotlib, which the extra `plots` brings.

Each `plot_` function takes a `StudyView` and returns a matplotlib `Figure`; it raises `NothingToShowError` if the
study does not have what the figure shows, or not yet. `write_report` puts all of them on one page.

Example:
    >>> with open_study("study.sqlite") as view:  # doctest: +SKIP
    ...     plot_slices(view, Labels("return", {"thigh": "m"})).savefig("slices.png")
"""

from __future__ import annotations

import importlib.util

if importlib.util.find_spec("matplotlib") is None:
    raise ImportError("figures need matplotlib: pip install 'legged-codesign-bo[plots]'")

from codesign_bo.plots.calibration import plot_calibration
from codesign_bo.plots.convergence import plot_convergence
from codesign_bo.plots.gallery import PICTURES
from codesign_bo.plots.landscape import plot_landscape
from codesign_bo.plots.pairs import plot_pairs
from codesign_bo.plots.pareto import plot_pareto
from codesign_bo.plots.picture import NothingToShowError, Picture
from codesign_bo.plots.report import Report, write_report
from codesign_bo.plots.sensitivity import plot_sensitivity
from codesign_bo.plots.slices import plot_slices
from codesign_bo.plots.style import Labels
from codesign_bo.plots.timeline import plot_timeline

__all__ = [
    "PICTURES",
    "Labels",
    "NothingToShowError",
    "Picture",
    "Report",
    "plot_calibration",
    "plot_convergence",
    "plot_landscape",
    "plot_pairs",
    "plot_pareto",
    "plot_sensitivity",
    "plot_slices",
    "plot_timeline",
    "write_report",
]
