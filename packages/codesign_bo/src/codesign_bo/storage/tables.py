"""Changing the tables of a study, one transaction at a time (see `codesign_bo.storage.schema`)."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from codesign_bo.errors import StudyError
from codesign_bo.interfaces import FAILURE_KINDS, EvalResult
from codesign_bo.records import HistoryRecord, Proposal, ScreeningRecord, Told
from codesign_bo.retries import is_final
from codesign_bo.space import Value
from codesign_bo.storage.reading import Tables
from codesign_bo.storage.schema import SEARCH

_ATTEMPT = "token, trial, repeat, attempt, status, started, ended, seconds, deadline, message, result, final, closed"


class Dispatch(NamedTuple):
    """An attempt that was committed.

    Attributes:
        token: What identifies it.
        attempt: Its number, from 1.
    """

    token: str
    attempt: int


class Storage(Tables):
    """The tables of one study; every method that changes them is one transaction (arguments: see `Database`).

    An evaluation is named by its trial and its `repeat`: `SEARCH`, or the number of a confirmation run.
    """

    # --- dispatch -------------------------------------------------------------------------------------

    def add_trial(self, trial: int, proposal: Proposal, seed: int, deadline: float | None = None) -> Dispatch:
        """Commit a new trial with its first attempt, and take its design off the queue."""
        params = json.dumps(proposal.params)
        basis = None if proposal.basis is None else json.dumps(asdict(proposal.basis))
        with self._transaction():
            row = (trial, params, proposal.origin, proposal.fidelity, basis)
            self._db.execute("INSERT INTO trials VALUES (?, ?, ?, ?, ?)", row)
            self._db.execute("INSERT INTO evaluations VALUES (?, ?, ?, NULL)", (trial, SEARCH, seed))
            if proposal.origin == "queued":
                self._db.execute("UPDATE queue SET trial=? WHERE params=?", (trial, params))
            return self._start(trial, SEARCH, deadline)

    def dispatch(self, trial: int, repeat: int, seed: int, deadline: float | None = None) -> Dispatch:
        """Commit that an unfinished or new evaluation is dispatched; earlier attempts are given up."""
        with self._transaction():
            self._db.execute("INSERT OR IGNORE INTO evaluations VALUES (?, ?, ?, NULL)", (trial, repeat, seed))
            return self._start(trial, repeat, deadline)

    def _start(self, trial: int, repeat: int, deadline: float | None = None) -> Dispatch:
        """Nobody waits for earlier attempts any more; their tokens stay known, for late results."""
        self._db.execute(
            "UPDATE attempts SET status='interrupted', ended=?, message='its coordinator ended' "
            "WHERE trial=? AND repeat=? AND status='running'",
            (time.time(), trial, repeat),
        )
        query = "SELECT COUNT(*) FROM attempts WHERE trial=? AND repeat=?"
        made = Dispatch(secrets.token_hex(8), 1 + self._db.execute(query, (trial, repeat)).fetchone()[0])
        self._db.execute(
            f"INSERT INTO attempts ({_ATTEMPT}) VALUES (?, ?, ?, ?, 'running', ?, NULL, NULL, ?, '', NULL, 0, 0)",
            (made.token, trial, repeat, made.attempt, time.time(), deadline),
        )
        return made

    # --- results --------------------------------------------------------------------------------------

    def finish(
        self,
        trial: int,
        result: EvalResult,
        token: str | None = None,
        repeat: int = SEARCH,
        retries: int = 0,
        seconds: float | None = None,
    ) -> Told:
        """Commit what was told of an attempt, and settle its evaluation if that is open and the result final.

        Args:
            trial: The trial.
            result: What was told.
            token: The attempt; None for the latest, or for a new one where that one's failure left the
                evaluation open.
            repeat: The confirmation run, or `SEARCH`.
            retries: Further attempts allowed after a loss (see `codesign_bo.retries`).
            seconds: How long the attempt took.

        Raises:
            StudyError: There is no such evaluation or token, or the attempt already has another result.
        """
        text = result.to_json()
        with self._transaction():
            settled = self._evaluation(trial, repeat)
            attempt, stored = self._attempt(trial, repeat, token)
            if stored is not None:
                if EvalResult.from_json(stored).to_json() == text:
                    return "repeated"
                if token is not None or settled is not None:
                    raise StudyError(
                        f"trial {trial} of {self.path} already has a different result: {stored}; told now: {text}. "
                        "Results are final; tell each attempt once"
                    )
                attempt = self._start(trial, repeat).token
            final = settled is None and self._is_final(trial, repeat, attempt, result, retries)
            self._db.execute(
                "UPDATE attempts SET status=?, ended=?, seconds=?, message=?, result=?, final=MAX(final, ?) "
                "WHERE token=?",
                (result.status, time.time(), seconds, result.message, text, final, attempt),
            )
            if final:
                self._settle(trial, repeat, text)
        return "late" if settled is not None else "counted" if final else "retry"

    def give_up(self, trial: int, token: str, message: str, repeat: int = SEARCH, retries: int = 0) -> Told:
        """Commit that an attempt counts as lost, without a result of its own: a late one may still come.

        Returns:
            `"counted"` if that settled its evaluation as `lost`, `"retry"` if it is still open, `"late"` if
            it was settled before.

        Raises:
            StudyError: There is no such evaluation or token, or the attempt already has a result.
        """
        lost = EvalResult.failure("lost", message)
        with self._transaction():
            settled = self._evaluation(trial, repeat)
            _, stored = self._attempt(trial, repeat, token)
            if stored is not None:
                raise StudyError(f"trial {trial} of {self.path} has a result of this attempt: {stored}")
            final = settled is None and self._is_final(trial, repeat, token, lost, retries)
            self._db.execute(
                "UPDATE attempts SET status='lost', ended=?, message=?, final=MAX(final, ?) WHERE token=?",
                (time.time(), lost.message, final, token),
            )
            if final:
                self._settle(trial, repeat, lost.to_json())
        return "late" if settled is not None else "counted" if final else "retry"

    def interrupt(self, tokens: Iterable[str], message: str) -> None:
        """Commit that running attempts were stopped through no fault of their own."""
        with self._transaction():
            self._db.executemany(
                "UPDATE attempts SET status='interrupted', ended=?, message=? WHERE token=? AND status='running'",
                [(time.time(), message, token) for token in tokens],
            )

    def reopen_failed(self) -> int:
        """Make all failed trials and confirmations unfinished again; return how many. Attempts stay."""
        kinds = ", ".join(f"'{kind}'" for kind in FAILURE_KINDS)
        with self._transaction():
            return self._db.execute(
                f"UPDATE evaluations SET result=NULL WHERE json_extract(result, '$.status') IN ({kinds})"
            ).rowcount

    def _evaluation(self, trial: int, repeat: int) -> str | None:
        """Return the settled result of an evaluation."""
        query = "SELECT result FROM evaluations WHERE trial=? AND repeat=?"
        row = self._db.execute(query, (trial, repeat)).fetchone()
        if row is None:
            raise StudyError(f"{self.path} has no trial {trial}; only proposals of ask() can be told")
        return row[0]

    def _attempt(self, trial: int, repeat: int, token: str | None) -> tuple[str, str | None]:
        """Return the token of an attempt, by default the latest, and what was told of it."""
        query = "SELECT token, result FROM attempts WHERE trial=? AND repeat=? AND token=COALESCE(?, token)"
        row = self._db.execute(f"{query} ORDER BY attempt DESC", (trial, repeat, token)).fetchone()
        if row is None:
            raise StudyError(
                f"no attempt of trial {trial} of {self.path} has the token {token!r}, so its result is refused; "
                "tell a result with the token of its own request"
            )
        return row

    def _is_final(self, trial: int, repeat: int, token: str, result: EvalResult, retries: int) -> bool:
        query = "SELECT status FROM attempts WHERE trial=? AND repeat=? AND token!=? AND NOT closed"
        others = [row[0] for row in self._db.execute(query, (trial, repeat, token))]
        deadline = self._db.execute("SELECT deadline FROM attempts WHERE token=?", (token,)).fetchone()[0]
        return is_final(result.status, others, retries, deadline is not None and time.time() >= deadline)

    def _settle(self, trial: int, repeat: int, result: str) -> None:
        self._db.execute("UPDATE evaluations SET result=? WHERE trial=? AND repeat=?", (result, trial, repeat))
        self._db.execute(
            "UPDATE attempts SET status='superseded', ended=? WHERE trial=? AND repeat=? AND status='running'",
            (time.time(), trial, repeat),
        )
        self._db.execute("UPDATE attempts SET closed=1 WHERE trial=? AND repeat=?", (trial, repeat))

    # --- queue, screening, history ----------------------------------------------------------------------

    def enqueue(self, points: Sequence[Mapping[str, Value]]) -> None:
        """Commit designs to the end of the queue; those that ever were in it are left out."""
        rows = [(json.dumps(dict(p)),) for p in points]
        with self._transaction():
            self._db.executemany("INSERT OR IGNORE INTO queue (params) VALUES (?)", rows)

    def add_screening(self, records: Iterable[ScreeningRecord]) -> None:
        """Commit screening scores; a newer score of a design replaces the older."""
        rows = [(json.dumps(dict(r.params)), r.value, r.sem) for r in records]
        with self._transaction():
            self._db.executemany(
                "INSERT INTO screening (params, value, sem) VALUES (?, ?, ?) "
                "ON CONFLICT (params) DO UPDATE SET value=excluded.value, sem=excluded.sem",
                rows,
            )

    def add_history(self, records: Iterable[HistoryRecord]) -> int:
        """Commit evaluations of other studies; return how many of them are new."""
        rows = [(r.source, r.trial, json.dumps(dict(r.params)), r.result.to_json()) for r in records]
        with self._transaction():
            query = "INSERT OR IGNORE INTO history (source, trial, params, result) VALUES (?, ?, ?, ?)"
            return self._db.executemany(query, rows).rowcount if rows else 0

    def fill(self, identity: str, rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
        """Commit rows into the empty tables of a new study, as they are, by table and column."""
        with self._transaction():
            self._set_meta("id", identity)
            for table, entries in rows.items():
                for entry in entries:
                    names = ", ".join(f":{name}" for name in entry)
                    self._db.execute(f"INSERT INTO {table} ({', '.join(entry)}) VALUES ({names})", dict(entry))
