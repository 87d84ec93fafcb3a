"""Reading the tables of a study (see `codesign_bo.storage.schema`)."""

from __future__ import annotations

import json
from typing import Any

from codesign_bo.interfaces import EvalResult
from codesign_bo.records import (
    AttemptRecord,
    Basis,
    ConfirmationRecord,
    HistoryRecord,
    QueuedRecord,
    ScreeningRecord,
    TrialRecord,
)
from codesign_bo.storage.database import Database
from codesign_bo.storage.schema import SEARCH


class Tables(Database):
    """What the tables of one study hold (arguments: see `Database`)."""

    def trials(self) -> list[TrialRecord]:
        """Return all trials by number."""
        query = """SELECT t.trial, params, seed, origin, result, fidelity, basis,
            (SELECT COUNT(*) FROM attempts a WHERE a.trial = t.trial AND a.repeat = e.repeat),
            (SELECT seconds FROM attempts a WHERE a.trial = t.trial AND a.repeat = e.repeat AND a.final
             ORDER BY attempt DESC)
            FROM trials t JOIN evaluations e ON e.trial = t.trial AND e.repeat = ? ORDER BY t.trial"""
        with self._guard():
            return [
                TrialRecord(
                    trial,
                    json.loads(params),
                    seed,
                    origin,
                    _result(result),
                    attempts,
                    fidelity,
                    None if basis is None else Basis(**json.loads(basis)),
                    seconds,
                )
                for trial, params, seed, origin, result, fidelity, basis, attempts, seconds in self._db.execute(
                    query, (SEARCH,)
                )
            ]

    def finished(self) -> int:
        """Return the number of trials with a result."""
        query = "SELECT COUNT(*) FROM evaluations WHERE repeat=? AND result IS NOT NULL"
        with self._guard():
            return self._db.execute(query, (SEARCH,)).fetchone()[0]

    def attempts(self) -> list[AttemptRecord]:
        """Return all attempts by trial, repeat (the search first) and number."""
        with self._guard():
            rows = self._db.execute("SELECT * FROM attempts ORDER BY trial, repeat, attempt")
            columns = [name for name, *_ in rows.description]
            return [_attempt(dict(zip(columns, row, strict=True))) for row in rows]

    def confirmations(self) -> list[ConfirmationRecord]:
        """Return all confirmation runs by trial and repeat."""
        query = """SELECT trial, repeat, seed, result,
            (SELECT COUNT(*) FROM attempts a WHERE a.trial = e.trial AND a.repeat = e.repeat)
            FROM evaluations e WHERE repeat != ? ORDER BY trial, repeat"""
        with self._guard():
            rows = self._db.execute(query, (SEARCH,)).fetchall()
            return [ConfirmationRecord(t, r, seed, _result(text), n) for t, r, seed, text, n in rows]

    def queue(self) -> list[QueuedRecord]:
        """Return all queued designs, first come first."""
        with self._guard():
            rows = self._db.execute("SELECT params, trial FROM queue ORDER BY position").fetchall()
            return [QueuedRecord(json.loads(params), trial) for params, trial in rows]

    def screening(self) -> list[ScreeningRecord]:
        """Return all screened designs in the order they came."""
        with self._guard():
            rows = self._db.execute("SELECT params, value, sem FROM screening ORDER BY position").fetchall()
            return [ScreeningRecord(json.loads(params), value, sem) for params, value, sem in rows]

    def history(self) -> list[HistoryRecord]:
        """Return all imported evaluations in the order they came."""
        with self._guard():
            rows = self._db.execute("SELECT source, trial, params, result FROM history ORDER BY position").fetchall()
            return [HistoryRecord(s, t, json.loads(params), EvalResult.from_json(r)) for s, t, params, r in rows]


def _attempt(row: dict[str, Any]) -> AttemptRecord:
    repeat = None if row["repeat"] == SEARCH else row["repeat"]
    flags = {"final": bool(row["final"]), "closed": bool(row["closed"])}
    return AttemptRecord(**{**row, **flags, "repeat": repeat, "result": _result(row["result"])})


def _result(text: str | None) -> EvalResult | None:
    return None if text is None else EvalResult.from_json(text)
