"""Checkpoints: one file, written atomically, read without executing anything in it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import torch

FORMAT = 1


class CheckpointError(RuntimeError):
    """A checkpoint cannot be read, or belongs to something else."""


def save(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content` (tensors and plain data) to `path`; a crash leaves the file that was there before.

    Raises:
        CheckpointError: the disk is full or the folder cannot be written to; the old file is untouched.
    """
    _replace(path, lambda file: torch.save({"format": FORMAT, **content}, file))


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` in the same all-or-nothing manner; raises as `save` does."""
    _replace(path, lambda file: file.write(text.encode()))


def _replace(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise CheckpointError(f"cannot write to {path.parent}: {error}; free space or choose another folder") from error
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise CheckpointError(
            f"cannot write {path}: {error}; the previous file is untouched: free the disk and start again"
        ) from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def load(path: Path) -> dict[str, Any]:
    """Read a checkpoint.

    Raises:
        CheckpointError: the file is missing, truncated, not a checkpoint, or of another format version.
    """
    if not path.is_file():
        raise CheckpointError(f"no checkpoint at {path}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise CheckpointError(
            f"{path} is not a readable checkpoint ({type(error).__name__}): it is truncated or another kind of file; "
            "restore a copy, or, if a run made it, delete it and start that run again"
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise CheckpointError(f"{path}: checkpoint format {found}, this version of locorl reads {FORMAT}")
    return content
