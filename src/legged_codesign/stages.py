"""Stages of a run: each is skipped when its inputs have not changed, and redone when they have."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from rich.console import Console

from legged_codesign.run_log import PROGRESS, Progress

_NO_ROOM = 1 << 20
"""Free bytes under which a disk counts as full: libraries hide the number of an error that tells."""


class RunError(RuntimeError):
    """A run cannot start or go on; the message says why and what to do."""


@dataclass(frozen=True)
class Stage:
    """One step of a run.

    Attributes:
        name: of the stage.
        settings: the part of the configuration that it depends on, as JSON data.
        inputs: files that it reads.
        outputs: files that it leaves behind, each written atomically.
        work: does it; may be interrupted anywhere and goes on from what it left on disk.
    """

    name: str
    settings: Mapping[str, Any]
    inputs: Sequence[Path]
    outputs: Sequence[Path]
    work: Callable[[], None]


def run_stages(
    folder: Path, stages: Sequence[Stage], console: Console, count: int | None = None, done: int = 0
) -> None:
    """Do the stages in order, skipping those whose fingerprint on record is the present one.

    Args:
        folder: of the run.
        stages: what to do.
        console: where to print.
        count: stages of the whole run, of which these are a part; by default these are all.
        done: stages before these.
    """
    for number, stage in enumerate(stages, start=done + 1):
        title = f"[bold]{number}/{count or len(stages)} {stage.name}[/bold]"
        marker = folder / "stages" / f"{stage.name}.json"
        mark = _fingerprint(stage)
        if all(output.exists() for output in stage.outputs) and _read_mark(marker) == mark:
            console.print(f"{title} unchanged, skipped")
            continue
        console.print(title)
        progress = folder / "stages" / PROGRESS
        write_text(progress, Progress.begin(stage.name).to_json())
        started = time.monotonic()
        stage.work()
        seconds = time.monotonic() - started
        missing = [str(output) for output in stage.outputs if not output.exists()]
        if missing:
            raise RunError(f"stage '{stage.name}' did not write {', '.join(missing)}")
        write_text(marker, json.dumps({"fingerprint": mark}) + "\n")
        with (folder / "metrics.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"stage": stage.name, "seconds": round(seconds, 1)}) + "\n")
        progress.unlink(missing_ok=True)
        console.print(f"  done in {seconds:.0f} s", highlight=False)


def forget(folder: Path, *stages: str) -> None:
    """Have stages done again, with what they left on disk."""
    for name in stages:
        (folder / "stages" / f"{name}.json").unlink(missing_ok=True)


def _fingerprint(stage: Stage) -> str:
    digest = hashlib.sha256(json.dumps([stage.name, stage.settings], sort_keys=True).encode())
    for path in stage.inputs:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _read_mark(path: Path) -> str | None:
    try:
        return json.loads(path.read_text(encoding="utf-8"))["fingerprint"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_text(path: Path, text: str) -> None:
    """Write a text file so that it is either complete or absent."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that it is either complete or absent."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        Path(temporary).unlink(missing_ok=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a run folder for this process alone; the lock goes with the process, even a killed one.

    Raises:
        RunError: the folder cannot be written to, or another run holds it; or its disk became full meanwhile.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / ".lock").open("w")
    except OSError as error:
        raise RunError(f"cannot write to the run folder {folder}: {error}; choose another with --folder") from error
    with file:
        try:
            _lock(file)
        except OSError as error:
            raise RunError(f"another run is using {folder}; wait for it or choose another --folder") from error
        try:
            yield
        except Exception as error:
            if _is_full(folder, error):
                raise RunError(
                    f"the disk of {folder} is full: make room, and the same command goes on ({error})"
                ) from error
            raise


def _is_full(folder: Path, error: BaseException) -> bool:
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        cause = cause.__cause__ or cause.__context__
    return shutil.disk_usage(folder).free < _NO_ROOM


def _lock(file: IO[str], patience: float = 0.5) -> None:
    """Lock a file; who only asks whether it is locked holds it for microseconds, so try again before giving up."""
    end = time.monotonic() + patience
    while True:
        try:
            return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > end:
                raise
        time.sleep(0.05)


def in_use(folder: Path) -> bool:
    """Whether a process holds a run folder now; asks without writing anything."""
    try:
        with (folder / ".lock").open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # no lock, or none that we may see
        return False
    return False
