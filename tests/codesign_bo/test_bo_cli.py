"""`codesign_bo resume`."""

import os
import signal
import subprocess
import sys
import time

import pytest
from codesign_bo import BoxSpace, EvalResult, Study, StudyError, open_study
from codesign_bo.cli import main

CALLBACK = """
import os
import time
from pathlib import Path

from codesign_bo import EvalResult


def evaluate(request):
    Path(request.workdir / "pid").write_text(str(os.getpid()))
    Path(request.workdir / "gpus").write_text(os.environ.get("CUDA_VISIBLE_DEVICES", "none"))
    return EvalResult(-((request.params["a"] - 0.3) ** 2), 0.01)


def sleep(request):
    Path(request.workdir / "pid").write_text(str(os.getpid()))
    time.sleep(600)


def short(designs):
    return designs[:, 0] < 0.6


class Body:
    @staticmethod
    def evaluate(request):
        return evaluate(request)


number = 3
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    (tmp_path / "legs_of_mine.py").write_text(CALLBACK)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "study.sqlite"
    Study(BoxSpace.box(["a"], 0.0, 1.0, 0.5), path, seed=4, n_init=10).close()
    yield path
    sys.modules.pop("legs_of_mine", None)


def test_resume_goes_on_with_space_and_settings_of_the_file(study, capsys):
    main(["resume", str(study), "legs_of_mine:evaluate", "--until", "3", "--slots", "0"])
    with open_study(study) as view:
        assert [t.status for t in view.trials()] == ["ok"] * 3
        assert view.trials()[0].result == EvalResult(-((0.5 - 0.3) ** 2), 0.01)
    printed = capsys.readouterr()
    assert "3/3" in printed.err
    assert "3 trials finished" in printed.out
    main(["resume", str(study), "legs_of_mine:Body.evaluate", "--until", "4", "--slots", "0"])
    with open_study(study) as view:
        assert len(view.trials()) == 4


@pytest.mark.slow
def test_resume_in_processes(study):
    limits = ["--timeout", "300", "--memory-gb", "8", "--gpus", "5", "6,7"]
    main(["resume", str(study), "legs_of_mine:evaluate", "--until", "4", "--slots", "2", *limits])
    with open_study(study) as view:
        assert [t.status for t in view.trials()] == ["ok"] * 4
    assert {(study.parent / "trials" / f"{i:04d}" / "gpus").read_text() for i in range(4)} <= {"5", "6,7"}
    pids = {(study.parent / "trials" / f"{i:04d}" / "pid").read_text() for i in range(4)}
    assert len(pids) == 4
    assert str(os.getpid()) not in pids


@pytest.mark.slow
def test_a_terminated_resume_leaves_its_trials_open(study):
    arguments = ["resume", str(study), "legs_of_mine:sleep", "--slots", "2"]
    script = f"from codesign_bo.cli import main; main({arguments!r})"
    process = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True)
    waited = time.monotonic() + 300
    pids = [study.parent / "trials" / name / "pid" for name in ("0000", "0001")]
    while not all(pid.exists() and pid.read_text() for pid in pids):
        assert time.monotonic() < waited
        assert process.poll() is None
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    assert process.wait(120) == 130
    assert "the same command goes on from here" in process.stderr.read()
    with open_study(study) as view:
        assert [a.status for a in view.attempts()] == ["interrupted"] * 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(int(pid.read_text()), 0)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("legs_of_mine", "write package.module:function"),
        ("nowhere.at_all:f", "cannot load nowhere.at_all:f"),
        ("legs_of_mine:walk", "cannot load legs_of_mine:walk"),
        ("legs_of_mine:number", "is a int, not a function"),
    ],
)
def test_a_callback_that_cannot_be_loaded_is_named(study, capsys, name, words):
    with pytest.raises(SystemExit, match="1"):
        main(["resume", str(study), name])
    assert words in capsys.readouterr().err


def test_a_predicate_must_be_given_again(study, tmp_path, capsys):
    def short(designs):
        return designs[:, 0] < 0.6

    path = tmp_path / "short.sqlite"
    Study(BoxSpace.box(["a"], 0.0, 1.0, 0.5), path, n_init=10, feasible=short).close()
    with pytest.raises(SystemExit, match="1"):
        main(["resume", str(path), "legs_of_mine:evaluate", "--slots", "0"])
    assert "short" in capsys.readouterr().err
    with pytest.raises(StudyError, match="Give it again"):
        Study.resume(path)
    functions = ["legs_of_mine:evaluate", "--feasible", "legs_of_mine:short"]
    main(["resume", str(path), *functions, "--until", "5", "--slots", "0"])
    with open_study(path) as view:
        assert len(view.trials()) == 5
        assert all(t.params["a"] < 0.6 for t in view.trials())
        assert view.predicate == "legs_of_mine:short"


def test_failed_trials_can_be_tried_again(study):
    with Study.resume(study) as opened:
        opened.run(lambda r: EvalResult.failure("crash", "no legs"), until=2)
    main(["resume", str(study), "legs_of_mine:evaluate", "--until", "2", "--slots", "0", "--retry-failed"])
    with open_study(study) as view:
        assert [(t.status, t.attempts) for t in view.trials()] == [("ok", 2)] * 2


def test_both_names_of_the_command_are_installed():
    from importlib.metadata import entry_points

    names = {e.name for e in entry_points(group="console_scripts") if e.value == "codesign_bo.cli:main"}
    assert names == {"codesign_bo", "codesign-bo"}
