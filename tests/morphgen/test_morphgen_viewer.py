"""The viewer: what it shows of a design, its server, and its page in a browser."""

import io
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import zipfile
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import mujoco
import numpy as np
import pytest
import trimesh
from lxml import etree
from morphgen import BodyFactory, MorphologyError, go2
from morphgen.cli import main
from morphgen.viewer import text
from morphgen.viewer.files import mjcf_file, urdf_file
from morphgen.viewer.picture import Pictures, stretch
from morphgen.views.gltf import to_glb
from numpy.testing import assert_allclose
from PIL import Image
from trimesh.transformations import quaternion_matrix

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))  # the browser's driver

DESIGN = np.array([1.2, 0.9, 0.8, 1.3])


@pytest.fixture(scope="module")
def pictures(factory):
    return Pictures(factory)


def vertices_in_the_world(solid):
    return solid.mesh.vertices * solid.scale @ quaternion_matrix(solid.wxyz)[:3, :3].T + solid.position


def test_solids_lie_where_mujoco_puts_the_boxes(factory, pictures):
    model = factory.spec(DESIGN).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = factory.batch(DESIGN).stance_qpos[0]
    mujoco.mj_kinematics(model, data)
    solids = {solid.name: solid for solid in pictures.of(DESIGN).solids}
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    boxes = [g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX]
    assert len(boxes) == 9  # trunk, four thighs, four shanks
    for geom in boxes:
        link = model.body(model.geom_bodyid[geom]).name
        corners = (signs * model.geom_size[geom]) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        shown = vertices_in_the_world(solids[f"{link}/0"])
        distances = np.linalg.norm(corners[:, None] - shown[None], axis=-1)
        assert_allclose(distances.min(axis=1), 0, atol=1e-9, err_msg=link)


def test_all_surfaces_of_box_robots_are_shared(pictures):
    shown = pictures.of(DESIGN)
    assert all(a.mesh is b.mesh for a, b in zip(shown.solids, pictures.nominal.solids, strict=True))
    scales = {solid.name: solid.scale for solid in shown.solids}
    assert_allclose(scales["FL_thigh/0"], (1, 1, 1.2))
    assert_allclose(scales["RR_calf/0"], (1, 1, 1.3))
    assert_allclose(scales["base/0"], 1)


def test_stretch_finds_factors_and_refuses_what_has_none():
    ball = trimesh.creation.icosphere(subdivisions=1)
    longer = ball.copy().apply_transform(np.diag([1, 0.5, 1.7, 1]))
    assert_allclose(stretch(ball, longer), (1, 0.5, 1.7))
    sheared = ball.copy().apply_transform([[1, 0, 0.3, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert stretch(ball, sheared) is None
    assert stretch(ball, ball.copy().apply_translation([0, 0, 0.1])) is None
    assert stretch(ball, trimesh.creation.box()) is None


@pytest.fixture
def meshed(tmp_path):
    """The built-in robot with one STL that stretches along an axis and one that does not."""
    root = etree.fromstring(go2().urdf(np.ones(4)).encode())
    trimesh.creation.cylinder(0.02, 0.2).apply_translation([0, 0, -0.1]).export(tmp_path / "leg.stl")
    for link, rpy in (("FL_thigh", "0 0 0"), ("RL_calf", "0 0.3 0")):
        visual = root.find(f"link[@name='{link}']/visual")
        visual.find("origin").set("rpy", rpy)
        visual.find("geometry").clear()
        etree.SubElement(visual.find("geometry"), "mesh", filename="leg.stl")
    path = tmp_path / "dog.urdf"
    path.write_text(etree.tostring(root, encoding="unicode"))
    return BodyFactory("dog", path.read_text(), rule="stretch", source=path)


def test_an_oblique_mesh_gets_a_surface_of_its_own(meshed):
    pictures = Pictures(meshed)
    nominal = {solid.name: solid for solid in pictures.nominal.solids}
    shown = {solid.name: solid for solid in pictures.of(DESIGN).solids}
    assert {name for name, solid in shown.items() if solid.mesh is not nominal[name].mesh} == {"RL_calf/0"}
    # it is stretched along the leg, not along itself
    assert_allclose(shown["FL_thigh/0"].scale, (1, 1, 1.2))
    turned = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])
    stretched = nominal["RL_calf/0"].mesh.vertices @ turned.T * (1, 1, 1.3)
    lengths = [np.ptp(points[:, 2]) for points in (stretched, shown["RL_calf/0"].mesh.vertices)]
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-5)


def test_a_missing_mesh_is_told_and_the_primitives_shown(meshed, tmp_path):
    (tmp_path / "leg.stl").unlink()
    fresh = BodyFactory("dog", (tmp_path / "dog.urdf").read_text(), rule="stretch", source=tmp_path / "dog.urdf")
    shown = Pictures(fresh).nominal
    assert any(solid.name == "FL_thigh/0" for solid in shown.solids)
    assert "leg.stl" in shown.missing[0]
    assert "leg.stl" in text.verdict(shown)
    name, content = urdf_file(fresh, np.ones(4))
    assert name == "dog.urdf"
    assert b"leg.stl" in content


def test_words_of_a_feasible_body(pictures):
    shown = pictures.of([1.2, 1, 1, 1])
    verdict, table = text.verdict(shown), text.measurements(shown, pictures.nominal)
    assert "✓ Feasible" in verdict
    assert "Inertia valid: 17 of 17 links" in verdict
    cells = re.sub(r"<[^>]+>", " ", table).split("total mass")[1].split()
    # 6.923 trunk + 4 (0.678 + 1.152 + 0.154 + 0.040) = 15.019; two thighs with 20 % more
    assert cells == ["15.480", "kg", "+0.461"]
    assert re.sub(r"<[^>]+>", " ", table).split("front thigh length")[1].split()[:3] == ["255.6", "mm", "+42.6"]
    assert re.sub(r"<[^>]+>", " ", table).split("hind thigh length")[1].split()[:3] == ["213.0", "mm", "–"]


def test_a_body_that_cannot_stand_says_why(pictures):
    soft = go2()
    soft.drive = replace(soft.drive, kp=1.0)
    shown = Pictures(soft).nominal
    assert not shown.feasible
    assert "✗ Not feasible" in text.verdict(shown)
    assert "servos are too soft" in text.verdict(shown)


def test_an_impossible_inertia_is_named_and_escaped(pictures):
    shown = replace(pictures.nominal, invalid_links={"<arm>": "its principal moments 1, 1, 3 break A + B > C"})
    verdict = text.verdict(shown)
    assert "✗ Inertia valid: 16 of 17 links" in verdict
    assert "&lt;arm&gt;: its principal moments 1, 1, 3 break A + B &gt; C" in verdict


def test_a_design_out_of_bounds_is_refused(pictures):
    with pytest.raises(MorphologyError, match="front_thigh"):
        pictures.of([2, 1, 1, 1])


def test_surfaces_keep_shape_and_colour(pictures):
    solid = next(solid for solid in pictures.nominal.solids if solid.name == "FL_calf/0")
    data = to_glb(solid.mesh)
    loaded = trimesh.load_mesh(io.BytesIO(data), file_type="glb")
    assert_allclose(loaded.bounds, solid.mesh.bounds, atol=1e-6)
    assert len(loaded.vertices) == 24  # a box whose edges are sharp
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    colors = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    # sRGB (51, 120, 191) in linear light: 255 ((c / 255 + 0.055) / 1.055) ** 2.4
    assert colors["min"] == colors["max"] == [8, 48, 133, 255]


def test_files_to_download(factory, meshed):
    name, content = urdf_file(factory, DESIGN)
    assert name == "go2.urdf"
    knee = etree.fromstring(content).find("joint[@name='FL_calf_joint']/origin").get("xyz").split()
    assert float(knee[2]) == pytest.approx(-0.213 * 1.2)
    name, content = mjcf_file(factory, DESIGN)
    assert name == "go2.xml"
    model = mujoco.MjModel.from_xml_string(content.decode())
    assert model.body("RL_foot").pos[2] == pytest.approx(-0.213 * 1.3)
    name, content = urdf_file(meshed, DESIGN)
    assert name == "dog.zip"
    archive = zipfile.ZipFile(io.BytesIO(content))
    for mesh in etree.fromstring(archive.read("dog.urdf")).iter("mesh"):
        assert archive.getinfo(mesh.get("filename")).file_size > 84


def test_a_missing_extra_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.delitem(sys.modules, "morphgen.viewer.page", raising=False)
    assert main(["view", "--no-open"]) == 2
    assert "pip install 'legged-morphgen[viewer]'" in capsys.readouterr().err


@contextmanager
def serving(*args):
    """`morphgen view` on a free port; gives the process and the page's address."""
    pytest.importorskip("viser")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-c", "import sys; from morphgen.cli import main; sys.exit(main())", "view"]
    process = subprocess.Popen(
        [*command, "--no-open", "--port", str(port), *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a test session in the background ignores Ctrl-C and would hand that down
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line + process.stderr.read()
        yield process, found[0]
    finally:
        process.kill()
        process.communicate()


def test_the_page_is_served_until_ctrl_c():
    with serving("--robot", "lite3", "--space", "wide") as (process, url):
        with urlopen(url) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=30)
        assert process.returncode == 0
        assert (out, errors) == ("", "")


FIND = """(label) => {
  let node = [...document.querySelectorAll('label, div')].find(e => e.textContent.trim() === label);
  while (node && !node.querySelector('input')) node = node.parentElement;
  return node;
}"""
TYPE = """((label, value) => {
  const input = (%s)(label).querySelector('input:not([type=hidden])');
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(input, value);
  input.dispatchEvent(new Event('input', {bubbles: true}));
  input.dispatchEvent(new FocusEvent('focusout', {bubbles: true}));
})(%r, %r)"""
CLICK = "[...document.querySelectorAll('button')].find(e => e.textContent.trim() === %r).click()"
SHOWS = "document.body.innerText.replace(/\\s+/g, ' ').includes(%r)"


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which("chromium") or shutil.which("google-chrome")),
    reason="needs Chromium (Debian: apt install chromium)",
)
def test_in_a_browser(tmp_path):
    """Draws the robot; a slider changes numbers and picture; the URDF is the shown body's; reset brings it back."""
    pytest.importorskip("viser")
    from devtools import Browser

    def picture():
        image = np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"), dtype=int)
        return image[:, :600]  # without the panel

    def blue(image):
        """Share of pixels that show a shank, in each block of 4 x 4: the page draws coarser when it is slow."""
        pixels = (image[..., 2] - image[..., 0] > 60) & (image[..., 2] > 90)
        return pixels.reshape(150, 4, 150, 4).mean(axis=(1, 3))

    def moved(one, other):
        """Blocks that show a shank in one picture alone."""
        return (np.abs(blue(one) - blue(other)) > 0.5).sum()

    def settled(condition):
        """The picture once it fulfils the condition and has not changed for 6 s: parts arrive one by one."""
        end, last, since = time.monotonic() + 120, picture(), time.monotonic()
        while time.monotonic() < end:
            time.sleep(0.5)
            image = picture()
            if not np.array_equal(image, last):
                last, since = image, time.monotonic()
            elif condition(image) and time.monotonic() - since > 6:
                return image
        raise AssertionError(f"the picture is not as expected; the page: {browser.evaluate('document.body.innerText')}")

    with serving() as (_, url), Browser(width=1000, height=600, downloads=tmp_path) as browser:
        browser.open(url)
        browser.wait_for(SHOWS % "Feasible")
        assert browser.evaluate(SHOWS % "total mass 15.019 kg")
        before = settled(lambda image: blue(image).sum() > 120)

        browser.evaluate(TYPE % (FIND, "front thigh", "1.2"))
        browser.wait_for(SHOWS % "front thigh length 255.6 mm +42.6")
        browser.wait_for(SHOWS % "total mass 15.480 kg +0.461")
        settled(lambda image: moved(image, before) > 30)

        browser.evaluate(CLICK % "URDF")
        urdf = tmp_path / "go2.urdf"
        end = time.monotonic() + 30
        while not urdf.exists() and time.monotonic() < end:
            time.sleep(0.1)
        origin = etree.parse(urdf).find("joint[@name='FR_calf_joint']/origin").get("xyz").split()
        assert float(origin[2]) == pytest.approx(-0.213 * 1.2)
        assert mujoco.MjModel.from_xml_path(str(urdf)).nbody > 12

        browser.evaluate(CLICK % "Nominal")
        browser.wait_for(SHOWS % "total mass 15.019 kg –")
        settled(lambda image: moved(image, before) < 5)
        browser.evaluate(CLICK % "Random")
        browser.wait_for("!(" + SHOWS % "total mass 15.019 kg" + ")")
        (tmp_path / "page.png").write_bytes(browser.screenshot())
