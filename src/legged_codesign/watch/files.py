"""Files of a run that may be written at this very moment, read whole only when they have changed."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from codesign_bo import StudyError, open_study
from codesign_bo.records import AttemptRecord, ConfirmationRecord, TrialRecord

Stamp = tuple[int, int, int] | None
_TAIL = 16_384
"""Bytes at the end of a log that are looked at."""


def stamp(path: Path) -> Stamp:
    """What changes whenever a file does; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_ino, stat.st_size, stat.st_mtime_ns


class CachedFile:
    """The parsed content of a file that is replaced as a whole.

    Args:
        path: the file.
        parse: of its text; raises ValueError, KeyError or TypeError for what is damaged.

    Attributes:
        problem: why the file could not be read; None if it could, or if there is none.
    """

    def __init__(self, path: Path, parse: Callable[[str], Any]) -> None:
        self._path, self._parse = path, parse
        self._stamp: Stamp = None
        self._value: Any = None
        self.problem: str | None = None

    def read(self) -> Any:
        """The content; None if the file is missing or damaged."""
        now = stamp(self._path)
        if now == self._stamp:
            return self._value
        self._stamp, self._value, self.problem = now, None, None
        if now is not None:
            try:
                self._value = self._parse(self._path.read_text(encoding="utf-8"))
            except FileNotFoundError:  # just taken away
                pass
            except (OSError, ValueError, KeyError, TypeError) as error:
                self.problem = f"{self._path} cannot be read: {error}"
        return self._value


class JsonLines:
    """The rows of a growing file with one JSON object a line; only what was added is read again."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode: int | None = None
        self._offset = 0
        self._rows: list[dict[str, Any]] = []

    def read(self) -> Sequence[dict[str, Any]]:
        """All complete rows; a line that is still being written, or is damaged, is left out."""
        try:
            with self._path.open("rb") as file:
                stat = os.fstat(file.fileno())
                if stat.st_ino != self._inode or stat.st_size < self._offset:
                    self._inode, self._offset, self._rows = stat.st_ino, 0, []
                file.seek(self._offset)
                added = file.read()
        except OSError:
            self._inode, self._offset, self._rows = None, 0, []
            return ()
        complete = added[: added.rfind(b"\n") + 1]
        self._offset += len(complete)
        for line in complete.splitlines():
            try:
                row = json.loads(line)
            except ValueError:
                continue
            if isinstance(row, dict):
                self._rows.append(row)
        return tuple(self._rows)


@dataclass(frozen=True)
class Tables:
    """What a study holds.

    Attributes:
        trials: the search, by number.
        attempts: every dispatch of a trial or confirmation run.
        confirmations: runs on fresh seeds.
    """

    trials: Sequence[TrialRecord] = ()
    attempts: Sequence[AttemptRecord] = ()
    confirmations: Sequence[ConfirmationRecord] = ()


class StudyFile:
    """The tables of a study that another process may be writing.

    They are read from a copy elsewhere: to open an SQLite file with a write-ahead log, even for reading, makes files
    beside it and takes locks that its writer has to wait for.

    Attributes:
        problem: why the study could not be read; None if it could, or if there is none.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stamps: tuple[Stamp, Stamp] = (None, None)
        self._tables = Tables()
        self.problem: str | None = None

    def read(self) -> Tables:
        """The tables as they are now; those of last time while the file changes faster than it can be copied."""
        now = self._now()
        if now == self._stamps:
            return self._tables
        if now[0] is None:
            self._stamps, self._tables, self.problem = now, Tables(), None
            return self._tables
        with tempfile.TemporaryDirectory(prefix="codesign-watch-") as folder:
            copy = Path(folder) / self._path.name
            try:
                shutil.copyfile(self._path, copy)
                if now[1] is not None:
                    shutil.copyfile(write_ahead_log(self._path), copy.with_name(f"{copy.name}-wal"))
                if self._now() != now:  # main file and log may be of different moments
                    return self._tables
                with open_study(copy) as study:
                    self._tables = Tables(study.trials(), study.attempts(), study.confirmations())
                self.problem = None
            except OSError:
                return self._tables
            except StudyError as error:
                created = "interrupted while being created" in str(error)
                self.problem = None if created else str(error).replace(str(copy), str(self._path))
            self._stamps = now
        return self._tables

    def _now(self) -> tuple[Stamp, Stamp]:
        return stamp(self._path), stamp(write_ahead_log(self._path))


def write_ahead_log(study: Path) -> Path:
    """Where SQLite keeps what is not in the file of a study yet: beside the file itself, not beside a link to it."""
    real = study.resolve()
    return real.with_name(f"{real.name}-wal")


def last_lines(path: Path, count: int) -> Sequence[str]:
    """The last lines of a text file; none if it is missing."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - _TAIL))
            lines = file.read().decode("utf-8", errors="replace").splitlines()
    except OSError:
        return ()
    return tuple(lines[1 if size > _TAIL else 0 :][-count:])
