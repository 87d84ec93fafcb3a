"""`codesign_bo plot` and its page, and health in `codesign_bo status`."""

import base64
import re
from html.parser import HTMLParser

import pytest
from codesign_bo import BoxSpace, EvalResult, Study, StudyError, open_study
from codesign_bo.cli import main
from codesign_bo.plots import PICTURES, Labels, write_report

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def path(tmp_path):
    """Five trials of a space whose names need care, one of them failed."""
    space = BoxSpace.box(['<i>"a"&</i>', "$b_2$", "c"], 0.0, 1.0, 0.5)
    path = tmp_path / "legs & <arms>.sqlite"
    with Study(space, path, seed=2, n_init=10) as study:
        study.run(lambda r: EvalResult.failure("crash", "x") if r.trial == 3 else EvalResult(float(r.trial), 0.1), 5)
    return path


class Page(HTMLParser):
    """Collects what is on a page, and that every tag that is opened is closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.words, self.images = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        elif tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_the_page_shows_every_picture_with_its_sentence(path, tmp_path):
    with open_study(path) as view:
        report = write_report(view, tmp_path / "out", labels=Labels("return"))
    assert set(report.pictures) == set(PICTURES) - {"pareto"}
    assert report.missing == {"pareto": "the study has one objective"}
    text = report.page.read_text()
    page = Page(text)
    assert page.open == []
    shown = [base64.b64decode(image["src"].removeprefix("data:image/png;base64,")) for image in page.images]
    assert shown == [report.pictures[name].read_bytes() for name in PICTURES if name in report.pictures]
    assert all(png.startswith(PNG) for png in shown)
    assert [image["alt"] for image in page.images] == [report.sentences[n] for n in PICTURES if n in report.pictures]
    words = "".join(page.words)
    for expected in (*report.sentences.values(), *(c.sentence for c in report.checks), "pareto: the study has one"):
        assert expected in words
    assert "legs & <arms>.sqlite" in words
    assert '<i>"a"&</i>' in words  # as text
    assert not {"i", "arms", "script", "link", "iframe"} & set(page.seen)
    assert not re.search(r"(src|href)=\"(?!data:)", text)  # needs no other file


def test_only_some_pictures_and_those_that_vanish(path, tmp_path):
    out = tmp_path / "out"
    with open_study(path) as view:
        report = write_report(view, out, only=["timeline", "slices", "timeline"])
        assert sorted(p.name for p in out.iterdir()) == ["index.html", "slices.png", "timeline.png"]
        assert list(report.sentences) == ["timeline", "slices"]
        (out / "pareto.png").write_bytes(b"of an earlier study")
        write_report(view, out, only=["pareto"])
        assert not (out / "pareto.png").exists()
        assert (out / "slices.png").exists()
        with pytest.raises(ValueError, match=r"no picture \['violin'\]; choose from \['convergence'"):
            write_report(view, out, only=["violin"])


def test_a_folder_that_cannot_be_written(path, tmp_path):
    (tmp_path / "file").write_text("")
    with open_study(path) as view, pytest.raises(StudyError, match="choose another folder with --out"):
        write_report(view, tmp_path / "file", only=["timeline"])


@pytest.mark.parametrize("trials", [0, 1])
def test_a_study_that_has_hardly_begun_has_a_page(tmp_path, trials):
    with Study(BoxSpace.box(["a"], 0.0, 1.0, 0.5), tmp_path / "s.sqlite") as study:
        study.run(lambda r: EvalResult(1.0, 0.1), until=trials)
        report = write_report(study, tmp_path / "out")
    assert set(report.pictures) | set(report.missing) == set(PICTURES)
    assert ("No trial has a score yet" in report.page.read_text()) == (trials == 0)


def test_plot_on_the_command_line(path, tmp_path, capsys):
    main(["plot", str(path), "--only", "convergence", "pareto", "--objective", "return", "--unit", "c=m"])
    folder = tmp_path / "legs & <arms>-plots"
    assert sorted(p.name for p in folder.iterdir()) == ["convergence.png", "index.html"]
    printed = " ".join(capsys.readouterr().out.split())
    assert "convergence: Trial" in printed
    assert "pareto: not drawn, the study has one objective" in printed
    main(["plot", str(path), "--out", str(tmp_path / "here"), "--only", "timeline"])
    assert (tmp_path / "here" / "timeline.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--unit", "c"], "write name=unit"),
        (["--unit", "thigh=m"], "which"),
        (["--out", "{file}"], "cannot write"),
    ],
)
def test_mistakes_on_the_command_line(path, tmp_path, capsys, arguments, words):
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit, match="1"):
        main(["plot", str(path), "--only", "timeline", *(a.format(file=tmp_path / "file") for a in arguments)])
    assert words in capsys.readouterr().err


def test_status_says_what_is_not_right(path, capsys):
    main(["status", str(path)])
    printed = " ".join(capsys.readouterr().out.split())
    assert "info failures: 1 of 5 trials failed (20%: 1 crash)" in printed
    assert re.search(r"health: \d of 8 checks without a finding", printed)
