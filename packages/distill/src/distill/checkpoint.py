"""Checkpoints: written whole or not at all, read without running code."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from distill.errors import CheckpointError
from distill.interfaces import Teacher
from distill.student import Student, StudentConfig, build_student

FORMAT = 1


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


def student_payload(student: Student) -> dict[str, object]:
    """Weights and architecture of a student."""
    return {
        "proprio": student.proprio,
        "architecture": asdict(student.config),
        "student": student.state_dict(),
    }


def load_student(path: Path, teacher: Teacher, device: torch.device | str = "cpu") -> Student:
    """Rebuild a trained student from `student.pt` or `checkpoint.pt`.

    Args:
        path: the file.
        teacher: the teacher that it was trained with; it gives the shape of the backbone.
        device: where the student shall live.

    Raises:
        CheckpointError: the file is unreadable, or the student belongs to another teacher.
    """
    payload = load(path)
    proprio, architecture, weights = (payload.get(key) for key in ("proprio", "architecture", "student"))
    if not isinstance(proprio, int) or not isinstance(architecture, dict) or not isinstance(weights, dict):
        raise CheckpointError(f"{path}: holds no student")
    try:
        student = build_student(proprio, teacher, StudentConfig(**architecture), device)
        student.load_state_dict(weights)
    except (RuntimeError, TypeError) as error:
        raise CheckpointError(f"{path}: this student was trained with another teacher: {error}") from error
    return student.eval()
