"""A robot given as the path of a URDF: how it is opened, what a run remembers of it, and refusals with their remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import locorl.providers
import numpy as np
import pytest
import trimesh
import tyro
import yaml
from lxml import etree
from morphgen import BodyFactory
from rich.console import Console

from legged_codesign import RunConfig, pipeline
from legged_codesign.commands.run import Run
from legged_codesign.robots import FileConfig, body_factory
from legged_codesign.run_folder import bind, read_config
from legged_codesign.stages import RunError

Codesign = Callable[..., tuple[int, str]]
Robot = etree._Element
HIPS = ("FL_hip_joint", "FR_hip_joint", "RL_hip_joint", "RR_hip_joint")
SMOKE = ("run", "--preset", "smoke")


def box_mesh(folder: Path, name: str, size: list[float]) -> etree._Element:
    """A box as a mesh in a folder that the file does not lead to."""
    (folder / "stl").mkdir(exist_ok=True)
    trimesh.creation.box(size).export(folder / "stl" / name)
    return etree.Element("mesh", filename=f"package://vendor/{name}")


def far_mesh(robot: Robot, folder: Path) -> None:
    """The collision of a thigh as a mesh."""
    geometry = robot.find("link[@name='FL_thigh']/collision/geometry")
    size = [float(each) for each in geometry.find("box").get("size").split()]
    geometry.replace(geometry.find("box"), box_mesh(folder, "thigh.stl", size))


def far_visual(robot: Robot, folder: Path) -> None:
    """The visual of a thigh as a mesh that leans: a longer thigh needs it made anew, a simulation never."""
    visual = robot.find("link[@name='FR_thigh']/visual")
    visual.find("origin").set("rpy", "0 0.25 0")
    geometry = visual.find("geometry")
    geometry[:] = [box_mesh(folder, "cover.stl", [0.03, 0.03, 0.2])]


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


def skew(robot: Robot, folder: Path) -> None:
    """Both front legs on the left of the middle, both hind legs on the right."""
    for leg, shift in {"FL": 0.15, "FR": 0.15, "RL": -0.15, "RR": -0.15}.items():
        origin = robot.find(f"joint[@name='{leg}_hip_joint']/origin")
        x, y, z = map(float, origin.get("xyz").split())
        origin.set("xyz", f"{x} {y + shift} {z}")


NEEDS = {
    far_mesh: ("FL_thigh", "--mesh-path", ("--mesh-path", "stl")),
    far_visual: ("FR_thigh", "--mesh-path", ("--mesh-path", "stl")),
    impossible_inertia: ("RL_calf", "--repair", ("--repair",)),
    arm: ("elbow", "--lock", ("--lock", "elbow")),
    no_effort: ("FL_hip_joint", "--torque-limit", ("--torque-limit", "40")),
    skew: ("FR_hip_joint", "--hips FL FR RL RR", ("--hips", *HIPS)),
}
"""What is wrong -> the element and the option that its refusal names, and the option that helps."""


@pytest.fixture
def written(go2: BodyFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Writes Go2 with changes, as a path that is seen from the current folder."""
    monkeypatch.chdir(tmp_path)
    Path("mine").mkdir()

    def write(*changes: Callable[[Robot, Path], None]) -> str:
        robot = etree.fromstring(go2.urdf(np.ones(4)).encode())
        for change in changes:
            change(robot, tmp_path)
        Path("mine/wolf.urdf").write_bytes(etree.tostring(robot))
        return "mine/wolf.urdf"

    return write


@pytest.mark.parametrize("change", NEEDS, ids=lambda change: change.__name__)
def test_the_refusal_names_an_option_and_the_option_helps(
    change: Callable, written: Callable[..., str], codesign: Codesign, tmp_path: Path
) -> None:
    plain = body_factory(written()).batch(np.ones((1, 4)))
    element, remedy, options = NEEDS[change]
    command = (*SMOKE, "--dry-run", "--robot", written(change))
    code, output = codesign(*command)
    assert code == 1, output
    for words in ("wolf.urdf", f"'{element}'" if change is not arm else element, remedy):
        assert words in output
    code, output = codesign(*command, *options)
    assert code == 0, output
    assert "bodies.file" in output
    assert not Path("runs").exists()

    config = tyro.cli(Run, args=["--preset", "smoke", "--robot", "mine/wolf.urdf", *options]).config()
    bind(tmp_path / "run", config)
    assert read_config(tmp_path / "run") == config  # also from another folder
    made = body_factory(config.robot, config.bodies).batch(np.ones((1, 4)))
    assert made.total_mass[0] == pytest.approx(plain.total_mass[0] + 0.3 * (change is arm))
    np.testing.assert_allclose(made.torque_limit, 40.0 if change is no_effort else plain.torque_limit)


def test_a_mesh_is_needed_only_where_the_search_stretches_it(written: Callable[..., str], codesign: Codesign) -> None:
    command = (*SMOKE, "--dry-run", "--robot", written(far_visual))
    code, output = codesign(*command, "--fix", "front_thigh=1")
    assert code == 0, output
    code, output = codesign(*command, "--fix", "hind_thigh=1")
    assert (code, "cover.stl" in output) == (1, True)


def test_the_run_is_named_after_the_file(written: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []

    def run(config: RunConfig, folder: Path, *_: object) -> None:
        started.append((config, folder))
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "run", run)
    for name in (written(), "go2"):
        with pytest.raises(KeyboardInterrupt):
            Run(preset="smoke", robot=name).run(Console())
    (mine, folder), (builtin, default) = started
    assert folder == Path("runs/smoke-wolf-flat-cost-of-transport")
    assert mine.robot == str(tmp_path / "mine/wolf.urdf")
    assert (builtin.robot, default) == ("go2", Path("runs/smoke-go2-flat-cost-of-transport"))
    assert body_factory(mine.robot).name == "wolf"


def test_servos_and_hips_of_a_file(written: Callable[..., str]) -> None:
    """The robot turned about the vertical by 180 degrees."""
    turned = HIPS[::-1]
    robot = written()
    factory = body_factory(robot, Run(robot=robot, hips=turned, kp=55.0, kd=1.5).bodies)
    assert factory.layout.joints[::3] == turned
    batch = factory.batch(np.ones((1, 4)))
    assert (batch.kp[0, 0], batch.kd[0, 0]) == (55.0, 1.5)
    with pytest.raises(ValueError, match="names 3 joints; name one for each of FL, FR, RL, RR"):
        FileConfig(hips=("a", "b", "c"))


def test_the_plan_tells_how_a_file_is_opened(
    written: Callable, codesign: Codesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    code, output = codesign(*SMOKE, "--robot", written(), "--kp", "55", "--repair", "--dry-run")
    assert code == 0, output
    shown = {line.split("│")[1].strip(): line.split("│")[2].strip() for line in output.splitlines() if "│" in line}
    assert (shown["bodies.file.kp"], shown["bodies.file.repair"], shown["body.kp"]) == ("55", "True", "55")


def test_a_changed_file_does_not_continue_a_run(written: Callable[..., str], tmp_path: Path) -> None:
    robot = Path(written())
    config = Run(preset="smoke", robot=str(robot)).config()
    bind(tmp_path / "run", config)
    bind(tmp_path / "run", config)
    assert read_config(tmp_path / "run") == config
    robot.write_text(robot.read_text().replace("<robot", "<!-- longer --><robot"))
    for use in (lambda: bind(tmp_path / "run", config), lambda: read_config(tmp_path / "run")):
        with pytest.raises(RunError, match=r"wolf\.urdf has changed since the run in .* began; restore it or choose"):
            use()


@pytest.mark.parametrize("missing", ["robot_sha256", "file"])
def test_a_folder_from_before_robots_had_files_or_options_opens_and_goes_on(tmp_path: Path, missing: str) -> None:
    config = Run(preset="smoke").config()
    bind(tmp_path, config)
    path = tmp_path / "config.yaml"
    content = yaml.safe_load(path.read_text())
    del (content if missing in content else content["config"]["bodies"])[missing]
    path.write_text(yaml.safe_dump(content))
    assert read_config(tmp_path) == config
    bind(tmp_path, config)
    with pytest.raises(RunError, match=r"bodies\.file\.repair: False -> True"):
        bind(tmp_path, Run(preset="smoke", repair=True).config())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--robot", "go2", "--repair"), ("'go2' is no file", "path of a .urdf")),
        (("--lock", "elbow"), ("wolf.urdf", "no joint 'elbow'")),
        (
            ("--hips", "nose", *HIPS[1:]),
            ("wolf.urdf", "'nose', named for FL (--hips)", f"can be '{HIPS[0]}', '{HIPS[1]}'"),
        ),
        (("--hips", *HIPS[:3], HIPS[0]), ("wolf.urdf", f"'{HIPS[0]}' is named for FL and for RR (--hips)")),
        (("--robot", "mine/fox.urdf"), ("no robot file", "fox.urdf")),
        (("--robot", "mine/fox.urdf", "--repair"), ("no robot file", "fox.urdf")),
        (("--preset", "laptop"), ("wolf", "--from-scratch")),
    ],
)
def test_what_does_not_fit_is_refused(options, words, written: Callable[..., str], codesign: Codesign) -> None:
    robot = () if "--robot" in options else ("--robot", written())
    preset = () if "--preset" in options else ("--preset", "smoke")
    code, output = codesign("run", *preset, *robot, *options)
    assert code == 1, output
    for word in words:
        assert word in output
    assert not Path("runs").exists()


def test_without_a_package_that_opens_files_its_name_is_told(
    written: Callable, codesign: Codesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = written()
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: [])
    code, output = codesign(*SMOKE, "--robot", robot)
    assert code == 1
    assert "pip install legged-morphgen" in output
    assert not Path("runs").exists()


@pytest.mark.slow
def test_a_whole_run_of_a_robot_that_needs_everything(written, run_smoke: Callable, tmp_path: Path) -> None:
    needs = {change: options for change, (_, _, options) in NEEDS.items() if change is not skew}
    robot = Path(written(*needs)).resolve()
    options = dict.fromkeys(needs.values())  # one mesh path for both meshes
    flat = [each for given in options for each in given]
    done = run_smoke(tmp_path / "run", "--objective", "return", "--robot", str(robot), *flat, "--hips", *HIPS)
    assert done.code == 0, done.output
    assert (done.folder / "report.html").exists()
    best = etree.parse(str(done.folder / "best.urdf"))
    assert best.find("joint[@name='elbow']") is not None
    assert yaml.safe_load((done.folder / "bundle" / "manifest.json").read_text())["robot"]
