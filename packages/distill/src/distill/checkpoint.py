"""Checkpoints: written whole or not at all, read without running code."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar

import torch
from torch import nn

from distill.errors import CheckpointError, InterfaceError

FORMAT = 2

Kind: TypeAlias = Literal["blind", "seeing"]
"""Of a student."""

Network = TypeVar("Network", bound=nn.Module)


def save(path: Path, payload: Mapping[str, object]) -> None:
    """Write `payload` (tensors and plain Python values) to `path` atomically.

    Raises:
        CheckpointError: the disk is full or the folder cannot be written to; a file that was there stays.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") as file:
            torch.save({"format": FORMAT, **payload}, file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # torch reports a full disk as a RuntimeError
        raise CheckpointError(f"{path}: cannot be written ({error}); free the disk and start again") from error
    finally:
        temporary.unlink(missing_ok=True)


def load(path: Path) -> dict[str, object]:
    """Read a checkpoint into CPU memory.

    Raises:
        CheckpointError: the file is missing, truncated, of another kind or of a newer format.
    """
    try:
        payload = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise CheckpointError(f"{path}: no such checkpoint") from None
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(
            f"{path}: not a readable checkpoint ({reason}); delete it to start again, or restore a copy"
        ) from error
    if not isinstance(payload, dict) or payload.get("format") != FORMAT:
        found = payload.get("format") if isinstance(payload, dict) else type(payload).__name__
        raise CheckpointError(f"{path}: checkpoint format {found}; this version of distill reads format {FORMAT}")
    return payload


def table(value: object) -> dict[str, Any]:
    """A part of a checkpoint that must be a table.

    Raises:
        TypeError: it is something else.
    """
    if not isinstance(value, dict):
        raise TypeError(f"expected a table, found {type(value).__name__}")
    return value


def student_payload(kind: Kind, student: nn.Module, made_with: Mapping[str, object]) -> dict[str, object]:
    """A student as part of a checkpoint: its weights, and all else that `rebuild_student` needs to make it anew."""
    return {"student": {"kind": kind, **made_with, "weights": student.state_dict()}}


def student_kind(path: Path) -> Kind:
    """Whether the student in `student.pt` or `checkpoint.pt` sees.

    Raises:
        CheckpointError: the file is unreadable, or holds no student.
    """
    student = load(path).get("student")
    kind = student.get("kind") if isinstance(student, dict) else None
    if kind not in ("blind", "seeing"):
        raise CheckpointError(f"{path}: holds no student")
    return kind


def rebuild_student(
    path: Path, kind: Kind, make: Callable[[Mapping[str, Any]], Network], device: torch.device | str
) -> Network:
    """Read the student in `student.pt` or `checkpoint.pt`.

    Args:
        path: the file.
        kind: of the student.
        make: the untrained network, from what `student_payload` was told that it is made with.
        device: where it shall live.

    Raises:
        CheckpointError: the file is unreadable, or holds a student of another kind or another teacher.
    """
    if (found := student_kind(path)) != kind:
        raise CheckpointError(f"{path}: holds a {found} student, not a {kind} one")
    content = table(load(path)["student"])
    try:
        student = make(content)
        student.load_state_dict(table(content["weights"]))
    except (InterfaceError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path}: this student was trained with another teacher: {error}") from error
    return student.to(device).eval()
