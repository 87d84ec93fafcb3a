"""Exported files, each opened by another reader."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import mujoco
import numpy as np
import pytest
import trimesh
import yourdfpy
from lxml import etree
from morphgen import BodyFactory, Drive, GainRule, MorphologyError, from_urdf, load_robot
from morphgen.export import export_body, export_mjcf, export_urdf
from morphgen.robots import GO2, build_urdf
from morphgen.views.bill import COLUMNS, write_bill
from numpy.testing import assert_allclose
from plain_mujoco import ball_centre, compile_urdf, mass_matrix, pose, random_poses

DESIGN = (1.25, 0.8, 0.9, 1.1)
SIZES = {"meshes": (0.04, 0.03, 0.2), "other": (0.02, 0.05, 0.1)}
"""Of the boxes in two files of the same name."""
VISUALS = {
    "FL_thigh": ("../meshes/part.stl", "0 0.25 0"),  # oblique
    "FR_thigh": ("../meshes/part.stl", "0 0 0"),
    "FL_calf": ("package://go2_description/other/part.stl", "0 0 0"),
}
SCALES = {"FL_thigh": 1.25, "FR_thigh": 1.25, "FL_calf": 0.8}
FOLDER = {"FL_thigh": "meshes", "FR_thigh": "meshes", "FL_calf": "other"}


@pytest.fixture
def source(tmp_path) -> Path:
    """Go2 in a ROS package, with meshes on three links and else the shapes it has."""
    package = tmp_path / "go2_description"
    for folder, size in SIZES.items():
        (package / folder).mkdir(parents=True)
        trimesh.creation.box(size).export(package / folder / "part.stl")
    (package / "urdf").mkdir()
    (package / "package.xml").write_text("<package/>")
    root = etree.fromstring(build_urdf(GO2, "vendor").encode())
    for link, (file, rpy) in VISUALS.items():
        visual = root.find(f"link[@name='{link}']/visual")
        visual.find("origin").set("rpy", rpy)
        geometry = visual.find("geometry")
        geometry.clear()
        etree.SubElement(geometry, "mesh", filename=file)
    path = package / "urdf" / "go2.urdf"
    path.write_bytes(etree.tostring(root))
    return path


@pytest.fixture
def robot(source) -> BodyFactory:
    return from_urdf(source, drive=Drive())


def mesh_of(path: Path, link: str) -> tuple[str, trimesh.Trimesh]:
    """File name of a link's mesh, and the mesh, scaled, as a reader finds it from the folder of the URDF."""
    visual = yourdfpy.URDF.load(str(path), load_meshes=False).link_map[link].visuals[0].geometry.mesh
    name = visual.filename
    root = path.parent
    if name.startswith("package://"):
        name, root = (
            name.removeprefix("package://"),
            next(p.parent for p in path.parents if p.name == name.split("/")[2]),
        )
    mesh = trimesh.load_mesh(root / name)
    return visual.filename, mesh.apply_scale(np.ones(3) if visual.scale is None else visual.scale)


def volume(link: str) -> float:
    return float(np.prod(SIZES[FOLDER[link]])) * SCALES[link]


def test_relative_meshes_resolve_from_another_folder_and_package_names_stay(robot, source):
    path = source.parents[1] / "scaled" / "deep" / "body.urdf"
    path.parent.mkdir(parents=True)
    export_urdf(robot, DESIGN, path)
    names = {}
    for link in VISUALS:
        names[link], mesh = mesh_of(path, link)
        assert mesh.volume == pytest.approx(volume(link), rel=1e-5)
    assert names["FL_calf"] == VISUALS["FL_calf"][0]
    assert (path.parent / names["FR_thigh"]).resolve() == (source.parents[1] / "meshes" / "part.stl").resolve()
    assert names["FL_thigh"].startswith("baked/")
    assert yourdfpy.URDF.load(
        str(path), load_meshes=True, filename_handler=lambda fname: str(resolved(path, source, fname))
    ).scene.is_valid


def resolved(path: Path, source: Path, name: str) -> Path:
    if name.startswith("package://"):
        return source.parents[2] / name.removeprefix("package://")
    return path.parent / name


def test_a_mesh_that_exporting_will_need_is_missed_before(source, tmp_path):
    """That of the left front thigh alone is made anew, and only if that thigh is stretched."""
    (source.parents[1] / "meshes").rename(tmp_path / "elsewhere")
    robot, stretched, kept = from_urdf(source, drive=Drive()), [[0.6] * 4, [1.4] * 4], [[1, 0.6, 1, 1], [1, 1.4, 1, 1]]
    missing = r"go2\.urdf: link 'FL_thigh' visual: mesh '\.\./meshes/part\.stl' not found; .*--mesh-path"
    with pytest.raises(MorphologyError, match=missing):
        robot.check_urdfs(stretched)
    with pytest.raises(MorphologyError, match=missing):
        export_urdf(robot, DESIGN, tmp_path / "body.urdf")
    robot.check_urdfs(kept)
    export_urdf(robot, kept[1], tmp_path / "body.urdf")
    found = from_urdf(source, drive=Drive(), mesh_paths=[tmp_path / "elsewhere"])
    found.check_urdfs(stretched)
    export_urdf(found, DESIGN, tmp_path / "body.urdf")


def test_a_mesh_that_cannot_be_read_is_found_before_it_is_needed(robot, source):
    (source.parents[1] / "meshes" / "part.stl").write_text("solid nothing")
    with pytest.raises(MorphologyError, match=r"link 'FL_thigh' visual: mesh .*part\.stl.*export it again"):
        robot.check_urdfs([[0.6] * 4, [1.4] * 4])


def test_beside_the_source_names_stay(robot, source):
    path = source.parent / "body.urdf"
    export_urdf(robot, DESIGN, path)
    assert mesh_of(path, "FR_thigh")[0] == VISUALS["FR_thigh"][0]


def test_meshes_made_for_another_body_are_not_taken_for_this_ones(robot, source, tmp_path):
    export_urdf(robot, (0.7, 1, 1, 1), source.parent / "short.urdf")
    (tmp_path / "new").mkdir()
    export_urdf(robot, DESIGN, tmp_path / "new" / "body.urdf")
    name, mesh = mesh_of(tmp_path / "new" / "body.urdf", "FL_thigh")
    assert mesh.volume == pytest.approx(volume("FL_thigh"), rel=1e-5)
    assert (tmp_path / "new" / name).resolve().is_relative_to(tmp_path / "new")


def test_bodies_in_one_folder_keep_their_own_meshes(robot, tmp_path):
    """Two designs side by side: neither's oblique mesh is overwritten by the other's."""
    others = {"one.urdf": DESIGN, "two.urdf": (0.7, *DESIGN[1:])}
    for name, design in others.items():
        export_urdf(robot, design, tmp_path / name)
    for name, design in others.items():
        mesh = mesh_of(tmp_path / name, "FL_thigh")[1]
        assert mesh.volume == pytest.approx(np.prod(SIZES["meshes"]) * design[0], rel=1e-5)


def test_copied_meshes_let_the_folder_move(robot, source, tmp_path):
    folder = tmp_path / "copy"
    folder.mkdir()
    export_urdf(robot, DESIGN, folder / "body.urdf", copy_meshes=True)
    shutil.rmtree(source.parents[1])
    moved = folder.rename(tmp_path / "elsewhere")
    names = set()
    for link in VISUALS:
        name, mesh = mesh_of(moved / "body.urdf", link)
        names.add(name)
        assert mesh.volume == pytest.approx(volume(link), rel=1e-5)
    assert len(names) == 3  # two files of one name, and the one that was made
    loaded = yourdfpy.URDF.load(str(moved / "body.urdf"), load_meshes=True)
    meshes = [g for g in loaded.scene.geometry.values() if len(g.faces) == 12]
    assert len(meshes) >= 3


def test_a_missing_mesh_is_named_and_nothing_is_written(source, tmp_path):
    (source.parents[1] / "meshes" / "part.stl").unlink()
    robot = from_urdf(source, drive=Drive())
    path = tmp_path / "body.urdf"
    with pytest.raises(MorphologyError, match=r"'FL_thigh' visual: mesh '../meshes/part.stl' not found.*--mesh-path"):
        export_urdf(robot, DESIGN, path)
    assert not path.exists()


@pytest.mark.parametrize(
    ("rule", "gains"), [("paper", GainRule()), ("stretch", GainRule("stance")), ("lumped", GainRule("mass"))]
)
def test_mjcf_is_the_body(rule, gains, tmp_path):
    """Mass matrix, feet, servos, friction and limits, as from the factory and from the exported URDF."""
    factory = load_robot("go2", rule=rule, gains=gains)
    factory.drive = replace(factory.drive, armature=1 / 93, kp=1e2 / 3)  # not decimal numbers
    export_mjcf(factory, DESIGN, tmp_path / "body.xml")
    model, ours = mujoco.MjModel.from_xml_path(str(tmp_path / "body.xml")), factory.spec(DESIGN).compile()
    plain = compile_urdf(factory.urdf(DESIGN))
    joints = factory.layout.joints
    for base, angles in random_poses(3, 0):
        data, own = pose(model, base, joints, angles), pose(ours, base, joints, angles)
        other = pose(plain, base, joints, angles)
        assert_allclose(mass_matrix(model, data, joints), mass_matrix(plain, other, joints), rtol=1e-9, atol=1e-9)
        assert_allclose(data.qfrc_bias, own.qfrc_bias, rtol=1e-9, atol=1e-9)
        assert_allclose(data.geom_xpos, own.geom_xpos, atol=1e-9)
        for foot in factory.layout.feet:
            assert_allclose(data.site(foot).xpos, ball_centre(plain, other, foot), atol=1e-9)
    for field in (
        "dof_armature", "dof_damping", "dof_frictionloss", "jnt_range", "jnt_actfrcrange", "actuator_forcerange"
    ):  # fmt: skip
        assert_allclose(getattr(model, field), getattr(ours, field), rtol=1e-12, err_msg=field)
    for field in ("actuator_gainprm", "actuator_biasprm"):
        assert_allclose(getattr(model, field), getattr(ours, field), rtol=1e-12, err_msg=field)
    assert model.opt.timestep == 0.005
    assert model.nsensor == ours.nsensor
    assert model.geom("floor").type == mujoco.mjtGeom.mjGEOM_PLANE


def test_every_file_of_a_body_opens(robot, tmp_path):
    folder = tmp_path / "new" / "body"
    files = {path.name: path for path in export_body(robot, DESIGN, folder)}
    assert set(files) == {"robot.urdf", "robot.xml", "robot.glb", "dimensions.csv", "picture.png"}
    moved = folder.rename(tmp_path / "moved")
    urdf = yourdfpy.URDF.load(str(moved / "robot.urdf"), load_meshes=True)
    mass = sum(link.inertial.mass for link in urdf.link_map.values() if link.inertial)
    expected = 15.019 + 2 * (1.152 * (0.25 - 0.1) + 0.154 * (-0.2 + 0.1))
    assert mass == pytest.approx(expected, rel=1e-12)
    model = mujoco.MjModel.from_xml_path(str(moved / "robot.xml"))
    assert model.body_mass.sum() == pytest.approx(expected, rel=1e-12)
    assert compile_urdf((moved / "robot.urdf").read_text()).body_mass.sum() == pytest.approx(expected, rel=1e-12)
    scene = trimesh.load_scene(moved / "robot.glb")
    height = scene.bounds[1][1] - scene.bounds[0][1]  # up is y in glTF
    assert 0.25 < height < 0.6
    assert scene.bounds[0][1] == pytest.approx(0, abs=2e-3)
    with (moved / "dimensions.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1 + 4 * 4 + 1
    assert float(rows[-1]["mass_kg"]) == pytest.approx(expected, rel=1e-12)
    picture = matplotlib.image.imread(moved / "picture.png")
    assert min(picture.shape[:2]) > 200
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 20


def test_a_file_in_the_way_is_refused(robot, tmp_path):
    (tmp_path / "body").write_text("mine")
    with pytest.raises(MorphologyError, match="body: is a file; give a folder"):
        export_body(robot, DESIGN, tmp_path / "body")
    assert (tmp_path / "body").read_text() == "mine"


def test_bill_of_go2_by_hand(tmp_path):
    """Table II for the front legs at 1.25 and 0.8, vendor's numbers for hips and trunk."""
    factory = load_robot("go2")
    write_bill(tmp_path / "bill.csv", factory, (1.25, 0.8, 1, 1))
    with (tmp_path / "bill.csv").open(newline="") as file:
        reader = csv.DictReader(file)
        rows = {row["part"]: row for row in reader}
        assert tuple(reader.fieldnames) == COLUMNS
    assert len(rows) == 18

    def numbers(part: str, *keys: str) -> list[float]:
        return [float(rows[part][key]) for key in keys]

    mass, length = 1.152 * 1.25, 0.213 * 1.25
    keys = ("length_m", "nominal_length_m", "mass_kg", "nominal_mass_kg", "com_z_m", "ixx_kgm2", "izz_kgm2")
    expected = (length, 0.213, mass, 1.152, -length / 2, mass / 12 * (0.029**2 + length**2), mass / 6 * 0.029**2)
    assert_allclose(numbers("FL_thigh (thigh)", *keys), expected, rtol=1e-12)
    mass, length = 0.154 * 0.8, 0.213 * 0.8
    expected = (length, 0.213, mass, 0.154, -length / 2, mass / 12 * (0.024**2 + length**2), mass / 6 * 0.024**2)
    assert_allclose(numbers("FR_calf (shank)", *keys), expected, rtol=1e-12)
    hip = ("length_m", "mass_kg", "com_x_m", "com_y_m", "ixy_kgm2", "ixz_kgm2", "iyz_kgm2")
    assert_allclose(
        numbers("FR_hip (hip)", *hip), (0.0955, 0.678, -0.0054, -0.00194, 3.01e-6, 1.11e-6, 1.42e-6), rtol=1e-9
    )
    assert_allclose(numbers("trunk", "length_m", "mass_kg"), (2 * 0.1934, 6.923), rtol=1e-12)
    assert_allclose(numbers("RL_foot (foot)", "length_m", "mass_kg"), (0.022, 0.04), rtol=1e-12)
    total = 15.019 + 2 * (1.152 * 0.25 - 0.154 * 0.2)
    assert_allclose(numbers("robot", "mass_kg", "nominal_mass_kg"), (total, 15.019), rtol=1e-12)
    changed = {part for part, row in rows.items() if json.loads(row["changed"].lower())}
    assert changed == {"FL_thigh (thigh)", "FR_thigh (thigh)", "FL_calf (shank)", "FR_calf (shank)", "robot"}


def test_bill_of_the_robot_as_it_is_lists_no_change(tmp_path):
    write_bill(tmp_path / "bill.csv", load_robot("lite3", rule="stretch"), np.ones(4))
    with (tmp_path / "bill.csv").open(newline="") as file:
        assert {row["changed"] for row in csv.DictReader(file)} == {"False"}
