"""A whole study as one JSON document, for archives, other tools and other versions."""

# pyright: reportArgumentType=false
# designs are numbers here until records hold integers and categories too
from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from codesign_bo.errors import StudyError
from codesign_bo.header import Header
from codesign_bo.interfaces import EvalResult
from codesign_bo.records import Proposal
from codesign_bo.space import BoxSpace
from codesign_bo.storage import SCHEMA_VERSION, Storage
from codesign_bo.view import StudyView

FORMAT = "codesign_bo study"


def export_study(study: StudyView, path: Path | str) -> None:
    """Write a study to a JSON file, all of it or nothing.

    Raises:
        StudyError: The file cannot be written.
    """
    document = {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "space": study.space.signature(),
        "seed": study.seed,
        "n_init": study.n_init,
        "maximize": study.maximize,
        "trials": [
            {
                "trial": t.trial,
                "params": dict(t.params),
                "seed": t.seed,
                "origin": t.origin,
                "attempts": t.attempts,
                "result": _result_out(t.result),
            }
            for t in study.trials()
        ],
        "queue": [{"params": dict(q.params), "trial": q.trial} for q in study.queue()],
        "screening": [{"params": dict(s.params), "value": s.value} for s in study.screening()],
        "confirmations": [
            {"trial": c.trial, "repeat": c.repeat, "seed": c.seed, "result": _result_out(c.result)}
            for c in study.confirmations()
        ],
    }
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, suffix=".tmp") as file:
            json.dump(document, file, indent=1, allow_nan=False)
            file.flush()
            os.fsync(file.fileno())
        os.replace(file.name, path)
    except OSError as error:
        raise StudyError(f"cannot write {path} ({error}); the study itself is untouched") from error


def import_study(source: Path | str, path: Path | str) -> None:
    """Make a study file from a JSON file of `export_study`.

    Raises:
        StudyError: `path` exists, or `source` is missing or no export of this version.
    """
    source, path = Path(source), Path(path)
    if path.exists():
        raise StudyError(f"{path} exists; import into a new file")
    try:
        document: dict[str, Any] = json.loads(source.read_text())
        if document["format"] != FORMAT or document["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"format {document['format']!r}, schema version {document['schema_version']}")
        space = BoxSpace.from_signature(document["space"])
        header = Header(space.signature(), document["seed"], document["n_init"], document["maximize"])
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".import") as folder:
            storage = Storage(Path(folder) / path.name)
            try:
                storage.bind(header)
                _fill(storage, space, document)
            finally:
                storage.close()
            os.replace(storage.path, path)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise StudyError(
            f"cannot import {source} ({type(error).__name__}: {error}); "
            f"it must be a file written by `codesign_bo export`, schema version {SCHEMA_VERSION}"
        ) from error


def _fill(storage: Storage, space: BoxSpace, document: dict[str, Any]) -> None:
    storage.enqueue([space.check(q["params"]) for q in document["queue"]])
    for entry in document["trials"]:
        proposal = Proposal(space.check(entry["params"]), entry["origin"])
        storage.add_trial(entry["trial"], proposal, entry["seed"])
        for _ in range(entry["attempts"] - 1):
            storage.add_attempt(entry["trial"])
        if entry["result"] is not None:
            storage.finish(entry["trial"], _result_in(entry["result"]))
    screening = document["screening"]
    storage.add_screening([space.check(s["params"]) for s in screening], [s["value"] for s in screening])
    for entry in document["confirmations"]:
        storage.add_confirmation(entry["trial"], entry["repeat"], entry["seed"])
        if entry["result"] is not None:
            storage.finish_confirmation(entry["trial"], entry["repeat"], _result_in(entry["result"]))


def _result_out(result: EvalResult | None) -> object:
    return None if result is None else json.loads(result.to_json())


def _result_in(value: object) -> EvalResult:
    return EvalResult.from_json(json.dumps(value))
