import json

import pytest
from codesign_bo import EvalResult, Study, StudyError, open_study
from codesign_bo.cli import main
from codesign_bo.exchange import export_study


@pytest.fixture
def path(space, bowl, tmp_path):
    def fragile(request):
        return EvalResult.failure("timeout", "too slow") if request.trial == 2 else bowl(request)

    path = tmp_path / "study.sqlite"
    with Study(space, path, seed=1) as study:
        study.add_screening([{"thigh": 1.3, "shank": 0.7}], [4.0])
        study.enqueue_screened(1)
        study.run(fragile, until=5)
        study.confirm(bowl, top_k=1, repeats=2)
        study.enqueue([{"thigh": 0.9, "shank": 0.9}])
        study.ask()
    return path


def test_export_and_import_keep_everything(space, path, bowl, tmp_path):
    main(["export", str(path), str(tmp_path / "out.json")])
    main(["import", str(tmp_path / "out.json"), str(tmp_path / "copy.sqlite")])
    with open_study(path) as a, open_study(tmp_path / "copy.sqlite") as b:
        for table in ("trials", "queue", "screening", "confirmations", "ranking"):
            assert getattr(a, table)() == getattr(b, table)()
        assert [t.attempts for t in a.trials()] == [t.attempts for t in b.trials()]
        assert a.space == b.space
    with Study(space, path, seed=1) as a, Study(space, tmp_path / "copy.sqlite", seed=1) as b:
        assert a.run(bowl, until=7) == b.run(bowl, until=7)


def test_export_is_strict_json_for_other_tools(path, tmp_path):
    out = tmp_path / "deep" / "out.json"
    main(["export", str(path), str(out)])
    document = json.loads(out.read_text(), parse_constant=pytest.fail)
    assert [t["trial"] for t in document["trials"]] == [0, 1, 2, 3, 4, 5]
    assert document["trials"][2]["result"]["status"] == "timeout"
    assert document["trials"][5]["result"] is None
    assert [p.name for p in out.parent.iterdir()] == ["out.json"]


def test_bad_imports_are_named_and_leave_nothing(path, tmp_path, capsys):
    main(["export", str(path), str(tmp_path / "out.json")])
    good = json.loads((tmp_path / "out.json").read_text())
    bad = {
        "torn": json.dumps(good)[:-50],
        "version": json.dumps({**good, "schema_version": 7}),
        "trial": json.dumps({**good, "trials": [{"trial": 0}]}),
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


def test_show_prints_trials_best_and_gain(path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    main(["show", str(path)])
    out = capsys.readouterr().out
    with open_study(path) as view:
        best, gain = view.best(), view.confirmation().best
    for words in ("nominal", "queued", "timeout", "unfinished", f"best of the search: trial {best.trial}"):
        assert words in out
    assert f"gain over nominal {gain.gain:.4g} [{gain.low:.4g}, {gain.high:.4g}]" in out


def test_show_of_a_missing_study_is_an_error_in_words(tmp_path, capsys):
    with pytest.raises(SystemExit, match="1"):
        main(["show", str(tmp_path / "none.sqlite")])
    assert "there is no study" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_named(path):
    with open_study(path) as view, pytest.raises(StudyError, match="cannot write /proc"):
        export_study(view, "/proc/out.json")
