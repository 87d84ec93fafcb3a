"""The file of a study: opening, locking, versions, transactions, and errors in words."""

from __future__ import annotations

import logging
import secrets
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from codesign_bo.errors import StudyError
from codesign_bo.header import Header, differences
from codesign_bo.storage.filesystem import refuse_network
from codesign_bo.storage.lock import StudyLock
from codesign_bo.storage.migrate import OLDEST, back_up, migrate
from codesign_bo.storage.schema import SCHEMA_VERSION, create

logger = logging.getLogger(__name__)


class Database:
    """One SQLite file with one writer.

    Write-ahead journal and full synchronisation: what a transaction has committed survives a crash of the
    process or of the machine.

    Args:
        path: The SQLite file; created, with its folder, unless `read_only`.
        read_only: Open without the lock, to look at a study that may be running.
        allow_network: Whether the file may lie on a network file system.

    Raises:
        StudyError: The file is missing, damaged, of another program or a newer version, locked, not
            writable, or on a network file system.
    """

    def __init__(self, path: Path, read_only: bool = False, allow_network: bool = False) -> None:
        self.path = Path(path)
        self._lock: StudyLock | None = None
        try:
            if read_only:
                if not self.path.is_file():
                    raise StudyError(f"there is no study at {self.path}")
                self._db = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True)
            else:
                if not allow_network:
                    refuse_network(self.path)
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
        if tables or read_only:
            self._check_version(self._meta("schema_version") if "meta" in tables else None, read_only)
        if read_only:
            return
        with self._guard():
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute("PRAGMA foreign_keys=ON")
        if not tables:
            with self._transaction():
                create(self._db)
                self._set_meta("schema_version", str(SCHEMA_VERSION))
                self._set_meta("id", secrets.token_hex(16))

    def _check_version(self, version: str | None, read_only: bool) -> None:
        if version is None:
            raise StudyError(f"{self.path} is an SQLite file, but no study; choose another path")
        if not version.isdecimal() or not OLDEST <= int(version) <= SCHEMA_VERSION:
            raise StudyError(
                f"{self.path} has schema version {version}, this codesign_bo reads {OLDEST} to {SCHEMA_VERSION}; "
                "install the codesign_bo that wrote it, or a newer one"
            )
        if int(version) == SCHEMA_VERSION:
            return
        with self._guard():
            if read_only:  # nobody else may be disturbed, so a copy is migrated
                copy = sqlite3.connect(":memory:", isolation_level=None)
                self._db.backup(copy)
                self._db.close()
                self._db = copy
            else:
                saved = back_up(self._db, self.path, int(version))
                logger.warning("%s had schema version %s; a copy of it is %s", self.path, version, saved)
        with self._transaction():
            migrate(self._db, int(version))
        if read_only:
            self._db.execute("PRAGMA query_only=ON")

    def close(self) -> None:
        """Close the file and free the lock."""
        self._db.close()
        self._release()

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()

    # --- header ---------------------------------------------------------------------------------------

    @property
    def identity(self) -> str:
        """What tells this study from all others; copies of the file share it."""
        return self._meta("id") or ""

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
        stored, text = self.header(), header.to_json()
        if stored is None:
            with self._transaction():
                self._set_meta("header", text)
        elif stored != header:
            raise StudyError(
                f"{self.path} belongs to another study: {'; '.join(differences(stored, header))}. "
                "Choose another path, or open it with the stored settings"
            )

    def predicate(self) -> str | None:
        """Return the name of the feasibility predicate that the study was last opened with, or None."""
        return self._meta("predicate")

    def set_predicate(self, name: str) -> None:
        """Commit the name of the feasibility predicate."""
        if name != self.predicate():
            with self._transaction():
                self._set_meta("predicate", name)

    def _meta(self, key: str) -> str | None:
        with self._guard():
            row = self._db.execute("SELECT value FROM meta WHERE key=?", (key,)).fetchone()
        return None if row is None else row[0]

    def _set_meta(self, key: str, value: str) -> None:
        self._db.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))

    # --- transactions and errors ----------------------------------------------------------------------

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
        except (sqlite3.DatabaseError, ValueError, KeyError, TypeError) as error:
            raise StudyError(
                f"{self.path} is damaged ({error}) and was left as it is; restore it from a copy or with "
                "`codesign_bo import`, or move it away (with its -wal file) to start a new study"
            ) from error
