"""Warm start: what another study measured, as data for this study's surrogate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from codesign_bo.data import tells_viability
from codesign_bo.errors import StudyError
from codesign_bo.records import HistoryRecord
from codesign_bo.space import BoxSpace, Value
from codesign_bo.view import StudyView


@dataclass(frozen=True)
class Imported:
    """What became of another study's trials.

    Attributes:
        added: How many were added now; those that were there already are not counted.
        left_out: Trials of that study that have no place in this one, with the reason.
    """

    added: int
    left_out: Mapping[int, str]


def translate(space: BoxSpace, maximize: bool, other: StudyView) -> tuple[list[HistoryRecord], dict[int, str]]:
    """Express the finished trials of another study in a space, by the names of the parameters.

    A parameter that only this space has takes its nominal value here. A design in which a parameter that
    only the other space has differs from its nominal value there is left out, and so is one outside this
    space, or one that was lost. What the other study imported itself is not passed on.

    Args:
        space: This study's space.
        maximize: This study's direction.
        other: The other study.

    Returns:
        Records, and why the others were left out, by trial.

    Raises:
        StudyError: The other study has the opposite direction, or no parameter in common.
    """
    if other.maximize != maximize:
        raise StudyError(
            f"{other.path} {_direction(other.maximize)} its objective, this study {_direction(maximize)}; "
            "its results cannot become history"
        )
    if not set(space.names) & set(other.space.names):
        raise StudyError(
            f"{other.path} has the parameters {other.space.names}, this study {space.names}: none in common"
        )
    records: list[HistoryRecord] = []
    left_out: dict[int, str] = {}
    for t in other.trials():
        if t.result is None:
            continue
        try:
            design = _design(space, t.params, other.space)
        except ValueError as error:
            left_out[t.trial] = str(error)
            continue
        if t.fidelity == 1.0 and tells_viability(t.result):
            records.append(HistoryRecord(other.identity, t.trial, design, t.result))
        else:
            left_out[t.trial] = "it was lost" if t.fidelity == 1.0 else f"its fidelity is {t.fidelity}"
    return records, left_out


def _design(space: BoxSpace, params: Mapping[str, Value], other: BoxSpace) -> dict[str, Value]:
    varied = [n for n, v in params.items() if n not in space.names and v != other.nominal[n]]
    if varied:
        raise ValueError(f"it varies {varied}, which this study does not have")
    return space.check({n: params.get(n, v) for n, v in space.nominal.items()})


def _direction(maximize: bool) -> str:
    return "maximizes" if maximize else "minimizes"
