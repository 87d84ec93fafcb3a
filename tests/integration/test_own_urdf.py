"""A URDF that needs more than its path: refused with the remedy, and the option of `codesign run` that it names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from lxml import etree
from morphgen import BodyFactory

from legged_codesign.commands.run import Run
from legged_codesign.run_folder import bind, read_config
from legged_codesign.stages import RunError

Codesign = Callable[..., tuple[int, str]]
Robot = etree._Element
HIPS = ("FL_hip_joint", "FR_hip_joint", "RL_hip_joint", "RR_hip_joint")


def far_meshes(robot: Robot, folder: Path) -> None:
    """The box of a thigh as a mesh in a folder that the file does not lead to."""
    geometry = robot.find("link[@name='FL_thigh']/collision/geometry")
    size = [float(each) for each in geometry.find("box").get("size").split()]
    (folder / "stl").mkdir()
    trimesh.creation.box(size).export(folder / "stl" / "thigh.stl")
    geometry.replace(geometry.find("box"), etree.Element("mesh", filename="package://vendor/thigh.stl"))


def impossible_inertia(robot: Robot, folder: Path) -> None:
    """A rear shank that no body is: ixx + iyy < izz."""
    robot.find("link[@name='RL_calf']/inertial/inertia").set("izz", "1.0")


def arm(robot: Robot, folder: Path) -> None:
    """A joint beside the legs."""
    robot.append(
        etree.fromstring(
            '<link name="hand"><inertial><mass value="0.3"/><inertia ixx="0.001" ixy="0" ixz="0" '
            'iyy="0.001" iyz="0" izz="0.001"/></inertial></link>'
        )
    )
    robot.append(
        etree.fromstring(
            '<joint name="elbow" type="revolute"><parent link="base"/><child link="hand"/>'
            '<origin xyz="0.2 0 0.1"/><axis xyz="0 1 0"/>'
            '<limit lower="-1" upper="1" effort="5" velocity="5"/></joint>'
        )
    )


def no_effort(robot: Robot, folder: Path) -> None:
    """Motors of unknown strength."""
    for limit in robot.iter("limit"):
        limit.attrib.pop("effort", None)


NEEDS = {
    far_meshes: ("--mesh-path", ("--mesh-path", "stl")),
    impossible_inertia: ("--repair", ("--repair",)),
    arm: ("--lock", ("--lock", "elbow")),
    no_effort: ("--torque-limit", ("--torque-limit", "40")),
}


@pytest.fixture
def written(go2: BodyFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Writes Go2 with changes into the current folder."""
    monkeypatch.chdir(tmp_path)

    def write(*changes: Callable[[Robot, Path], None]) -> str:
        robot = etree.fromstring(go2.urdf(np.ones(4)).encode())
        for change in changes:
            change(robot, tmp_path)
        Path("wolf.urdf").write_bytes(etree.tostring(robot))
        return "wolf.urdf"

    return write


@pytest.mark.parametrize("change", NEEDS, ids=lambda change: change.__name__)
def test_the_refusal_names_an_option_and_the_option_helps(change, written, codesign: Codesign) -> None:
    remedy, options = NEEDS[change]
    command = ("run", "--preset", "smoke", "--dry-run", "--robot", written(change))
    code, output = codesign(*command)
    assert code == 1, output
    assert remedy in output
    assert "wolf.urdf" in output
    code, output = codesign(*command, *options)
    assert code == 0, output
    assert "bodies.file" in output
    assert not Path("runs").exists()


def test_a_folder_from_before_these_options_still_opens_and_goes_on(tmp_path: Path) -> None:
    config = Run(preset="smoke").config()
    bind(tmp_path, config)
    content = yaml.safe_load((tmp_path / "config.yaml").read_text())
    del content["config"]["bodies"]["file"]
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(content))
    assert read_config(tmp_path) == config
    bind(tmp_path, config)
    with pytest.raises(RunError, match=r"bodies\.file\.repair: False -> True"):
        bind(tmp_path, Run(preset="smoke", repair=True).config())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--robot", "go2", "--repair"), ("'go2' is no file", "path of a .urdf")),
        (("--lock", "elbow"), ("wolf.urdf", "no joint 'elbow'")),
        (("--robot", "fox.urdf", "--repair"), ("no robot file", "fox.urdf")),
    ],
)
def test_options_that_do_not_fit_are_refused(options, words, written, codesign: Codesign) -> None:
    robot = () if "--robot" in options else ("--robot", written())
    code, output = codesign("run", "--preset", "smoke", *robot, *options)
    assert code == 1, output
    for word in words:
        assert word in output
    assert not Path("runs").exists()


@pytest.mark.slow
def test_a_whole_run_of_a_robot_that_needs_everything(written, run_smoke: Callable, tmp_path: Path) -> None:
    robot = written(*NEEDS)
    options = [*(each for _, given in NEEDS.values() for each in given), "--hips", *HIPS]
    done = run_smoke(tmp_path / "run", "--objective", "return", "--robot", str(Path(robot).resolve()), *options)
    assert done.code == 0, done.output
    assert (done.folder / "report.html").exists()
    best = etree.parse(str(done.folder / "best.urdf"))
    assert best.find("joint[@name='elbow']") is not None
    assert yaml.safe_load((done.folder / "bundle" / "manifest.json").read_text())["robot"]
