"""What every picture is: numbers taken from a study, drawn as a figure and put into a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from matplotlib.figure import Figure

from codesign_bo.errors import StudyError
from codesign_bo.plots.style import Labels
from codesign_bo.space import Array, Value
from codesign_bo.view import StudyView


class NothingToShowError(StudyError):
    """A study does not have what a picture shows, or not yet; the message says what is missing."""


class Picture(Protocol):
    """The numbers behind a figure."""

    def figure(self, labels: Labels) -> Figure:
        """Draw them."""
        ...

    def sentence(self, labels: Labels) -> str:
        """Say what they mean."""
        ...


Take = Callable[[StudyView], Picture]
"""Takes the numbers of a picture from a study; raises `NothingToShowError` if they are not there."""


def unit_points(view: StudyView, params: Sequence[Mapping[str, Value]]) -> Array:
    """Return designs as points (n, dim) of the unit cube, also if there are none."""
    return view.space.to_unit(view.space.designs(params)).reshape(len(params), view.space.dim)
