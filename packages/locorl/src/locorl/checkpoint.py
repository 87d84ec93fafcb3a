"""Checkpoints: one file, written atomically, read without executing anything in it."""

from __future__ import annotations

import io
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import torch

FORMAT = 1
_HALF = ".tmp"


class CheckpointError(RuntimeError):
    """A checkpoint cannot be read, or belongs to something else."""


class UnreadableError(CheckpointError):
    """A checkpoint is truncated or damaged, or is another kind of file."""


def on_cpu(content: Any) -> Any:
    """The same nested mappings and sequences with all tensors on the CPU."""
    if isinstance(content, torch.Tensor):
        return content.cpu()
    if isinstance(content, Mapping):
        return {name: on_cpu(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return type(content)(on_cpu(value) for value in content)
    return content


def save(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content` (tensors and plain data) to `path`; a crash leaves the file that was there before.

    Raises:
        CheckpointError: disk or memory is full, or the folder cannot be written to; the old file is untouched.
    """
    _replace(path, lambda file: torch.save({"format": FORMAT, **on_cpu(content)}, file))


def save_next(path: Path, content: Mapping[str, Any]) -> None:
    """Write as `save` does, and keep the file that was there, if it is good, as `previous(path)`.

    Raises:
        CheckpointError: as `save`; both old files are untouched.
    """
    keep = path.exists() and _good(path)
    _replace(
        path, lambda file: torch.save({"format": FORMAT, **on_cpu(content)}, file), previous(path) if keep else None
    )


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` in the same all-or-nothing manner; raises as `save` does."""
    _replace(path, lambda file: file.write(text.encode()))


def previous(path: Path) -> Path:
    """Where `save_next` keeps the file before the newest: `checkpoint.previous.pt` beside `checkpoint.pt`."""
    return path.with_suffix(f".previous{path.suffix}")


def sweep(folder: Path) -> None:
    """Remove what writes that were killed have left in `folder`; nobody may be writing there."""
    for path in folder.glob(f".*{_HALF}"):
        path.unlink(missing_ok=True)


def _replace(path: Path, write: Callable[[IO[bytes]], object], keep: Path | None = None) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=_HALF)
    except OSError as error:
        raise CheckpointError(f"cannot write to {path.parent}: {error}; free space or choose another folder") from error
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        if keep is not None:
            os.replace(path, keep)
        os.replace(temporary, path)
    except (OSError, RuntimeError, MemoryError) as error:
        reason = str(error) or type(error).__name__
        raise CheckpointError(
            f"cannot write {path}: {reason}; the previous file is untouched: free the disk or memory and start again"
        ) from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def load(path: Path) -> dict[str, Any]:
    """Read a checkpoint.

    Raises:
        UnreadableError: the file is truncated, damaged, or not a checkpoint.
        CheckpointError: the file is missing, cannot be opened, or has another format version.
    """
    if not path.is_file():
        raise CheckpointError(f"no checkpoint at {path}")
    try:
        content = _read(io.BytesIO(path.read_bytes()))
    except (OSError, MemoryError) as error:  # the file itself may be good
        raise CheckpointError(f"cannot read {path}: {str(error) or type(error).__name__}") from error
    except Exception as error:
        raise UnreadableError(
            f"{path} is not a readable checkpoint ({type(error).__name__}): it is truncated or another kind of file; "
            "restore a copy, or, if a run made it, delete it and start that run again"
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise CheckpointError(f"{path}: checkpoint format {found}, this version of locorl reads {FORMAT}")
    return content


def _read(file: IO[bytes]) -> Any:
    with zipfile.ZipFile(file) as archive:
        damaged = archive.testzip()  # torch does not look at the checksums
    if damaged:
        raise ValueError(f"{damaged} has another checksum")
    file.seek(0)
    return torch.load(file, map_location="cpu", weights_only=True)


def load_newest(path: Path) -> tuple[dict[str, Any], str] | None:
    """The content of `path`, or of `previous(path)` if `path` is unreadable or was lost; None if there is neither.

    Returns:
        The content, and what to tell the user if it is not that of `path`, else an empty text.

    Raises:
        UnreadableError: there is no readable one.
        CheckpointError: as `load`.
    """
    fallback = previous(path)
    try:
        if path.exists():
            return load(path), ""
        problem = f"{path} is missing"
    except UnreadableError:
        if not fallback.exists():
            raise
        problem = f"{path} is not readable, as when a machine goes down while it writes"
    if not fallback.exists():
        return None
    return load(fallback), f"{problem}; going on from the checkpoint before it, {fallback.name}"


def _good(path: Path) -> bool:
    try:
        load(path)
    except UnreadableError:
        return False
    return True
