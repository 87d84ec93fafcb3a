"""A growing file with a reserve beside it, so that a full disk does not cut a run's log in the middle."""

from __future__ import annotations

import errno
import os
from pathlib import Path

RESERVE_BYTES = 8 * 2**20
"""Room for the last seconds of a run and the index of about two hours."""

RESERVE_SUFFIX = ".reserve"

FULL = (errno.ENOSPC, errno.EDQUOT)


class ReservedFile:
    """An append-only binary file; every write reaches the operating system at once.

    A second file of `reserve_bytes` stands beside it. The first write that the disk refuses for want of space
    deletes that file, takes its room and sets `full`: whoever writes should come to an end soon.
    """

    def __init__(self, path: Path, reserve_bytes: int = RESERVE_BYTES) -> None:
        """Create the file and its reserve.

        Args:
            path: Where; an existing file is replaced.
            reserve_bytes: Room to hold back; none at 0.

        Raises:
            OSError: The disk refuses, or has no room for the reserve.
        """
        self.full = False
        self._size = 0
        self._reserve = path.with_name(path.name + RESERVE_SUFFIX)
        self._file = path.open("wb", buffering=0)
        try:
            # Random bytes: a filesystem that compresses would keep no room for zeros.
            self._reserve.write_bytes(os.urandom(reserve_bytes))
        except OSError:
            self.close()
            path.unlink()
            raise

    def write(self, data: bytes) -> int:
        """Append `data`, from the reserve if need be.

        Raises:
            OSError: The disk refuses for another reason, or the reserve is used up.
        """
        rest = memoryview(data)
        while rest:
            try:
                written = self._file.write(rest)
            except OSError as error:
                if error.errno not in FULL or self.full:
                    raise
                self.full = True
                self._reserve.unlink(missing_ok=True)
                continue
            self._size += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self._size

    def flush(self) -> None:
        """Nothing is held back here."""

    def cut(self, size: int) -> None:
        """Drop everything after the first `size` bytes."""
        self._file.truncate(size)
        self._file.seek(size)
        self._size = size

    def close(self) -> None:
        """Push the bytes to the device, close the file and give up the reserve. Safe to call twice."""
        try:
            if not self._file.closed:
                os.fsync(self._file.fileno())
        finally:
            self._file.close()
            self._reserve.unlink(missing_ok=True)
