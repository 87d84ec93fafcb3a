import os
import re
import resource
import sqlite3
from functools import partial
from pathlib import Path

import pytest
from codesign_bo import EvalResult, Study, StudyError, open_study
from codesign_bo.storage import Storage
from codesign_bo.storage.filesystem import refuse_network


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
        db.execute("UPDATE evaluations SET result='{\"sem\": 3}' WHERE trial=1")
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


def test_a_link_to_a_study_is_the_same_study(space, finished, tmp_path):
    link = tmp_path / "links" / "other.sqlite"
    link.parent.mkdir()
    link.symlink_to(finished)
    with Study(space, finished, seed=1):
        assert "in use by another coordinator" in opened_by_another_process(link)
        with pytest.raises(StudyError, match="already open for writing"):
            Study(space, link, seed=1)
    with Study(space, link, seed=1) as study:
        assert len(study.trials()) == 3


@pytest.mark.parametrize("damage", ["cut", "garbage"])
def test_a_torn_journal_costs_no_more_than_what_it_held(space, bowl, tmp_path, damage):
    """As after a power cut: of the last steps some are missing, and the study repeats just these."""
    path = tmp_path / "study.sqlite"
    with Study(space, path, seed=1, n_init=100) as study:
        study.run(bowl, until=4)
        files = {name: (tmp_path / name).read_bytes() for name in ("study.sqlite", "study.sqlite-wal")}
        whole = study.run(bowl, until=5)
    journal = files["study.sqlite-wal"]
    known = []
    for keep in range(0, len(journal), len(journal) // 12):
        copy = tmp_path / f"{keep}" / "study.sqlite"
        copy.parent.mkdir()
        rest = b"" if damage == "cut" else bytes(byte ^ 0x5A for byte in journal[keep:])
        copy.write_bytes(files["study.sqlite"])
        copy.with_name("study.sqlite-wal").write_bytes(journal[:keep] + rest)
        with Study(space, copy, seed=1, n_init=100) as study:
            trials = study.trials()
            for t, w in zip(trials, whole, strict=False):
                assert (t.params, t.seed) == (w.params, w.seed)
                assert t.result in (None, w.result)
            known.append(sum(t.ok for t in trials))
            assert study.run(bowl, until=5) == whole
    assert known == sorted(known)
    assert (known[0], known[-1]) in ((0, 3), (0, 4))


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


MOUNTS = """\
/dev/sda1 / ext4 rw 0 0
server:/home /home nfs4 rw,vers=4.2 0 0
/dev/sdb1 /home/local ext4 rw 0 0
lustre@tcp:/scratch /scratch\\040space lustre rw 0 0
auto /net autofs rw 0 0
server:/x /net nfs rw 0 0
user@host:/data /mnt/ssh fuse.sshfs rw 0 0
tmpfs /tmp tmpfs rw 0 0
"""


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/home/me/study.sqlite", "nfs4 at /home"),
        ("/scratch space/new/study.sqlite", "lustre at /scratch space"),
        ("/net/study.sqlite", "nfs at /net"),
        ("/mnt/ssh/study.sqlite", "fuse.sshfs at /mnt/ssh"),
        ("/home/local/me/study.sqlite", None),
        ("/homes/study.sqlite", None),
        ("/tmp/study.sqlite", None),
        ("/study.sqlite", None),
    ],
)
def test_network_file_systems_are_told_from_local_ones(tmp_path, path, kind):
    mounts = tmp_path / "mounts"
    mounts.write_text(MOUNTS)
    if kind is None:
        refuse_network(Path(path), mounts)
        return
    with pytest.raises(StudyError, match=re.escape(f"({kind})")):
        refuse_network(Path(path), mounts)


def test_a_study_on_a_network_file_system_is_refused_unless_allowed(space, tmp_path, monkeypatch):
    mounts = tmp_path / "mounts"
    mounts.write_text(f"server:/x {tmp_path / 'share'} nfs4 rw 0 0\n")
    check = partial(refuse_network, mounts=mounts)
    monkeypatch.setattr("codesign_bo.storage.database.refuse_network", check)
    path = tmp_path / "share" / "study.sqlite"
    with pytest.raises(StudyError, match=r"nfs4 .* put the study on a local disk .* allow_network=True"):
        Study(space, path)
    assert not path.parent.exists()
    Study(space, path, allow_network=True).close()
    with open_study(path) as view:  # reading is always allowed
        assert view.trials() == []
    with Study(space, tmp_path / "study.sqlite"):
        pass


def test_opening_without_the_predicate_is_noted(space, tmp_path, caplog):
    def short(designs):
        return designs[:, 0] < 1.2

    Study(space, tmp_path / "s.sqlite", feasible=short).close()
    Study(space, tmp_path / "s.sqlite", feasible=short).close()
    assert caplog.text == ""
    Study(space, tmp_path / "s.sqlite").close()
    assert "short; now designs go unchecked" in caplog.text


def test_a_write_that_fails_in_the_database_loses_nothing(space, bowl, finished):
    with Study(space, finished, seed=1) as study:
        (request,) = study.ask()
        result = EvalResult(1.0, extras={f"x{i}": 0.1 * i for i in range(3000)})
        study._storage._db.execute("PRAGMA max_page_count=1")  # no page more than there are: SQLITE_FULL
        with pytest.raises(StudyError, match=r"database or disk is full; all committed before is safe"):
            study.tell(request.trial, result, request.token)
        with pytest.raises(StudyError, match="disk is full"):
            study.run(lambda r: result, until=5)
        assert [t.status for t in study.trials()][:4] == ["ok"] * 3 + ["unfinished"]
        study._storage._db.execute("PRAGMA max_page_count=100000")
        assert study.tell(request.trial, result, request.token) == "counted"
    with open_study(finished) as view:
        assert view.trials()[3].result == result


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
