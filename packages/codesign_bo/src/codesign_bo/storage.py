"""Durable trials: one SQLite file, one writer, every step committed before the next begins.

Write-ahead journal and full synchronisation: what a method has returned survives a crash of the process or
of the machine. A proposal is committed before it is dispatched, so an interrupted study never redraws one.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from codesign_bo.errors import StudyError
from codesign_bo.header import Header, differences
from codesign_bo.interfaces import EvalResult
from codesign_bo.lock import StudyLock
from codesign_bo.records import ConfirmationRecord, Proposal, QueuedRecord, ScreeningRecord, TrialRecord

SCHEMA_VERSION = 1

_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE trials (
    trial INTEGER PRIMARY KEY, params TEXT NOT NULL, seed INTEGER NOT NULL, origin TEXT NOT NULL,
    result TEXT);
CREATE TABLE attempts (
    trial INTEGER NOT NULL REFERENCES trials, attempt INTEGER NOT NULL,
    started REAL NOT NULL, ended REAL, status TEXT, message TEXT, PRIMARY KEY (trial, attempt));
CREATE TABLE queue (
    position INTEGER PRIMARY KEY, params TEXT NOT NULL UNIQUE, trial INTEGER REFERENCES trials);
CREATE TABLE screening (position INTEGER PRIMARY KEY, params TEXT NOT NULL UNIQUE, value REAL NOT NULL);
CREATE TABLE confirmations (
    trial INTEGER NOT NULL REFERENCES trials, repeat INTEGER NOT NULL, seed INTEGER NOT NULL,
    attempts INTEGER NOT NULL, result TEXT, PRIMARY KEY (trial, repeat));
"""


class Storage:
    """The tables of one study.

    Args:
        path: The SQLite file; created, with its folder, unless `read_only`.
        read_only: Open without the lock, to look at a study that may be running.

    Raises:
        StudyError: The file is missing, damaged, of another program or version, locked, or not writable.
    """

    def __init__(self, path: Path, read_only: bool = False) -> None:
        self.path = Path(path)
        self._lock: StudyLock | None = None
        try:
            if read_only:
                if not self.path.is_file():
                    raise StudyError(f"there is no study at {self.path}")
                self._db = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True)
            else:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._lock = StudyLock(self.path)
                self._db = sqlite3.connect(self.path)
            self._db.isolation_level = None
        except (OSError, sqlite3.Error) as error:
            self._release()
            raise StudyError(
                f"cannot open {self.path} for {'reading' if read_only else 'writing'} ({error}); "
                "check that its folder exists and that you may write there"
            ) from error
        try:
            self._prepare(read_only)
        except BaseException:
            self.close()
            raise

    def _prepare(self, read_only: bool) -> None:
        with self._guard():
            verdict = self._db.execute("PRAGMA quick_check(1)").fetchone()[0]
            if verdict != "ok":
                raise sqlite3.DatabaseError(verdict)
            tables = {row[0] for row in self._db.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        if not read_only:
            with self._guard():
                self._db.execute("PRAGMA journal_mode=WAL")
                self._db.execute("PRAGMA synchronous=FULL")
                self._db.execute("PRAGMA foreign_keys=ON")
            if not tables:
                with self._transaction():
                    for statement in _SCHEMA.split(";\n"):
                        self._db.execute(statement)
                    self._set_meta("schema_version", str(SCHEMA_VERSION))
                return
        version = self._meta("schema_version") if "meta" in tables else None
        if version is None:
            raise StudyError(f"{self.path} is an SQLite file, but no study; choose another path")
        if version != str(SCHEMA_VERSION):
            raise StudyError(
                f"{self.path} has schema version {version}, this codesign_bo reads {SCHEMA_VERSION}; "
                "use the codesign_bo that wrote it, or export it there and import it here"
            )

    def close(self) -> None:
        """Close the file and free the lock."""
        self._db.close()
        self._release()

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()

    # --- header ---------------------------------------------------------------------------------------

    def header(self) -> Header | None:
        """Return the header, or None in a file without one."""
        text = self._meta("header")
        with self._guard():
            return None if text is None else Header.from_json(text)

    def bind(self, header: Header) -> None:
        """Write the header into a new file, or check that the file has the same.

        Raises:
            StudyError: The file belongs to a study with another header; the message lists the differences.
        """
        stored = self.header()
        if stored is None:
            with self._transaction():
                self._set_meta("header", header.to_json())
        elif stored != header:
            raise StudyError(
                f"{self.path} belongs to another study: {'; '.join(differences(stored, header))}. "
                "Choose another path, or open it with the stored settings"
            )

    def _meta(self, key: str) -> str | None:
        with self._guard():
            row = self._db.execute("SELECT value FROM meta WHERE key=?", (key,)).fetchone()
        return None if row is None else row[0]

    def _set_meta(self, key: str, value: str) -> None:
        self._db.execute("INSERT INTO meta VALUES (?, ?)", (key, value))

    # --- trials ---------------------------------------------------------------------------------------

    def trials(self) -> list[TrialRecord]:
        """Return all trials by number."""
        query = """SELECT trial, params, seed, origin, result,
            (SELECT COUNT(*) FROM attempts a WHERE a.trial = t.trial) FROM trials t ORDER BY trial"""
        with self._guard():
            rows = self._db.execute(query).fetchall()
            return [
                TrialRecord(trial, json.loads(params), seed, origin, _result(result), attempts)
                for trial, params, seed, origin, result, attempts in rows
            ]

    def add_trial(self, trial: int, proposal: Proposal, seed: int) -> None:
        """Commit a new trial with its first attempt, and take its design off the queue."""
        params = json.dumps(proposal.params)
        with self._transaction():
            row = (trial, params, seed, proposal.origin)
            self._db.execute("INSERT INTO trials VALUES (?, ?, ?, ?, NULL)", row)
            self._start(trial, 1)
            if proposal.origin == "queued":
                self._db.execute("UPDATE queue SET trial=? WHERE params=?", (trial, params))

    def add_attempt(self, trial: int) -> int:
        """Commit that an unfinished trial is dispatched again; return the number of the attempt."""
        with self._transaction():
            query = "SELECT COUNT(*) FROM attempts WHERE trial=?"
            attempt = 1 + self._db.execute(query, (trial,)).fetchone()[0]
            self._start(trial, attempt)
        return attempt

    def _start(self, trial: int, attempt: int) -> None:
        self._db.execute(
            "INSERT INTO attempts (trial, attempt, started) VALUES (?, ?, ?)", (trial, attempt, time.time())
        )

    def finish(self, trial: int, result: EvalResult) -> bool:
        """Commit the result of a trial; return False if it was there already.

        Raises:
            StudyError: There is no such trial, or it has another result.
        """
        with self._transaction():
            row = self._db.execute("SELECT result FROM trials WHERE trial=?", (trial,)).fetchone()
            if row is None:
                raise StudyError(f"{self.path} has no trial {trial}; only proposals of ask() can be told")
            if row[0] is not None:
                _same(f"trial {trial} of {self.path}", row[0], result)
                return False
            self._db.execute("UPDATE trials SET result=? WHERE trial=?", (result.to_json(), trial))
            self._db.execute(
                """UPDATE attempts SET ended=?, status=?, message=? WHERE trial=? AND attempt=
                (SELECT MAX(attempt) FROM attempts WHERE trial=?)""",
                (time.time(), result.status, result.message, trial, trial),
            )
        return True

    def reopen_failed(self) -> int:
        """Make all failed trials and confirmations unfinished again; return how many. Attempts stay."""
        failed = "result IS NOT NULL AND json_extract(result, '$.status') != 'ok'"
        with self._transaction():
            tables = ("trials", "confirmations")
            return sum(self._db.execute(f"UPDATE {table} SET result=NULL WHERE {failed}").rowcount for table in tables)

    # --- queue and screening --------------------------------------------------------------------------

    def queue(self) -> list[QueuedRecord]:
        """Return all queued designs, first come first."""
        with self._guard():
            rows = self._db.execute("SELECT params, trial FROM queue ORDER BY position").fetchall()
        return [QueuedRecord(json.loads(params), trial) for params, trial in rows]

    def enqueue(self, points: Sequence[Mapping[str, float]]) -> None:
        """Commit designs to the end of the queue; those that ever were in it are left out."""
        with self._transaction():
            self._db.executemany(
                "INSERT OR IGNORE INTO queue (params) VALUES (?)", [(json.dumps(dict(p)),) for p in points]
            )

    def screening(self) -> list[ScreeningRecord]:
        """Return all screened designs in the order they came."""
        with self._guard():
            rows = self._db.execute("SELECT params, value FROM screening ORDER BY position").fetchall()
        return [ScreeningRecord(json.loads(params), value) for params, value in rows]

    def add_screening(self, points: Sequence[Mapping[str, float]], values: Sequence[float]) -> None:
        """Commit screening scores; a newer score of a design replaces the older."""
        with self._transaction():
            self._db.executemany(
                "INSERT INTO screening (params, value) VALUES (?, ?) "
                "ON CONFLICT (params) DO UPDATE SET value=excluded.value",
                [(json.dumps(dict(p)), float(v)) for p, v in zip(points, values, strict=True)],
            )

    # --- confirmations --------------------------------------------------------------------------------

    def confirmations(self) -> list[ConfirmationRecord]:
        """Return all confirmation runs by trial and repeat."""
        query = "SELECT trial, repeat, seed, result, attempts FROM confirmations ORDER BY trial, repeat"
        with self._guard():
            rows = self._db.execute(query).fetchall()
            return [ConfirmationRecord(t, r, seed, _result(text), n) for t, r, seed, text, n in rows]

    def add_confirmation(self, trial: int, repeat: int, seed: int) -> int:
        """Commit that a confirmation run is dispatched; return the number of the attempt."""
        with self._transaction():
            self._db.execute(
                "INSERT INTO confirmations VALUES (?, ?, ?, 1, NULL) "
                "ON CONFLICT (trial, repeat) DO UPDATE SET attempts=attempts+1",
                (trial, repeat, seed),
            )
            query = "SELECT attempts FROM confirmations WHERE trial=? AND repeat=?"
            return self._db.execute(query, (trial, repeat)).fetchone()[0]

    def finish_confirmation(self, trial: int, repeat: int, result: EvalResult) -> None:
        """Commit the result of a confirmation run."""
        with self._transaction():
            self._db.execute(
                "UPDATE confirmations SET result=? WHERE trial=? AND repeat=?",
                (result.to_json(), trial, repeat),
            )

    # --- errors and transactions ----------------------------------------------------------------------

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._guard():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    @contextmanager
    def _guard(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.OperationalError, OSError) as error:
            raise StudyError(
                f"{self.path}: {error}; all committed before is safe. Free the disk or restore access, "
                "then start the same command again"
            ) from error
        except (sqlite3.DatabaseError, ValueError, KeyError) as error:
            raise StudyError(
                f"{self.path} is damaged ({error}) and was left as it is; restore it from a copy or with "
                "`codesign_bo import`, or move it away (with its -wal file) to start a new study"
            ) from error


def _result(text: str | None) -> EvalResult | None:
    return None if text is None else EvalResult.from_json(text)


def _same(what: str, stored: str, result: EvalResult) -> None:
    if stored != result.to_json():
        raise StudyError(
            f"{what} already has a different result: {stored}; told now: {result.to_json()}. "
            "Results are final; tell each trial once"
        )
