import io

import numpy as np
import pytest
import trimesh
import yourdfpy
from lxml import etree
from morphgen import BodyFactory, go2
from morphgen.views.scene import PALETTE, WORLD, body_scene, export_glb

DESIGN = (1.3, 0.8, 0.7, 1.2)
TRUNK = (10, 200, 30, 255)


@pytest.fixture
def meshed(tmp_path):
    """The built-in robot with a coloured, a mirrored and an oblique visual mesh; the path of its URDF."""
    root = etree.fromstring(go2().urdf(np.ones(4)).encode())
    trunk = trimesh.creation.box((0.4, 0.1, 0.1))
    trunk.visual.face_colors = TRUNK
    trunk.export(tmp_path / "trunk.ply")
    trimesh.creation.box((0.03, 0.05, 0.213)).apply_translation([0, 0.02, 0]).export(tmp_path / "thigh.stl")
    trimesh.creation.cone(0.02, 0.2).apply_translation([0, 0, -0.1]).export(tmp_path / "calf.stl")

    def show(link, mesh, **attributes):
        visual = root.find(f"link[@name='{link}']/visual")
        geometry = visual.find("geometry")
        geometry.clear()
        etree.SubElement(geometry, "mesh", filename=mesh, **attributes)
        return visual

    show("base", "trunk.ply")
    show("FL_thigh", "thigh.stl")
    show("FR_thigh", "thigh.stl", scale="1 -1 1")
    show("RL_calf", "calf.stl").find("origin").set("rpy", "0 0.3 0")
    etree.SubElement(etree.SubElement(root, "material", name="paint"), "color", rgba="1 0 0 1")
    etree.SubElement(root.find("link[@name='FR_thigh']/visual"), "material", name="paint")
    path = tmp_path / "dog.urdf"
    path.write_text(etree.tostring(root, encoding="unicode"))
    return path


@pytest.fixture
def factory(meshed):
    return BodyFactory("dog", meshed.read_text(), rule="stretch", source=meshed)


def placed(scene, node):
    pose, geometry = scene.graph[node]
    return scene.geometry[geometry].copy().apply_transform(pose)


def test_scene_equals_the_exported_urdf_in_yourdfpy(factory, meshed):
    exported = factory.scaled_urdf(DESIGN)
    assert exported.meshes
    for name, data in exported.meshes.items():
        (meshed.parent / name).parent.mkdir(exist_ok=True)
        (meshed.parent / name).write_bytes(data)
    (meshed.parent / "scaled.urdf").write_text(exported.text)
    peer = yourdfpy.URDF.load(str(meshed.parent / "scaled.urdf"))
    stance = factory.stance([DESIGN])
    peer.update_cfg(dict(zip(factory.layout.joints, stance.joints[0].ravel(), strict=True)))
    up = np.array([0, 0, stance.base_height[0]])
    scene = body_scene(factory, DESIGN)
    for link in peer.link_map:
        pose, other = scene.graph.get(link, WORLD)[0], peer.get_transform(link)
        np.testing.assert_allclose(pose[:3, :3], other[:3, :3], atol=1e-9)
        np.testing.assert_allclose(pose[:3, 3], other[:3, 3] + up, atol=1e-9)
    np.testing.assert_allclose(scene.bounds, peer.scene.bounds + up, atol=1e-3)  # round shapes differ in sections


def test_the_body_stands_on_the_floor(factory):
    low, high = body_scene(factory, DESIGN).bounds
    assert low[2] == pytest.approx(0, abs=1e-4)
    assert high[2] > 0.3


def test_mirrored_and_baked_meshes_are_not_inside_out(factory):
    scene = body_scene(factory, DESIGN)
    left, right = placed(scene, "FL_thigh/0"), placed(scene, "FR_thigh/0")
    assert left.volume == pytest.approx(1.3 * 0.03 * 0.05 * 0.213, rel=1e-5)
    assert right.volume == pytest.approx(left.volume, rel=1e-5)
    np.testing.assert_allclose(right.bounds[:, 1], -left.bounds[::-1, 1], atol=1e-6)
    cone = trimesh.creation.cone(0.02, 0.2)
    assert placed(scene, "RL_calf/0").volume == pytest.approx(1.2 * cone.volume, rel=1e-4)


def test_colours_come_from_mesh_then_material_then_part(factory):
    scene = body_scene(factory, DESIGN)

    def color(node):
        return tuple(scene.geometry[scene.graph[node][1]].visual.face_colors[0])

    assert color("base/0") == TRUNK
    assert color("FR_thigh/0") == (255, 0, 0, 255)
    assert color("FL_thigh/0") == PALETTE["thigh"]
    assert color("FL_foot/0") == PALETTE["foot"]


def test_a_link_without_its_mesh_shows_its_collisions(factory, meshed):
    (meshed.parent / "trunk.ply").unlink()
    scene = body_scene(factory, DESIGN)
    np.testing.assert_allclose(placed(scene, "base/0").extents, [0.3762, 0.0935, 0.114], rtol=1e-6)
    assert len(scene.metadata["missing"]) == 1
    assert "link 'base' visual: mesh 'trunk.ply' not found" in scene.metadata["missing"][0]


def test_without_a_mesh_that_must_be_stretched_all_links_show_collisions(factory, meshed):
    (meshed.parent / "calf.stl").unlink()
    scene = body_scene(factory, DESIGN)
    assert "calf.stl" in scene.metadata["missing"][0]
    np.testing.assert_allclose(placed(scene, "base/0").extents, [0.3762, 0.0935, 0.114], rtol=1e-6)


def test_glb_has_y_up_and_is_written_whole(factory, tmp_path):
    scene = body_scene(factory, DESIGN)
    path = tmp_path / "out" / "dog.glb"
    path.parent.mkdir()
    export_glb(scene, path)
    assert [file.name for file in path.parent.iterdir()] == ["dog.glb"]
    again = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb")
    (x0, y0, z0), (x1, y1, z1) = scene.bounds
    np.testing.assert_allclose(again.bounds, [[x0, z0, -y1], [x1, z1, -y0]], atol=1e-6)
    assert {"base", "FL_thigh", "RR_foot"} <= set(again.graph.nodes)
