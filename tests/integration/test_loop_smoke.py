"""The whole loop once, from the command line, checked from the outside."""

from __future__ import annotations

import json
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import yaml
from deploy.cli import main as deploy_main
from distill import verify_bundle
from rosbags.highlevel import AnyReader

from legged_codesign import preset
from legged_codesign.choice import Choice

NOMINAL_LENGTH = 0.213  # m, thigh and shank of Go2


@pytest.fixture(scope="module")
def folder(finished) -> Path:
    assert finished.code == 0, finished.output
    return finished.folder


@pytest.fixture(scope="module")
def choice(folder: Path) -> Choice:
    return Choice.from_json((folder / "choice.json").read_text())


def test_it_says_where_the_results_are(finished, folder: Path) -> None:
    for what in ("report", "bundle", "log", "best URDF"):
        (line,) = re.findall(rf"^  {what} +(\S+)$", finished.output, re.MULTILINE)
        assert Path(line).exists(), line
        assert Path(line).is_relative_to(folder)


def test_it_predicts_its_cost_before_it_starts(finished) -> None:
    prediction = finished.output.index("M environment steps, ")
    assert prediction < finished.output.index("1/9 pretrain")


def test_config_is_on_disk_resolved(folder: Path) -> None:
    stored = yaml.safe_load((folder / "config.yaml").read_text())
    assert stored["config"]["search"]["trials"] == preset("smoke").search.trials
    assert stored["config"]["pretrain"]["ppo"]["gamma_reg"] == 0.98
    assert stored["provenance"]["mujoco"].startswith("4.")


def test_trial_table(folder: Path) -> None:
    search = preset("smoke").search
    trials = json.loads((folder / "trials.json").read_text())
    assert [t["trial"] for t in trials] == list(range(search.trials))
    assert trials[0]["origin"] == "nominal"
    assert set(trials[0]["params"].values()) == {1.0}
    assert trials[1]["origin"] == "queued"
    assert trials[-1]["origin"] == "surrogate"
    assert len({tuple(t["params"].values()) for t in trials}) == search.trials
    assert len({t["seed"] for t in trials}) == search.trials
    for t in trials:
        assert t["result"]["status"] == "ok", t["result"]["message"]
        assert all(0.6 <= value <= 1.4 for value in t["params"].values())
        assert {"tracking_error", "survived", "distance", "energy", "return"} <= set(t["result"]["extras"])


def test_score_keeps_the_better_of_generalist_and_fine_tuned(folder: Path) -> None:
    for t in json.loads((folder / "trials.json").read_text()):
        extras = t["result"]["extras"]
        assert t["result"]["mean"] == max(extras["score_generalist"], extras["score_fine_tuned"])


def test_bundle_passes_both_verifiers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = verify_bundle(folder / "bundle")
    assert found.files >= 5
    assert max(found.errors.values()) < 1e-5
    with pytest.raises(SystemExit) as end:
        deploy_main(["doctor", str(folder / "bundle")])
    assert end.value.code == 0
    assert "intact" in capsys.readouterr().out


def test_altered_bundle_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "bundle"
    shutil.copytree(folder / "bundle", copy)
    urdf = copy / "robot.urdf"
    urdf.write_text(urdf.read_text().replace("0.", "1.", 1))
    with pytest.raises(SystemExit) as end:
        deploy_main(["doctor", str(copy)])
    assert end.value.code == 1
    assert "robot.urdf" in capsys.readouterr().err


def test_bundle_and_best_urdf_hold_the_chosen_body(folder: Path, choice: Choice) -> None:
    manifest = json.loads((folder / "bundle" / "manifest.json").read_text())
    design = dict(zip(manifest["robot"]["design"]["names"], manifest["robot"]["design"]["values"], strict=True))
    assert design == dict(choice.params)
    assert (folder / "best.urdf").read_text() == (folder / "bundle" / "robot.urdf").read_text()


def test_best_urdf_has_the_chosen_lengths(folder: Path, choice: Choice) -> None:
    """Joint-to-joint distances, read by yourdfpy, against Table II."""
    urdf = pytest.importorskip("yourdfpy").URDF.load(str(folder / "best.urdf"), load_meshes=False)
    origins = {name: joint.origin[:3, 3] for name, joint in urdf.joint_map.items()}
    for leg, end in (("FL", "front"), ("FR", "front"), ("RL", "hind"), ("RR", "hind")):
        knee = np.linalg.norm(origins[f"{leg}_calf_joint"])
        ankle = np.linalg.norm(next(o for name, o in origins.items() if name.startswith(f"{leg}_foot")))
        assert knee == pytest.approx(NOMINAL_LENGTH * choice.params[f"{end}_thigh"], rel=1e-9)
        assert ankle == pytest.approx(NOMINAL_LENGTH * choice.params[f"{end}_shank"], rel=1e-9)


def test_best_urdf_is_plain_xml(folder: Path) -> None:
    root = ET.parse(folder / "best.urdf").getroot()
    assert root.tag == "robot"
    assert len(root.findall("joint[@type='revolute']")) == 12


def test_eq10_from_the_log_by_hand(folder: Path) -> None:
    """-sum_t sum_j max(dq tau, 0) over the ticks under policy control, with rosbags and numpy alone."""
    mode, joints = {}, {}
    with AnyReader([folder / "rollout.mcap"]) as reader:
        for connection, time, raw in reader.messages():
            if connection.topic == "/controller":
                mode[time] = reader.deserialize(raw, connection.msgtype).mode
            elif connection.topic == "/joint_states":
                message = reader.deserialize(raw, connection.msgtype)
                joints[time] = message.velocity * message.effort
    ticks = [time for time, name in mode.items() if name == "policy"]
    rollout = json.loads((folder / "rollout.json").read_text())
    assert len(ticks) == rollout["ticks"] > 0
    f = -sum(float(np.where(joints[time] > 0.0, joints[time], 0.0).sum()) for time in ticks)
    assert f < 0.0
    assert rollout["eq10_w_ticks"] == pytest.approx(f, rel=1e-9)
    assert rollout["energy_j_50hz"] == pytest.approx(-f / 50.0, rel=1e-9)


class _Page(HTMLParser):
    """Headings, text, and everything that a browser would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.headings: list[str] = []
        self.text: list[str] = []
        self.sources: list[tuple[str, str]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        self.sources += [(tag, value or "") for name, value in attrs if name in ("src", "href", "xlink:href", "poster")]

    def handle_endtag(self, tag: str) -> None:
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if "h2" in self.open:
            self.headings.append(data.strip())
        if "style" not in self.open:
            self.text.append(data)


@pytest.fixture(scope="module")
def page(folder: Path) -> _Page:
    parsed = _Page()
    parsed.feed((folder / "report.html").read_text())
    parsed.close()
    return parsed


def test_report_has_every_section(page: _Page) -> None:
    assert page.headings == [
        "The bodies",
        "The student walking",
        "Best against nominal",
        "The search",
        "Bodies under the generalist",
        "Pre-training",
        "Provenance",
    ]


def test_report_opens_offline(page: _Page, folder: Path) -> None:
    assert page.sources
    for tag, source in page.sources:
        assert source.startswith(("data:", "#")), (tag, source[:80])
    text = (folder / "report.html").read_text()
    assert not re.findall(r"""(?:url\(|@import)\s*["']?(?!#|data:)\w""", text)
    assert "<script" not in text


def test_report_shows_a_video(page: _Page) -> None:
    (video,) = [source for tag, source in page.sources if tag == "video"]
    assert video.startswith("data:video/mp4;base64,")
    assert len(video) > 5_000


def test_report_says_how_it_was_made(finished, page: _Page) -> None:
    text = " ".join(" ".join(page.text).split())
    assert f"--preset smoke --folder {finished.folder}" in text
    for stage in ("pretrain", "search", "deploy"):
        assert stage in text


def test_report_says_the_verdict_and_its_interval(page: _Page, choice: Choice) -> None:
    text = " ".join(" ".join(page.text).split())
    sentence = choice.sentence("cost-of-transport")
    assert sentence[1:] in text
    for value in (choice.gain, choice.low, choice.high):
        assert f"{100 * value:+.1f}" in text
    assert "spread by" in text
    assert "Fine-tuning does not optimise cost-of-transport alone" in text


def test_same_command_again_does_nothing(finished, folder: Path, run_smoke: Callable) -> None:
    kept = (
        "report.html",
        "study.sqlite",
        "trials.json",
        "rollout.mcap",
        "bundle/manifest.json",
        "pretrain/generalist.pt",
    )
    before = {name: (folder / name).stat().st_mtime_ns for name in kept}
    again = run_smoke(folder)
    assert again.code == 0, again.output
    assert again.output.count("unchanged, skipped") == 9
    assert {name: (folder / name).stat().st_mtime_ns for name in kept} == before
