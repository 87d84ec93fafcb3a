"""The process of one evaluation under `LocalExecutor`, and the file in which its result comes back."""

from __future__ import annotations

import faulthandler
import os
import sys
import traceback
from pathlib import Path
from typing import TextIO

from codesign_bo.executors.evaluate import evaluate
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult

RESULT_NOT_WRITTEN = 74  # EX_IOERR of sysexits.h


def main(callback: Callback, request: EvalRequest, gpus: str | None, coordinator: int) -> None:
    """Evaluate in a session of this process's own and leave the result in the work folder.

    Args:
        callback: What evaluates.
        request: What is evaluated.
        gpus: Value of CUDA_VISIBLE_DEVICES, None to leave it.
        coordinator: Number of the process that started this one.
    """
    os.setsid()
    if os.getppid() != coordinator:
        os._exit(1)  # it died before there was a group to kill
    sys.stdout = _redirect(1, request.workdir / "stdout.txt")
    sys.stderr = _redirect(2, request.workdir / "stderr.txt")
    faulthandler.enable()
    if gpus is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = gpus
    asked, process = request.to_json(), os.getpid()
    path = result_path(request, request.attempt).absolute()  # the callback may change the folder it works in
    result = evaluate(callback, request)
    if os.getpid() != process:
        os._exit(0)  # the callback forked and both returned: one result is enough
    try:
        _write(path, f"{asked}\n{result}\n")
    except OSError:
        traceback.print_exc()
        os._exit(RESULT_NOT_WRITTEN)


def _redirect(descriptor: int, path: Path) -> TextIO:
    """Append what is written to a descriptor, also by C code and child processes, to a file."""
    with open(path, "ab") as file:
        os.dup2(file.fileno(), descriptor)
    # by line, because a killed process does not flush
    return os.fdopen(descriptor, "w", buffering=1, encoding="utf-8", errors="replace", closefd=False)


def result_path(request: EvalRequest, attempt: int) -> Path:
    """Return the file for the result of an attempt."""
    return request.workdir / f"result-{request.trial}-{attempt}.json"


def read_result(request: EvalRequest, attempt: int) -> EvalResult | None:
    """Return the result that an attempt at this evaluation left, or None.

    A file about another design, seed or fidelity is not this evaluation's.
    """
    try:
        asked, result = result_path(request, attempt).read_text(encoding="utf-8").splitlines()
        if _what(EvalRequest.from_json(asked)) != _what(EvalRequest.from_json(request.to_json())):
            return None
        return EvalResult.from_json(result)
    except (OSError, ValueError):
        return None


def _what(request: EvalRequest) -> tuple[object, ...]:
    return request.trial, request.params, request.seed, request.fidelity


def _write(path: Path, text: str) -> None:
    # under another name until it is whole and on disk
    part = path.with_suffix(".part")
    with open(part, "w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(part, path)
