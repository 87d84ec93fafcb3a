"""One coordinator per study: a lock that the operating system frees when its holder dies."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from codesign_bo.errors import StudyError

# POSIX record locks belong to the process, so a second study object in it must be refused by hand. They
# are not passed on to forked workers, which may therefore outlive a killed coordinator.
_held: set[tuple[int, Path]] = set()


class StudyLock:
    """Exclusive lock on the file `<study>.lock`, held until `release` or the end of the process.

    Args:
        study: Path of the study file.

    Raises:
        StudyError: Another coordinator holds the study.
    """

    def __init__(self, study: Path) -> None:
        real = study.resolve()  # links to one study share its lock
        self._path = real.with_name(real.name + ".lock")
        self._key = (os.getpid(), self._path)
        if self._key in _held:
            raise StudyError(f"{study} is already open for writing in this process; close that Study first")
        self._fd = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(self._fd)
        except OSError as error:
            holder = os.pread(self._fd, 64, 0).decode(errors="replace").strip() if os.name == "posix" else ""
            os.close(self._fd)
            raise StudyError(
                f"{study} is in use by another coordinator ({holder or 'process unknown'}); "
                "a study has one writer: wait until it ends, or stop it"
            ) from error
        _held.add(self._key)
        try:
            os.ftruncate(self._fd, 0)
            os.write(self._fd, f"process {os.getpid()}\n".encode())
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        """Free the lock. The file stays, because deleting it would race with the next coordinator."""
        if self._key in _held:
            _held.discard(self._key)
            os.close(self._fd)


if sys.platform == "win32":
    import msvcrt

    def _lock(fd: int) -> None:
        msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(fd: int) -> None:
        fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
