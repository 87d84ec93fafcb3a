"""A whole study as one JSON document, for archives, other tools and other versions."""

from __future__ import annotations

import hashlib
import json
import operator
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from codesign_bo.errors import StudyError
from codesign_bo.header import Header
from codesign_bo.interfaces import EvalResult
from codesign_bo.records import AttemptRecord, Basis
from codesign_bo.space import BoxSpace
from codesign_bo.storage import SCHEMA_VERSION, SEARCH, Storage
from codesign_bo.storage.migrate import OLDEST, result_from_1
from codesign_bo.view import StudyView

FORMAT = "codesign_bo study"
Rows = dict[str, list[dict[str, Any]]]


def export_study(study: StudyView, path: Path | str) -> None:
    """Write a study to a JSON file, all of it or nothing.

    Raises:
        StudyError: The file cannot be written.
    """
    path = Path(path)
    document = _document(study)
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
    """Make a study file from a JSON file of `export_study`, also of an older version.

    Raises:
        StudyError: `path` exists, or `source` is missing or no export of a known version.
    """
    source, path = Path(source), Path(path)
    for there in (path, path.with_name(f"{path.name}-wal")):  # a journal would be played back into the new file
        if there.exists():
            raise StudyError(f"{there} exists; import into a new file, or move it away")
    try:
        document: dict[str, Any] = json.loads(source.read_text())
        version = document["schema_version"]
        if document["format"] != FORMAT or version not in range(OLDEST, SCHEMA_VERSION + 1):
            raise ValueError(f"format {document['format']!r}, schema version {version}")
        if version == 1:
            document = _from_1(document)
        space = BoxSpace.from_signature(document["space"])
        settings = (document[key] for key in ("seed", "n_init", "maximize", "objectives"))
        header = Header(space.signature(), *settings)
        rows = _rows(space, document)
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".import") as folder:
            storage = Storage(Path(folder) / path.name, allow_network=True)
            try:
                storage.bind(header)
                storage.fill(document["id"], rows)
                if document["predicate"] is not None:
                    storage.set_predicate(document["predicate"])
            finally:
                storage.close()
            os.replace(storage.path, path)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, StudyError) as error:
        raise StudyError(
            f"cannot import {source} ({type(error).__name__}: {error}); "
            f"it must be a file written by `codesign_bo export`, schema version {OLDEST} to {SCHEMA_VERSION}"
        ) from error


# --- writing --------------------------------------------------------------------------------------------


def _document(study: StudyView) -> dict[str, Any]:
    attempts: dict[tuple[int, int | None], list[dict[str, Any]]] = {}
    for a in study.attempts():
        attempts.setdefault((a.trial, a.repeat), []).append(_attempt_out(a))
    return {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "id": study.identity,
        "space": study.space.signature(),
        "seed": study.seed,
        "n_init": study.n_init,
        "maximize": study.maximize,
        "objectives": study.objectives,
        "predicate": study.predicate,
        "trials": [
            {
                "trial": t.trial,
                "params": dict(t.params),
                "seed": t.seed,
                "origin": t.origin,
                "fidelity": t.fidelity,
                "basis": None if t.basis is None else asdict(t.basis),
                "result": _result_out(t.result),
                "attempts": attempts.get((t.trial, None), []),
            }
            for t in study.trials()
        ],
        "queue": [{"params": dict(q.params), "trial": q.trial} for q in study.queue()],
        "screening": [{"params": dict(s.params), "value": s.value, "sem": s.sem} for s in study.screening()],
        "confirmations": [
            {
                "trial": c.trial,
                "repeat": c.repeat,
                "seed": c.seed,
                "result": _result_out(c.result),
                "attempts": attempts.get((c.trial, c.repeat), []),
            }
            for c in study.confirmations()
        ],
        "history": [
            {"source": h.source, "trial": h.trial, "params": dict(h.params), "result": _result_out(h.result)}
            for h in study.history()
        ],
    }


def _attempt_out(attempt: AttemptRecord) -> dict[str, Any]:
    fields = {**vars(attempt), "result": _result_out(attempt.result)}
    return {key: value for key, value in fields.items() if key not in ("trial", "repeat")}


def _result_out(result: EvalResult | None) -> Any:
    return None if result is None else json.loads(result.to_json())


# --- reading --------------------------------------------------------------------------------------------


def _rows(space: BoxSpace, document: dict[str, Any]) -> Rows:
    """Return the rows of all tables, checked."""
    rows: Rows = {"trials": [], "evaluations": [], "attempts": [], "queue": [], "screening": [], "history": []}

    def params(entry: dict[str, Any]) -> str:
        return json.dumps(space.check(entry["params"]))

    def evaluation(entry: dict[str, Any], repeat: int) -> None:
        key = {"trial": entry["trial"], "repeat": repeat}
        rows["evaluations"].append(
            {**key, "seed": operator.index(entry["seed"]), "result": _result_in(entry["result"])}
        )
        for attempt in entry["attempts"]:
            known = AttemptRecord(**key, **attempt)  # refuses unknown and missing keys
            rows["attempts"].append({**vars(known), "result": _result_in(attempt["result"])})

    if [t["trial"] for t in document["trials"]] != list(range(len(document["trials"]))):
        raise ValueError("the trials are not numbered 0, 1, 2, ...")
    for t in document["trials"]:
        basis = None if t["basis"] is None else json.dumps(asdict(Basis(**t["basis"])))
        row = {"trial": t["trial"], "params": params(t), "origin": t["origin"], "fidelity": float(t["fidelity"])}
        rows["trials"].append({**row, "basis": basis})
        evaluation(t, SEARCH)
    for c in document["confirmations"]:
        evaluation(c, c["repeat"])
    rows["queue"] = [{"params": params(q), "trial": q["trial"]} for q in document["queue"]]
    rows["screening"] = [{"params": params(s), "value": s["value"], "sem": s["sem"]} for s in document["screening"]]
    rows["history"] = [
        {"source": h["source"], "trial": h["trial"], "params": params(h), "result": _result_in(h["result"])}
        for h in document["history"]
    ]
    return rows


def _result_in(value: object) -> str | None:
    return None if value is None else EvalResult.from_json(json.dumps(value)).to_json()


def _from_1(document: dict[str, Any]) -> dict[str, Any]:
    """Version 1 had numbers of attempts only, for trials, and none of what came later."""

    def told(entry: dict[str, Any]) -> dict[str, Any]:
        return {**entry, "result": None if entry["result"] is None else result_from_1(entry["result"])}

    def attempts(entry: dict[str, Any], repeat: int, number: int) -> list[dict[str, Any]]:
        blank = dict.fromkeys(("started", "ended", "seconds", "deadline", "result"))
        made = [
            {
                **blank,
                "token": f"v1-{entry['trial']}-{repeat}-{attempt}",
                "attempt": attempt,
                "status": "interrupted",
                "message": "",
                "final": False,
                "closed": False,
            }
            for attempt in range(1, number + 1)
        ]
        result = entry["result"]
        if made and result is not None:
            outcome = {"status": result["status"], "message": result["message"], "result": result, "final": True}
            made[-1].update(outcome)
            made = [{**attempt, "closed": True} for attempt in made]
        return made

    new = {"fidelity": 1.0, "basis": None}
    trials = [{**t, **new, "attempts": attempts(t, SEARCH, t["attempts"])} for t in map(told, document["trials"])]
    confirmations = [{**c, "attempts": attempts(c, c["repeat"], 1)} for c in map(told, document["confirmations"])]
    screening = [{**s, "sem": None} for s in document["screening"]]
    identity = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:32]
    return {
        **document,
        "id": identity,
        "objectives": {},
        "predicate": None,
        "trials": trials,
        "confirmations": confirmations,
        "screening": screening,
        "history": [],
    }
