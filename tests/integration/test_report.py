"""What the sections of the report state, against computation by hand; missing pieces give words."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalRequest, EvalResult, Study, StudyError
from deploy.logs.reading import read_log
from rosbags.highlevel import AnyReader

from legged_codesign.choice import choose
from legged_codesign.presets import preset
from legged_codesign.report import gait, screening
from legged_codesign.report.bodies import changed_parts, length_rows, total_mass
from legged_codesign.report.compare import best_so_far, differing, read_runs, write_comparison
from legged_codesign.report.confirmation import separability
from legged_codesign.report.data import read_run
from legged_codesign.report.render import verdict
from legged_codesign.report.search import front, search
from legged_codesign.run_folder import bind
from legged_codesign.stages import RunError

LEGS = ("front_thigh", "front_shank", "hind_thigh", "hind_shank")
SPACE = BoxSpace.box(list(LEGS), 0.6, 1.4, 1.0).fix({"front_thigh": 1.0, "hind_thigh": 1.0})
TRIALS = 12
NOISE = (-0.01, 0.0, 0.02)


def score(params: dict) -> float:
    """Longer front shanks pay, longer hind shanks cost."""
    return 10.0 + 4.0 * params["front_shank"] - 1.0 * params["hind_shank"]


def evaluate(request: EvalRequest) -> EvalResult:
    value = score(request.params)
    if request.repeat is not None:
        value += NOISE[request.repeat]
    extras = {"return": value, "energy": 100.0 * request.params["front_shank"] ** 2, "survived": 4.0}
    return EvalResult(
        value, 0.01, 4, extras | {"tracking_error": 0.05, "score_generalist": value - 1.0, "score_fine_tuned": value}
    )


def fails(request: EvalRequest) -> EvalResult:
    return EvalResult.failure("crash", "no torque left")


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A run folder with a study whose truth is known, without a policy or a log."""

    def made(name: str, callback: Callable = evaluate, seed: int = 0, confirm: bool = True) -> Path:
        folder = tmp_path_factory.mktemp("made") / name
        folder.mkdir()
        config = preset("smoke", "return")
        bind(folder, replace(config, seed=seed))
        with Study(SPACE, folder / "study.sqlite", seed=seed, n_init=TRIALS) as study:
            with nullcontext() if callback is evaluate else pytest.raises(StudyError, match="no torque left"):
                study.run(callback, until=TRIALS)
            if confirm:
                study.confirm(callback, 1, 3)
                (folder / "choice.json").write_text(choose(study).to_json())
        return folder

    return made


@pytest.fixture(scope="module")
def made(make: Callable[..., Path]) -> Path:
    return make("a-run")


# --- bodies -------------------------------------------------------------------------------------------


def of_urdf(text: str, link: str) -> tuple[float, np.ndarray]:
    """Mass in kg and moments of inertia in kg cm^2 of a link."""
    inertial = ElementTree.fromstring(text).find(f"link[@name='{link}']/inertial")
    assert inertial is not None
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None
    assert inertia is not None
    moments = [1e4 * float(inertia.get(name, "")) for name in ("ixx", "iyy", "izz")]
    return float(mass.get("value", "")), np.array(moments)


def test_bill_lists_the_parts_that_change_with_the_mass_and_inertia_of_their_urdf(go2) -> None:
    nominal, chosen = np.ones(4), np.array([1.0, 1.3, 1.0, 1.0])
    rows = {tuple(row["parts"]): row for row in changed_parts(go2, nominal, chosen)}
    row = rows["FL_calf (shank)", "FR_calf (shank)"]
    assert len(rows) == 1  # thighs, hind legs, feet and trunk stay
    for which, design in enumerate((nominal, chosen)):
        mass, moments = of_urdf(go2.urdf(design), "FL_calf")
        assert row["mass"][which] == pytest.approx(mass, rel=1e-6)
        np.testing.assert_allclose(row["inertia"][which], moments, rtol=1e-5, atol=1e-7)
    assert row["length"][1] == pytest.approx(1.3 * row["length"][0])
    gained = total_mass(go2, chosen) - total_mass(go2, nominal)
    assert gained == pytest.approx(2 * (row["mass"][1] - row["mass"][0]))


def test_a_body_that_stays_needs_no_parts(go2) -> None:
    assert changed_parts(go2, np.ones(4), np.ones(4)) == []


def test_dimensions_change_by_their_scales(go2) -> None:
    rows = {row["name"]: row for row in length_rows(go2, np.array([np.ones(4), [0.8, 1.0, 1.0, 1.25]]))}
    assert rows["front thigh length"]["changes"][1] == pytest.approx(-20.0)
    assert rows["hind shank length"]["changes"][1] == pytest.approx(25.0)
    assert rows["hind shank length"]["unit"] == "mm"
    assert rows["hind thigh length"]["changes"][1] == 0.0


# --- search -------------------------------------------------------------------------------------------


def trial(number: int, gain: float, energy: float, survived: int = 4) -> SimpleNamespace:
    extras = {"return": gain, "energy": energy, "survived": survived}
    return SimpleNamespace(trial=number, ok=True, result=EvalResult(gain, 0.1, 4, extras))


def test_front_holds_what_no_other_beats_and_leaves_the_fallen_out() -> None:
    # 1 beats 0; 2 is the most frugal; 3 fell, which would beat all; 4 is beaten by 1
    trials = [trial(0, 5, 50), trial(1, 7, 50), trial(2, 4, 30), trial(3, 9, 1, survived=3), trial(4, 6, 60)]
    words = front(trials).words
    assert "2 of 4 results" in words
    assert "(trials 1, 2)" in words
    assert "the nominal design is beaten" in words
    assert "Left out: 1 on which a robot fell" in words


def test_no_front_where_every_body_falls() -> None:
    shown = front([trial(0, 5, 50, survived=0)])
    assert not shown.markup
    assert "on no body did all robots come through" in shown.words


@pytest.mark.slow
def test_search_finds_the_parameter_that_matters(made: Path) -> None:
    """The score is 4 front_shank - hind_shank: first the one, then the other; of variances, 16 to 1."""
    found = search(made / "study.sqlite", "return")
    assert re.search(r"largest first: front_shank \((8|9)\d%\)", found.pictures["sensitivity"].words)
    missing = {name for name, picture in found.pictures.items() if not picture.markup}
    assert missing == {"pairs"}  # two free parameters: the landscape shows both
    assert {check.name for check in found.checks} >= {"failures", "improvement over nominal", "bounds", "repeats"}


def test_search_in_which_all_trials_failed(make: Callable[..., Path]) -> None:
    folder = make("failed", fails, confirm=False)  # a study that only fails gives up after five
    found, data = search(folder / "study.sqlite", "return"), read_run(folder)
    assert found.pictures["slices"].words
    assert not found.pictures["slices"].markup
    assert found.checks[0].severity == "error"
    assert "5 of 5 trials failed" in " ".join(check.sentence for check in found.checks)
    assert "all 5 trials failed" in verdict(data, "return")


def test_search_that_has_not_begun(tmp_path: Path) -> None:
    found = search(tmp_path / "study.sqlite", "return")
    assert {picture.words for picture in found.pictures.values()} == {"the search has not begun"}


def test_separability_by_hand(made: Path) -> None:
    data = read_run(made)
    spread = np.std([score(dict(t.params)) for t in data.trials])
    noise = np.std(NOISE, ddof=1)
    words = separability(data)
    assert f"{spread:.4f}" in words
    assert f"{noise:.4f}" in words
    assert f"{spread / noise:.1f} times" in words


# --- screening ----------------------------------------------------------------------------------------


def screened(shank: float, through: int, error: float) -> dict:
    return {"params": {"shank": shank, "thigh": 1.0}, "score": -1.0, "through": through, "tracking_error": error}


def test_screening_says_who_fails() -> None:
    rows = [screened(1.0, 4, 0.02), screened(1.4, 1, 0.5), screened(0.6, 3, 0.3), screened(0.7, 0, 0.6)]
    rows.append(screened(1.1, 4, 0.06))
    assert [number for number, _ in screening.failing(rows, 4)] == [3, 1, 2]
    words = screening.in_words(rows, 4)
    assert "on 3 of 5 bodies" in words
    assert "0.040 m/s, at most 0.060 m/s" in words
    assert len(screening.failures(rows, 4).axes) == 1  # thighs do not vary
    assert not screening.told([{"params": {}, "score": 1.0}])


# --- gait ---------------------------------------------------------------------------------------------


def test_duty_factors_and_strides_by_hand() -> None:
    """A foot that is down for 6 of 10 ticks five times over, and one that flickers for a tick and stays down."""
    cycle = [True] * 6 + [False] * 4
    steady = [True] * 50
    steady[20] = False
    contacts = gait.Contacts(np.arange(50) * 0.02, np.array([cycle * 5, steady]).T, ("a", "b"), "made")
    np.testing.assert_allclose(contacts.duty_factors, [0.6, 0.98])
    np.testing.assert_allclose(contacts.stride_rates, [4.0, 0.0])  # four touch-downs are seen in 1 s
    assert "a 0.60, b 0.98" in contacts.sentence()


@pytest.fixture(scope="module")
def log(finished):
    return read_log(finished.folder / "rollout.mcap")


def test_contacts_are_those_of_the_log(log) -> None:
    mode, down = {}, {}
    with AnyReader([log.path]) as reader:
        for connection, time, raw in reader.messages():
            if connection.topic == "/controller":
                mode[time] = reader.deserialize(raw, connection.msgtype).mode
            elif connection.topic == "/foot_contact":
                down[time] = reader.deserialize(raw, connection.msgtype).data > 0.5
    by_hand = np.mean([down[time] for time, name in mode.items() if name == "policy"], axis=0)
    contacts = gait.read_contacts(log)
    np.testing.assert_allclose(contacts.duty_factors, by_hand)
    assert contacts.feet == ("FL_foot", "FR_foot", "RL_foot", "RR_foot")


def test_contacts_from_poses_are_those_that_the_simulator_told(log) -> None:
    again = gait.contacts_from_poses(log)
    told = gait._logged(log)  # pyright: ignore[reportPrivateUsage]
    assert told is not None
    assert (again == told).mean() > 0.97


def test_no_gait_without_control(log) -> None:
    idle = replace(log, trace=replace(log.trace, mode=np.full(len(log.trace.mode), "damp")))
    with pytest.raises(gait.GaitError, match="never had full control"):
        gait.read_contacts(idle)


# --- a page -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def torn(finished, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose log was cut off in the middle, and whose choice is not there any more."""
    folder = tmp_path_factory.mktemp("torn") / "run"
    shutil.copytree(finished.folder, folder)
    whole = (folder / "rollout.mcap").read_bytes()
    (folder / "rollout.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / "choice.json").unlink()
    return folder


@pytest.mark.slow
def test_report_of_a_torn_log_says_so(torn: Path, codesign: Callable) -> None:
    code, output = codesign("report", torn)
    assert code == 0, output
    page = (torn / "report.html").read_text()
    assert page.count("torn or altered log") == 4  # film, gait, power and work of the joints
    assert "no body was chosen yet" in page.lower()
    assert "<video" not in page
    assert "data:image/png" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)  # no still either


def test_damaged_json_is_named(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(made, folder)
    (folder / "choice.json").write_text("{")
    with pytest.raises(RunError, match=r"choice\.json is damaged"):
        read_run(folder)


# --- compare ------------------------------------------------------------------------------------------


def test_a_torn_line_costs_its_stage_alone(hand_made) -> None:
    """A power cut in the middle of a line."""
    hand_made.finish("pretrain", "screen", seconds=7.0)
    with (hand_made.folder / "metrics.jsonl").open("a") as file:
        file.write('{"stage": "search", "sec')
    assert read_run(hand_made.folder).stages == {"pretrain": 7.0, "screen": 7.0}


def test_best_so_far_is_relative_to_the_nominal_body(made: Path) -> None:
    data = read_run(made)
    values = [score(dict(t.params)) for t in data.trials]
    by_hand = [max(values[: i + 1]) / 13.0 - 1.0 for i in range(len(values))]  # the nominal body scores 10 + 4 - 1
    numbers, gains = best_so_far(data)
    assert list(numbers) == list(range(TRIALS))
    np.testing.assert_allclose(gains, by_hand)


def test_compare_sets_two_runs_side_by_side(
    made: Path, make: Callable[..., Path], codesign: Callable, tmp_path: Path
) -> None:
    other, out = make("b-run", seed=3), tmp_path / "both.html"
    code, output = codesign("compare", made, other, "--out", out)
    assert code == 0, output
    page = out.read_text()
    for folder in (made, other):
        choice = json.loads((folder / "choice.json").read_text())
        assert choice["mean"] == pytest.approx(score(choice["params"]) + np.mean(NOISE))
        for text in (output, page):
            assert folder.name in text
            assert f"{choice['nominal']:.4g} → {choice['mean']:.4g}" in text
        assert f"{213 * choice['params']['front_shank']:.4g}" in page  # Go2's calf, mm
    assert differing(read_runs([made, other])) == [("seed", ["0", "3"])]
    assert "no student yet" in page
    assert "<script" not in page


def test_compare_refuses_what_it_cannot_compare(made: Path, make: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(RunError, match="at least two"):
        read_runs([made])
    with pytest.raises(RunError, match="given twice"):
        read_runs([made, made])
    with pytest.raises(RunError, match="holds no run"):
        read_runs([made, tmp_path])
    with pytest.raises(RunError, match="has not chosen a body yet"):
        read_runs([made, make("unconfirmed", confirm=False)])


@pytest.mark.slow
def test_compare_of_finished_runs(finished, finished_return, tmp_path: Path) -> None:
    page = write_comparison(read_runs([finished.folder, finished_return.folder]), tmp_path / "c.html").read_text()
    assert "The runs have different objectives" in page
    assert "instantaneous" not in re.findall(r"Not shown: .*", page)
    for run in (finished, finished_return):
        rollout = json.loads((run.folder / "rollout.json").read_text())
        assert f"{rollout['mean_power_w']:.1f}" in page
