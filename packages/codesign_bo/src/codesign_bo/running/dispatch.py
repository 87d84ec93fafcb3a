"""Attempts in the hand of this process: dispatched, and not yet told."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from codesign_bo.interfaces import EvalRequest, EvalResult
from codesign_bo.records import Proposal, Told
from codesign_bo.running.evaluation import checked
from codesign_bo.space import Value
from codesign_bo.stopping import Thresholds
from codesign_bo.storage import SEARCH, Dispatch, Storage

Evaluation = tuple[int, int]
"""An evaluation: its trial, and its confirmation run or `SEARCH`."""


class Dispatcher:
    """Turns evaluations into requests, each committed before it is returned, and takes results back.

    Args:
        storage: Where everything is committed.
        workdir: Folder in which each evaluation gets its own.
        objectives: Names of the further objectives that a result must have.
        retries: Further attempts after an evaluation was lost.
    """

    def __init__(self, storage: Storage, workdir: Path, objectives: Iterable[str], retries: int) -> None:
        self._storage = storage
        self._workdir = workdir
        self._objectives = tuple(objectives)
        self._retries = retries
        self._held: dict[Evaluation, tuple[str, float]] = {}

    @property
    def held(self) -> frozenset[Evaluation]:
        """Evaluations in hand."""
        return frozenset(self._held)

    def propose(
        self, trial: int, proposal: Proposal, seed: int, deadline: float | None, thresholds: Thresholds | None
    ) -> EvalRequest:
        """Commit a new trial and return its evaluation."""
        made = self._storage.add_trial(trial, proposal, seed, deadline)
        return self._request((trial, SEARCH), made, proposal.params, seed, proposal.fidelity, deadline, thresholds)

    def again(
        self,
        evaluation: Evaluation,
        params: Mapping[str, Value],
        seed: int,
        fidelity: float = 1.0,
        deadline: float | None = None,
        thresholds: Thresholds | None = None,
    ) -> EvalRequest:
        """Commit that an open evaluation, or a new confirmation run, is dispatched, and return it."""
        made = self._storage.dispatch(*evaluation, seed, deadline)
        return self._request(evaluation, made, params, seed, fidelity, deadline, thresholds)

    def _request(
        self,
        evaluation: Evaluation,
        made: Dispatch,
        params: Mapping[str, Value],
        seed: int,
        fidelity: float,
        deadline: float | None,
        thresholds: Thresholds | None,
    ) -> EvalRequest:
        self._held[evaluation] = (made.token, time.monotonic())
        trial, repeat = evaluation
        folder = self._workdir / f"{trial:04d}"
        if repeat != SEARCH:
            folder = folder / "confirm" / f"{repeat:02d}"
        return EvalRequest(
            trial=trial,
            attempt=made.attempt,
            params=params,
            seed=seed,
            fidelity=fidelity,
            workdir=folder,
            deadline=deadline,
            token=made.token,
            thresholds=thresholds,
            repeat=None if repeat == SEARCH else repeat,
        )

    def tell(self, evaluation: Evaluation, result: EvalResult, token: str | None) -> Told:
        """Commit a result (see `Storage.finish`), as a failure if its numbers are not finite.

        Raises:
            StudyError: The evaluation or the token is unknown, or the attempt already has another result.
            TypeError: It is no result.
            ValueError: The result lacks a further objective.
        """
        trial, repeat = evaluation
        own, started = self._held.get(evaluation, (None, 0.0))
        seconds = time.monotonic() - started if own is not None and token in (own, None) else None
        result = checked(result, self._objectives)
        told = self._storage.finish(trial, result, token, repeat, self._retries, seconds)
        if told == "counted" or token in (own, None):
            self._held.pop(evaluation, None)
        return told

    def give_up(self, evaluation: Evaluation, token: str, message: str) -> Told:
        """Commit that an attempt counts as lost (see `Storage.give_up`)."""
        told = self._storage.give_up(evaluation[0], token, message, evaluation[1], self._retries)
        if self._held.get(evaluation, (token,))[0] == token:
            self._held.pop(evaluation, None)
        return told

    def release(self, evaluations: Iterable[Evaluation], message: str) -> None:
        """Commit that nobody works on these any more; they stay open and are dispatched again."""
        tokens = [self._held.pop(e)[0] for e in evaluations if e in self._held]
        if tokens:
            self._storage.interrupt(tokens, message)
