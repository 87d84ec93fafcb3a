"""Studies of earlier versions: opened in place after a copy, read without a change, imported; newer ones refused."""

import json
import logging
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from codesign_bo import BoxSpace, EvalResult, Study, StudyError, open_study
from codesign_bo.exchange import export_study, import_study
from codesign_bo.storage import SCHEMA_VERSION, Storage

DATA = Path(__file__).parent / "data"
SPACE = BoxSpace.box(["thigh", "shank", "track"], [0.6, 0.5, 0.2], [1.4, 1.5, 0.4], [1.0, 1.0, 0.31])
SPACE = SPACE.fix({"track": 0.31})


@pytest.fixture
def old(tmp_path) -> Path:
    """A study file of version 1."""
    path = tmp_path / "study.sqlite"
    with closing(sqlite3.connect(path)) as db:
        db.executescript((DATA / "study-v1.sql").read_text())
    return path


def check_content(view) -> None:
    """Compare with what the dump and its making say."""
    assert (view.space, view.seed, view.n_init, view.maximize, view.objectives) == (SPACE, 7, 5, True, {})
    trials = view.trials()
    assert [t.status for t in trials] == ["ok", "ok", "crash", "diverged", "ok", "ok", "unfinished"]
    assert [t.origin for t in trials] == ["nominal", "queued", "sobol", "sobol", "sobol", "surrogate", "surrogate"]
    assert [t.attempts for t in trials] == [1, 1, 1, 1, 1, 1, 2]
    assert trials[0].seed == 600562731
    assert trials[1].params == {"thigh": 1.3, "shank": 0.7, "track": 0.31}
    assert trials[1].result == EvalResult(
        0.9870348949034085, 0.021931056955186042, 4, {"energy": 2.0}, ((1.0, 0.1), (2.0, 0.5))
    )
    assert trials[2].result == EvalResult.failure("crash", "leg too long")
    assert trials[3].result == EvalResult.failure("diverged", "loss is nan", {"step": 12.0})
    assert [(dict(q.params)["thigh"], q.trial) for q in view.queue()] == [(1.3, 1), (0.9, None)]
    assert [(s.params["thigh"], s.value, s.sem) for s in view.screening()] == [(1.3, 0.9, None), (0.7, 0.2, None)]
    runs = view.confirmations()
    assert [(c.trial, c.repeat, c.seed) for c in runs] == [
        (0, 0, 428483640), (0, 1, 1016141897), (0, 2, 788713758), (1, 0, 428483640), (1, 1, 1016141897),
    ]  # fmt: skip
    assert [c.result.status if c.result else None for c in runs] == ["ok", "timeout", None, "ok", "ok"]
    outcomes = [(a.trial, a.attempt, a.status, a.final) for a in view.attempts() if a.repeat is None]
    assert outcomes[2:4] == [(2, 1, "crash", True), (3, 1, "diverged", True)]
    assert outcomes[6:] == [(6, 1, "interrupted", False), (6, 2, "interrupted", False)]
    assert not view.history()


def tables(path: Path) -> list[str]:
    with closing(sqlite3.connect(path)) as db:
        return list(db.iterdump())


def test_the_fixture_is_of_version_1(old):
    with closing(sqlite3.connect(old)) as db:
        assert db.execute("SELECT value FROM meta WHERE key='schema_version'").fetchone() == ("1",)
        with pytest.raises(sqlite3.OperationalError, match="evaluations"):
            db.execute("SELECT * FROM evaluations")


def test_opening_migrates_in_place_after_a_copy(old, caplog):
    before = tables(old)
    with caplog.at_level(logging.WARNING), Study(SPACE, old, seed=7, n_init=5) as study:
        check_content(study)
        identity = study.identity
    copy = old.with_name("study.sqlite.v1.bak")
    assert str(copy) in caplog.text
    assert tables(copy) == before
    with closing(sqlite3.connect(old)) as db:
        assert db.execute("SELECT value FROM meta WHERE key='schema_version'").fetchone() == (str(SCHEMA_VERSION),)
    copy.unlink()
    with Study(SPACE, old, seed=7, n_init=5) as study:  # once is enough
        check_content(study)
        assert study.identity == identity
    assert not copy.exists()
    assert len(identity) == 32


def test_a_migrated_study_goes_on(old, bowl):
    with Study(SPACE, old, seed=7, n_init=5) as study:
        (request,) = study.ask()
        assert (request.trial, request.attempt) == (6, 3)
        study.tell(6, bowl(request), request.token)
        assert study.tell(6, bowl(request), "v1-6--1-2") == "late"  # tokens of old attempts stay known
        assert study.ask()[0].params == {"thigh": 0.9, "shank": 0.9, "track": 0.31}
        assert study.retry_failed() == 3
        assert study.confirm(bowl, top_k=1, repeats=2).gains[0].repeats == 2


def test_the_kind_that_version_1_had_for_other_failures_is_a_crash(old, tmp_path):
    with closing(sqlite3.connect(old)) as db:
        for table, column in (("trials", "result"), ("confirmations", "result"), ("attempts", "status")):
            db.execute(f"UPDATE {table} SET {column} = replace({column}, 'timeout', 'failed')")
            db.execute(f"UPDATE {table} SET {column} = replace({column}, 'crash', 'failed')")
        db.commit()
    document = (DATA / "study-v1.json").read_text()
    (tmp_path / "old.json").write_text(document.replace('"crash"', '"failed"').replace('"timeout"', '"failed"'))
    import_study(tmp_path / "old.json", tmp_path / "imported.sqlite")
    for view in (open_study(old), open_study(tmp_path / "imported.sqlite")):
        with view:
            assert [t.status for t in view.trials()][2:4] == ["crash", "diverged"]
            assert view.trials()[2].result.message == "leg too long"
            assert [a.status for a in view.attempts() if a.trial == 2] == ["crash"]
            assert [c.result.status for c in view.confirmations() if c.result][1] == "crash"


def test_reading_changes_nothing(old):
    before = old.read_bytes()
    with open_study(old) as view:
        check_content(view)
        identity = view.identity
    assert old.read_bytes() == before
    assert [p.name for p in old.parent.iterdir()] == ["study.sqlite"]
    storage = Storage(old, read_only=True)
    with pytest.raises(StudyError, match="readonly"):
        storage.enqueue([SPACE.nominal])
    storage.close()
    with Study(SPACE, old, seed=7, n_init=5) as study:
        assert study.identity == identity


def test_an_old_export_is_read(tmp_path):
    import_study(DATA / "study-v1.json", tmp_path / "new.sqlite")
    with Study(SPACE, tmp_path / "new.sqlite", seed=7, n_init=5) as study:
        assert study.ask()[0].attempt == 3
    import_study(DATA / "study-v1.json", tmp_path / "newer.sqlite")
    with open_study(tmp_path / "newer.sqlite") as view:
        check_content(view)
        export_study(view, tmp_path / "new.json")
    assert json.loads((tmp_path / "new.json").read_text())["schema_version"] == SCHEMA_VERSION


def test_a_study_that_was_being_created_by_version_1_is_migrated_too(tmp_path):
    path = tmp_path / "study.sqlite"
    with closing(sqlite3.connect(path)) as db:
        schema = [s for s in (DATA / "study-v1.sql").read_text().split(";\n") if "CREATE TABLE" in s]
        db.executescript(";\n".join(schema) + "; INSERT INTO meta VALUES ('schema_version', '1')")
    with Study(SPACE, path, seed=7) as study:
        assert study.ask()[0].trial == 0


@pytest.mark.parametrize("version", ["3", "99", "0", "two"])
def test_other_versions_are_refused_with_a_way_out_and_left_alone(old, version):
    with closing(sqlite3.connect(old)) as db:
        db.execute("UPDATE meta SET value=? WHERE key='schema_version'", (version,))
        db.commit()
    before = old.read_bytes()
    for attempt in (lambda: Study(SPACE, old, seed=7, n_init=5), lambda: open_study(old)):
        with pytest.raises(StudyError, match=rf"schema version {version}, .* reads 1 to 2; install"):
            attempt()
    assert old.read_bytes() == before


KILLED = """
import os, signal, sys
from pathlib import Path
from codesign_bo.storage import database
name, path = sys.argv[1], Path(sys.argv[2])
original = getattr(database, name)
def killed(*args):
    if sys.argv[3] == "after": original(*args)
    os.kill(os.getpid(), signal.SIGKILL)
setattr(database, name, killed)
database.Database(path)
"""


@pytest.mark.parametrize(("where", "when"), [("back_up", "before"), ("back_up", "after"), ("migrate", "after")])
def test_kill_9_during_the_migration_leaves_the_old_study(old, where, when):
    before = tables(old)
    done = subprocess.run([sys.executable, "-c", KILLED, where, str(old), when])
    assert done.returncode == -signal.SIGKILL
    assert tables(old) == before
    with Study(SPACE, old, seed=7, n_init=5) as study:
        check_content(study)
    assert tables(old.with_name("study.sqlite.v1.bak")) == before


def test_two_coordinators_cannot_both_migrate(old):
    with Study(SPACE, old, seed=7, n_init=5), pytest.raises(StudyError, match="already open for writing"):
        Storage(old)
    copy = old.with_name("copy.sqlite")
    shutil.copy(old.with_name("study.sqlite.v1.bak"), copy)
    pid = os.fork()
    if pid == 0:
        Storage(copy)  # keeps the lock until it is killed
        os.kill(os.getpid(), signal.SIGSTOP)
        os._exit(0)
    os.waitpid(pid, os.WUNTRACED)
    try:
        with pytest.raises(StudyError, match=f"in use by another coordinator \\(process {pid}\\)"):
            Storage(copy)
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    with Study(SPACE, copy, seed=7, n_init=5) as study:
        check_content(study)
