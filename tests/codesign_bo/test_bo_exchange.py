import json
from dataclasses import replace

import numpy as np
import pytest
from codesign_bo import (
    BoxSpace,
    Categorical,
    Continuous,
    EvalResult,
    Integer,
    Score,
    Study,
    StudyError,
    open_study,
)
from codesign_bo.cli import main
from codesign_bo.exchange import export_study, import_study


@pytest.fixture
def path(space, bowl, tmp_path):
    def fragile(request):
        if request.trial == 2:
            return EvalResult.failure("timeout", "too slow")
        if request.trial == 3:
            return EvalResult.stopped([(1, 0.5), (2, 0.25)], fidelity=0.5)
        result = bowl(request)
        return replace(result, extras=result.extras, scores=(Score(0.0, result.mean - 1.0, 0.5, 2),))

    other = tmp_path / "other.sqlite"
    with Study(space, other, seed=5) as study:
        study.run(bowl, until=2)
    path = tmp_path / "study.sqlite"
    with Study(space, path, seed=1, feasible=anything, objectives={"energy": "minimize"}) as study:
        study.add_history(other)
        study.add_screening([{"thigh": 1.3, "shank": 0.7}], [4.0], [0.5])
        study.enqueue_screened(1)
        study.run(fragile, until=5)
        study.confirm(bowl, top_k=1, repeats=2)
        study.enqueue([{"thigh": 0.9, "shank": 0.9}])
        (request,) = study.ask()
        study.give_up(request.trial, request.token, "not heard of")
        study.ask(deadline=1e10)
    return path


def anything(designs):
    return np.ones(len(designs), dtype=bool)


def test_export_and_import_keep_everything(space, path, bowl, tmp_path):
    main(["export", str(path), str(tmp_path / "out.json")])
    main(["import", str(tmp_path / "out.json"), str(tmp_path / "copy.sqlite")])
    with open_study(path) as a, open_study(tmp_path / "copy.sqlite") as b:
        for table in ("trials", "queue", "screening", "confirmations", "ranking", "attempts", "history", "scores"):
            assert getattr(a, table)() == getattr(b, table)()
            assert getattr(a, table)()
        for uncompared in ("attempts", "basis", "seconds"):
            assert [getattr(t, uncompared) for t in a.trials()] == [getattr(t, uncompared) for t in b.trials()]
        for setting in ("space", "identity", "objectives", "predicate", "n_init"):
            assert getattr(a, setting) == getattr(b, setting)
    settings = {"seed": 1, "objectives": {"energy": "minimize"}}
    with Study(space, path, **settings) as a, Study(space, tmp_path / "copy.sqlite", **settings) as b:
        assert a.run(bowl, until=7) == b.run(bowl, until=7)


def test_export_is_strict_json_for_other_tools(path, tmp_path):
    out = tmp_path / "deep" / "out.json"
    main(["export", str(path), str(out)])
    document = json.loads(out.read_text(), parse_constant=pytest.fail)
    assert [t["trial"] for t in document["trials"]] == [0, 1, 2, 3, 4, 5]
    assert document["trials"][2]["result"]["status"] == "timeout"
    assert document["trials"][5]["result"] is None
    assert [a["status"] for a in document["trials"][5]["attempts"]] == ["lost", "running"]
    assert [p.name for p in out.parent.iterdir()] == ["out.json"]


def test_values_keep_their_types(tmp_path):
    numbers = (Continuous("a", 0.0, 2.0, 1.0), Integer("n", 1, 9, 2))
    space = BoxSpace(
        (*numbers, Categorical("foot", ("ball", "flat"), "ball"), Categorical("tail", (True, False), False))
    )
    mine = {"a": 2.0, "n": 3, "foot": "flat", "tail": True}
    with Study(space, tmp_path / "s.sqlite", n_init=3) as study:
        study.enqueue([mine])
        study.run(lambda r: EvalResult(r.params["a"] + r.params["n"]), until=4)
        export_study(study, tmp_path / "s.json")
        trials = study.trials()
    import_study(tmp_path / "s.json", tmp_path / "t.sqlite")
    with open_study(tmp_path / "t.sqlite") as copy:
        assert copy.trials() == trials
        assert copy.trials()[1].params == mine
        for t in copy.trials():
            assert [type(v) for v in t.params.values()] == [float, int, str, bool]
        assert copy.space == space


def test_bad_imports_are_named_and_leave_nothing(path, tmp_path, capsys):
    main(["export", str(path), str(tmp_path / "out.json")])
    good = json.loads((tmp_path / "out.json").read_text())
    bad = {
        "torn": json.dumps(good)[:-50],
        "version": json.dumps({**good, "schema_version": 7}),
        "attempts": json.dumps({**good, "trials": [{**good["trials"][0], "attempts": [{"token": "x"}]}]}),
        "twice": json.dumps({**good, "trials": [good["trials"][0], *good["trials"]]}),
        "trial": json.dumps({**good, "trials": [{"trial": 0}]}),
        "gap": json.dumps({**good, "trials": [t for t in good["trials"] if t["trial"] != 1]}),
        "seed": json.dumps({**good, "trials": [{**good["trials"][0], "seed": "seven"}]}),
        "basis": json.dumps({**good, "trials": [{**good["trials"][0], "basis": {"colour": 2}}]}),
        "journey": json.dumps({**good, "confirmations": [{**good["confirmations"][0], "trial": 77}]}),
        "list": "[]",
        "bounds": json.dumps({**good, "queue": [{"params": {"thigh": 99, "shank": 1}, "trial": None}]}),
    }
    for name, text in bad.items():
        source = tmp_path / f"{name}.json"
        source.write_text(text)
        with pytest.raises(SystemExit, match="1"):
            main(["import", str(source), str(tmp_path / "new.sqlite")])
        assert f"cannot import {source}" in capsys.readouterr().err
        assert not list(tmp_path.glob("new.sqlite*"))
    with pytest.raises(SystemExit, match="1"):
        main(["import", str(tmp_path / "out.json"), str(path)])
    assert "exists" in capsys.readouterr().err
    # the journal of a study whose file was removed after kill -9 would be played back into the new one
    journal = tmp_path / "new.sqlite-wal"
    journal.write_bytes(b"something")
    with pytest.raises(SystemExit, match="1"):
        main(["import", str(tmp_path / "out.json"), str(tmp_path / "new.sqlite")])
    assert f"{journal} exists" in capsys.readouterr().err
    assert journal.read_bytes() == b"something"


@pytest.mark.parametrize("command", ["status", "show"])
def test_status_prints_trials_best_and_gain(path, capsys, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "180")
    main([command, str(path)])
    out = capsys.readouterr().out
    with open_study(path) as view:
        best, gain = view.best(), view.confirmation().best
    for words in ("nominal", "queued", "timeout", "unfinished", f"best of the search: trial {best.trial}"):
        assert words in out
    assert f"gain over nominal {gain.gain:.4g} [{gain.low:.4g}, {gain.high:.4g}]" in out
    assert f"recommended: trial {gain.trial}" in out
    assert f"{gain.probability:.1%}" in out
    assert "5 trials finished, 1 of them failed, 1 unfinished, 2 imported" in out
    assert "1 stopped early, which saved 12% of the cost" in out  # half of one of the four that did not fail
    assert "energy (minimize)" in out


def test_show_of_a_missing_study_is_an_error_in_words(tmp_path, capsys):
    with pytest.raises(SystemExit, match="1"):
        main(["show", str(tmp_path / "none.sqlite")])
    assert "there is no study" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_named(path):
    with open_study(path) as view, pytest.raises(StudyError, match="cannot write /proc"):
        export_study(view, "/proc/out.json")
