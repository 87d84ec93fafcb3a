"""From older versions of the schema to the present one."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from pathlib import Path
from typing import Any

from codesign_bo.storage.schema import SCHEMA_VERSION, SEARCH, create

OLDEST = 1
"""The first version of the schema that can be read."""

_TABLES = ("attempts", "confirmations", "queue", "screening", "trials", "meta")


def back_up(db: sqlite3.Connection, path: Path, version: int) -> Path:
    """Copy a study file beside itself, with all that is committed, and return the path of the copy.

    The copy is complete or absent. One left by a migration that was interrupted is replaced.
    """
    target = path.with_name(f"{path.name}.v{version}.bak")
    unfinished = target.with_name(target.name + ".tmp")
    unfinished.unlink(missing_ok=True)
    copy = sqlite3.connect(unfinished)
    try:
        db.backup(copy)
    finally:
        copy.close()
    with unfinished.open("rb") as file:
        os.fsync(file.fileno())
    os.replace(unfinished, target)
    return target


def migrate(db: sqlite3.Connection, version: int) -> None:
    """Bring all tables from a version to the present one, within the caller's transaction."""
    assert OLDEST <= version < SCHEMA_VERSION
    _from_1(db)


def result_from_1(result: dict[str, Any]) -> dict[str, Any]:
    """Return a result of version 1, which had the kind `failed` for what had no other, as one of today."""
    return {**result, "status": "crash"} if result["status"] == "failed" else result


def _from_1(db: sqlite3.Connection) -> None:
    """Version 1 had the result in the trial, attempts of trials only and without tokens, and no identity."""
    old = {table: db.execute(f"SELECT * FROM {table} ORDER BY rowid").fetchall() for table in _TABLES}
    for table in _TABLES:
        db.execute(f"DROP TABLE {table}")
    create(db)
    meta = dict(old["meta"])
    first = min((started for _, _, started, *_ in old["attempts"]), default=0.0)
    identity = hashlib.sha256(f"{meta.get('header')} {first!r}".encode()).hexdigest()[:32]
    meta |= {"schema_version": str(SCHEMA_VERSION), "id": identity}
    db.executemany("INSERT INTO meta VALUES (?, ?)", meta.items())
    for trial, params, seed, origin, told in old["trials"]:
        result = _text_from_1(told)
        db.execute("INSERT INTO trials VALUES (?, ?, ?, 1.0, NULL)", (trial, params, origin))
        db.execute("INSERT INTO evaluations VALUES (?, ?, ?, ?)", (trial, SEARCH, seed, result))
        attempts = sorted(row for row in old["attempts"] if row[0] == trial)
        for _, attempt, started, ended, status, message in attempts:
            status = "crash" if status == "failed" else status
            outcome = result if attempt == len(attempts) and ended is not None else None
            _insert_attempt(db, trial, SEARCH, attempt, status, started, ended, message, outcome)
    for trial, repeat, seed, attempts, told in old["confirmations"]:
        result = _text_from_1(told)
        db.execute("INSERT INTO evaluations VALUES (?, ?, ?, ?)", (trial, repeat, seed, result))
        for attempt in range(1, attempts + 1):
            outcome = result if attempt == attempts else None
            _insert_attempt(db, trial, repeat, attempt, None, None, None, None, outcome)
    db.executemany("INSERT INTO queue VALUES (?, ?, ?)", old["queue"])
    db.executemany("INSERT INTO screening VALUES (?, ?, ?, NULL)", old["screening"])


def _text_from_1(result: str | None) -> str | None:
    return None if result is None else json.dumps(result_from_1(json.loads(result)), sort_keys=True)


def _insert_attempt(
    db: sqlite3.Connection,
    trial: int,
    repeat: int,
    attempt: int,
    status: str | None,
    started: float | None,
    ended: float | None,
    message: str | None,
    result: str | None,
) -> None:
    """Insert an attempt of version 1; of those without an outcome no coordinator is waiting any more."""
    if status is None and result is not None:
        outcome = json.loads(result)
        status, message = outcome["status"], outcome["message"]
    row = {
        "token": f"v1-{trial}-{repeat}-{attempt}",
        "trial": trial,
        "repeat": repeat,
        "attempt": attempt,
        "status": status or "interrupted",
        "started": started,
        "ended": ended,
        "message": message or "",
        "result": result,
        "final": status is not None,
    }
    db.execute(
        "INSERT INTO attempts VALUES (:token, :trial, :repeat, :attempt, :status, :started, :ended, NULL, NULL, "
        ":message, :result, :final, :final)",
        row,
    )
