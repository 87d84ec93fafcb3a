import os
import resource
import sqlite3
from pathlib import Path

import pytest
from codesign_bo import EvalResult, Study, StudyError, open_study
from codesign_bo.storage import Storage


@pytest.fixture
def finished(space, bowl, tmp_path) -> Path:
    """A closed study of three trials."""
    path = tmp_path / "study.sqlite"
    with Study(space, path, seed=1) as study:
        study.run(bowl, until=3)
    return path


def test_garbage_is_named_and_left_as_it_is(space, tmp_path):
    path = tmp_path / "study.sqlite"
    for content in (b"garbage" * 400, b"not a database", os.urandom(8192)):
        path.write_bytes(content)
        with pytest.raises(StudyError, match=r"study\.sqlite is damaged.*restore.*move it away"):
            Study(space, path)
        assert path.read_bytes() == content


@pytest.mark.parametrize("keep", [0.9, 0.6, 0.3, 0.05])
def test_a_torn_file_is_named_and_left_as_it_is(space, finished, keep):
    content = finished.read_bytes()
    torn = content[: int(keep * len(content))]
    finished.write_bytes(torn)
    with pytest.raises(StudyError, match=r"study\.sqlite is damaged"):
        Study(space, finished, seed=1)
    assert finished.read_bytes() == torn
    with pytest.raises(StudyError, match="is damaged"):
        open_study(finished)
    finished.write_bytes(content)
    with Study(space, finished, seed=1) as study:
        assert len(study.trials()) == 3


def test_a_record_that_is_no_result_is_named(space, finished):
    with sqlite3.connect(finished) as db:
        db.execute("UPDATE trials SET result='{\"sem\": 3}' WHERE trial=1")
    db.close()
    with Study(space, finished, seed=1) as study, pytest.raises(StudyError, match="is damaged"):
        study.trials()


def test_other_databases_and_other_versions_are_refused(space, finished, tmp_path):
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as db:
        db.execute("CREATE TABLE cats (name TEXT)")
    db.close()
    with pytest.raises(StudyError, match="no study"):
        Study(space, other)
    with sqlite3.connect(finished) as db:
        db.execute("UPDATE meta SET value='99' WHERE key='schema_version'")
    db.close()
    with pytest.raises(StudyError, match="schema version 99"):
        Study(space, finished, seed=1)


def opened_by_another_process(path: Path) -> str:
    """Open the study for writing in a forked process; return the error in words, or nothing."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            Storage(path).close()
        except StudyError as error:
            os.write(write, str(error).encode())
        os._exit(0)
    os.waitpid(pid, 0)
    os.close(write)
    with os.fdopen(read) as pipe:
        return pipe.read()


def test_a_second_coordinator_is_refused_while_readers_are_welcome(space, finished):
    with Study(space, finished, seed=1) as study:
        assert f"in use by another coordinator (process {os.getpid()})" in opened_by_another_process(finished)
        with pytest.raises(StudyError, match="already open for writing in this process"):
            Study(space, finished, seed=1)
        with open_study(finished) as view:
            study.ask()
            assert len(view.trials()) == 4  # a reader sees what a running study commits
    assert opened_by_another_process(finished) == ""


def test_a_reader_cannot_write(finished):
    storage = Storage(finished, read_only=True)
    with pytest.raises(StudyError, match="readonly"):
        storage.enqueue([{"thigh": 1.0}])
    storage.close()


def test_another_space_or_setting_is_refused_with_the_difference(space, finished):
    cases = {
        r"shank.high is 1.5 there, 1.2 here": (space.with_bounds({"shank": (0.5, 1.2)}), {}),
        r"thigh.fixed is False there, True here": (space.fix({"thigh": 1.0}), {}),
        r"seed is 1 there, 2 here": (space, {"seed": 2}),
        r"maximize is True there, False here": (space, {"maximize": False}),
        r"another order": (type(space)(space.parameters[::-1]), {}),
        r"tail is only here": (type(space).box(["thigh", "shank", "tail"], 0.6, 1.4, 1.0), {"n_init": 4}),
    }
    for words, (other, settings) in cases.items():
        with pytest.raises(StudyError, match=words):
            Study(other, finished, **{"seed": 1, **settings})


@pytest.mark.parametrize("path", ["/proc/study.sqlite", "/proc/new/study.sqlite"])
def test_a_folder_without_write_access_is_named(space, path):
    with pytest.raises(StudyError, match=rf"cannot open {path} for writing"):
        Study(space, path)


def test_a_missing_study_cannot_be_read(tmp_path):
    with pytest.raises(StudyError, match="there is no study"):
        open_study(tmp_path / "none.sqlite")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_loses_nothing(space, bowl, finished):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Study(space, finished, seed=1) as study:
        (request,) = study.ask()
        result = EvalResult(1.0, extras={f"x{i}": 0.1 * i for i in range(3000)})
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, limits[1]))
        try:
            with pytest.raises(StudyError, match="all committed before is safe"):
                study.tell(request.trial, result)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert [t.status for t in study.trials()] == ["ok"] * 3 + ["unfinished"]
        study.tell(request.trial, result)
    with open_study(finished) as view:
        assert view.trials()[3].result == result
