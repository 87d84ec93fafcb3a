"""All pictures there are."""

from __future__ import annotations

from codesign_bo.plots.calibration import Calibration
from codesign_bo.plots.convergence import Convergence
from codesign_bo.plots.landscape import Landscape
from codesign_bo.plots.pairs import Pairs
from codesign_bo.plots.pareto import Front
from codesign_bo.plots.picture import Take
from codesign_bo.plots.sensitivity import Importance
from codesign_bo.plots.slices import Slices
from codesign_bo.plots.timeline import Timeline

PICTURES: dict[str, Take] = {
    "convergence": Convergence.of,
    "slices": Slices.of,
    "landscape": Landscape.of,
    "pairs": Pairs.of,
    "sensitivity": Importance.of,
    "calibration": Calibration.of,
    "pareto": Front.of,
    "timeline": Timeline.of,
}
"""By name, in the order of the page."""
