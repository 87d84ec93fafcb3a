import zipfile

import numpy as np
import pytest
import trimesh
import yourdfpy
from morphgen import MorphologyError
from morphgen.urdf import meshfile
from morphgen.urdf.meshes import MeshFinder, baked, scaled

WHERE = "link 'thigh' visual"


@pytest.fixture
def box():
    return trimesh.creation.box((0.2, 0.4, 0.6))


@pytest.fixture
def package(tmp_path, box):
    """src/dog/{package.xml, urdf/dog.urdf, meshes/leg.stl}, its neighbour src/parts, and a folder elsewhere."""
    for folder in ("src/dog/urdf", "src/dog/meshes", "src/parts", "elsewhere/lib"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "src/dog/package.xml").write_text("<package/>")
    for file in ("src/dog/meshes/leg.stl", "src/parts/foot.stl", "elsewhere/lib/arm.stl", "src/hidden.stl"):
        box.export(tmp_path / file)
    return tmp_path


@pytest.fixture
def finder(package):
    return MeshFinder(package / "src/dog/urdf/dog.urdf")


@pytest.mark.parametrize(
    ("filename", "file"),
    [
        ("../meshes/leg.stl", "src/dog/meshes/leg.stl"),
        ("package://dog/meshes/leg.stl", "src/dog/meshes/leg.stl"),
        ("package://parts/foot.stl", "src/parts/foot.stl"),
    ],
)
def test_names_are_resolved_from_the_urdf(package, finder, filename, file):
    assert finder.path(filename, WHERE) == package / file


def test_file_uris_and_absolute_paths_inside_the_package(package, finder):
    file = package / "src/dog/meshes/leg.stl"
    assert finder.path(f"file://{file}", WHERE) == finder.path(str(file), WHERE) == file


@pytest.mark.parametrize(
    "filename", ["lib/arm.stl", "arm.stl", "package://lib/arm.stl", "package://any/lib/arm.stl", "/old/home/arm.stl"]
)
def test_search_paths_hold_packages_folders_or_the_file_itself(package, filename):
    folders = [package / "src", package / "elsewhere", package / "elsewhere/lib"]
    finder = MeshFinder(None, folders)
    assert finder.path(filename, WHERE) == package / "elsewhere/lib/arm.stl"


@pytest.mark.parametrize(
    "filename",
    [
        "../../hidden.stl",
        "../../../elsewhere/lib/arm.stl",
        "package://dog/../hidden.stl",
        "package://parts/../hidden.stl",
    ],
)
def test_names_that_leave_the_package_are_refused(finder, filename):
    with pytest.raises(MorphologyError, match=r"link 'thigh' visual.*outside the robot's package.*--mesh-path"):
        finder.path(filename, WHERE)


def test_absolute_names_and_links_out_of_the_package_are_refused_until_allowed(package, finder):
    target = package / "elsewhere/lib/arm.stl"
    (package / "src/dog/meshes/link.stl").symlink_to(target)
    for filename in (str(target), f"file://{target}", "../meshes/link.stl"):
        with pytest.raises(MorphologyError, match="outside the robot's package"):
            finder.path(filename, WHERE)
    allowed = MeshFinder(package / "src/dog/urdf/dog.urdf", [target.parent])
    assert allowed.path("../meshes/link.stl", WHERE) == target


def test_a_package_installed_as_links_is_found(package):
    installed = package / "install/urdf"
    installed.mkdir(parents=True)
    (package / "src/dog/urdf/dog.urdf").write_text("<robot/>")
    (installed / "dog.urdf").symlink_to(package / "src/dog/urdf/dog.urdf")
    found = MeshFinder(installed / "dog.urdf").path("../meshes/leg.stl", WHERE)
    assert found == package / "src/dog/meshes/leg.stl"


def test_system_folders_are_no_packages(finder):
    with pytest.raises(MorphologyError, match="not found"):
        finder.path("package://etc/hostname", WHERE)


@pytest.mark.parametrize(
    ("filename", "message"),
    [
        ("https://host/leg.stl", "https: is not read"),
        ("model://dog/leg.stl", "model: is not read"),
        ("package://../leg.stl", "not of the form package://name/file"),
        ("package://dog", "not of the form"),
        ("../meshes/none.stl", r"not found; tried .*meshes/none.stl; .*--mesh-path"),
        ("\0.stl", "not a file name"),
    ],
)
def test_other_names_are_refused_with_link_and_remedy(finder, filename, message):
    with pytest.raises(MorphologyError, match=f"link 'thigh' visual: mesh .*{message}"):
        finder.path(filename, WHERE)


def test_a_search_path_must_be_a_folder(tmp_path):
    with pytest.raises(MorphologyError, match="none' is not a folder"):
        MeshFinder(None, [tmp_path / "none"])


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb", "dae"])
def test_every_format_gives_the_same_body(tmp_path, box, kind):
    box.export(tmp_path / f"box.{kind}")
    mesh = MeshFinder(None, [tmp_path]).load(f"box.{kind}", WHERE)
    np.testing.assert_allclose(mesh.bounds, [[-0.1, -0.2, -0.3], [0.1, 0.2, 0.3]], atol=1e-7)
    assert mesh.volume == pytest.approx(0.2 * 0.4 * 0.6, rel=1e-6)


def test_a_file_is_loaded_once(finder):
    assert finder.load("../meshes/leg.stl", WHERE) is finder.load("package://dog/meshes/leg.stl", "another link")


def test_parts_keep_place_and_colour(tmp_path):
    red, blue = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    red.visual.face_colors, blue.visual.face_colors = (255, 0, 0, 255), (0, 0, 255, 255)
    scene = trimesh.Scene([red])
    scene.add_geometry(blue, transform=trimesh.transformations.translation_matrix([3, 0, 0]))
    scene.export(tmp_path / "two.glb")
    mesh = MeshFinder(None, [tmp_path]).load("two.glb", WHERE)
    right = mesh.vertices[:, 0] > 1.5
    assert mesh.bounds[1, 0] == pytest.approx(3.5)
    assert (mesh.visual.vertex_colors[right] == (0, 0, 255, 255)).all()
    assert (mesh.visual.vertex_colors[~right] == (255, 0, 0, 255)).all()


def test_a_mesh_without_colours_has_none(tmp_path):
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    assert not MeshFinder(None, [tmp_path]).load("plain.obj", WHERE).visual.defined


def dae(box, unit="1", up="Z_UP"):
    text = box.export(file_type="dae").decode()
    head, tail = text.split("<up_axis>", 1)
    asset = head.replace("<asset>", "<asset>", 1)
    return asset + f'<unit meter="{unit}" name="x"/><up_axis>{up}</up_axis>' + tail.split("</up_axis>", 1)[1]


def test_the_up_axis_of_a_dae_is_ignored_as_yourdfpy_does(tmp_path, box):
    (tmp_path / "up.dae").write_text(dae(box, up="Y_UP"))
    robot = (
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="up.dae"/></geometry></visual></link></robot>'
    )
    (tmp_path / "r.urdf").write_text(robot)
    peer = yourdfpy.URDF.load(str(tmp_path / "r.urdf")).scene.bounds
    np.testing.assert_allclose(MeshFinder(tmp_path / "r.urdf").load("up.dae", WHERE).bounds, peer, atol=1e-9)


def test_the_unit_of_a_dae_counts(tmp_path, box):
    (tmp_path / "mm.dae").write_text(dae(box, unit="0.001"))
    mesh = MeshFinder(None, [tmp_path]).load("mm.dae", WHERE)
    np.testing.assert_allclose(mesh.extents, [0.2e-3, 0.4e-3, 0.6e-3], rtol=1e-6)


BOMB = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;">]><COLLADA>&b;</COLLADA>'


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.stl", b"", "no triangles"),
        ("noise.stl", b"noise" * 50, "no triangles"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("cut.glb", b"glTF\x02\0\0\0", "cannot be read"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("open.dae", b"<COLLADA>", "not well-formed"),
        ("bomb.dae", BOMB.encode(), "DOCTYPE"),
        ("leg.step", b"x", "format that is not read.*\\.stl"),
    ],
)
def test_files_that_are_no_mesh_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MorphologyError, match=f"link 'thigh' visual: mesh .*{name} .*{message}"):
        MeshFinder(None, [tmp_path]).load(name, WHERE)


def test_nan_and_archives_in_a_dae_are_refused(tmp_path, box):
    (tmp_path / "nan.dae").write_text(dae(box).replace("-0.1 ", "NaN ", 1))
    with zipfile.ZipFile(tmp_path / "zip.dae", "w") as archive:
        archive.writestr("box.dae", dae(box))
    finder = MeshFinder(None, [tmp_path])
    with pytest.raises(MorphologyError, match="not finite"):
        finder.load("nan.dae", WHERE)
    with pytest.raises(MorphologyError, match="archive"):
        finder.load("zip.dae", WHERE)


def test_a_dae_with_a_broken_material_keeps_its_shape(tmp_path, box):
    lost = '<profile_COMMON><newparam sid="s"><sampler2D><source>lost</source></sampler2D></newparam>'
    (tmp_path / "box.dae").write_text(dae(box).replace("<profile_COMMON>", lost, 1))
    mesh = MeshFinder(None, [tmp_path]).load("box.dae", WHERE)
    assert mesh.volume == pytest.approx(box.volume, rel=1e-6)


def test_huge_files_are_refused_unread(finder, monkeypatch):
    monkeypatch.setattr(meshfile, "MAX_BYTES", 100)
    with pytest.raises(MorphologyError, match="larger than"):
        finder.load("../meshes/leg.stl", WHERE)


def test_a_texture_outside_the_folder_of_the_mesh_is_not_read(tmp_path):
    from PIL import Image

    (tmp_path / "meshes").mkdir()
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "secret.png")
    (tmp_path / "meshes/m.mtl").write_text("newmtl m\nmap_Kd ../secret.png\n")
    face = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    (tmp_path / "meshes/m.obj").write_text(face)
    mesh = MeshFinder(None, [tmp_path / "meshes"]).load("m.obj", WHERE)
    assert not (mesh.visual.vertex_colors == (255, 0, 0, 255)).all()


def test_baking_stretches_along_an_oblique_axis(box):
    along = np.array([0.6, 0.0, 0.8])
    stretch = np.eye(3) + 0.5 * np.outer(along, along)
    mesh = trimesh.load_mesh(trimesh.util.wrap_as_stream(baked(box, stretch)), file_type="stl")
    assert mesh.volume == pytest.approx(1.5 * box.volume, rel=1e-5)
    assert np.ptp(mesh.vertices @ along) == pytest.approx(1.5 * np.ptp(box.vertices @ along), rel=1e-6)
    assert np.ptp(mesh.vertices @ [0, 1, 0]) == pytest.approx(0.4, rel=1e-6)


def test_a_mirrored_mesh_is_not_inside_out(box):
    mirrored = scaled(box, np.diag([1.0, -2.0, 1.0]))
    assert mirrored.volume == pytest.approx(2 * box.volume)
    assert box.extents[1] == pytest.approx(0.4)  # the original stays
