"""The command line, the export formats and the pictures."""

import csv
import json
import re
from importlib.metadata import entry_points

import mujoco
import numpy as np
import pytest
import yourdfpy
from lxml import etree
from morphgen import DesignSpace, MorphologyError, dimensions, draw_bodies, go2, load_robot, to_mjcf
from morphgen.cli import main
from numpy.testing import assert_allclose

SCALES = ["1", "1.2", "1", "1.3"]


def test_scale_writes_a_urdf_and_an_mjcf_of_the_same_robot(tmp_path, factory, capsys):
    urdf, mjcf = tmp_path / "out.urdf", tmp_path / "out.xml"
    assert main(["scale", "--robot", "go2", "--scales", *SCALES, "-o", str(urdf), "--mjcf", str(mjcf)]) == 0
    assert urdf.read_text() == factory.urdf([1, 1.2, 1, 1.3])
    assert "hind shank length" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.urdf", "out.xml"]
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    assert model.body("RL_foot").pos[2] == pytest.approx(-0.213 * 1.3, rel=1e-15)


def test_a_scaled_urdf_is_read_back_with_its_own_nominal(tmp_path, factory):
    first, second = tmp_path / "first.urdf", tmp_path / "second.urdf"
    assert main(["scale", "--scales", *SCALES, "-o", str(first)]) == 0
    assert main(["scale", "--urdf", str(first), "--scales", "1", "0.7", "1", "0.7", "-o", str(second)]) == 0
    masses = [
        float(etree.parse(path).find("link[@name='RL_calf']/inertial/mass").get("value")) for path in (first, second)
    ]
    assert masses[1] == pytest.approx(0.7 * masses[0])


def test_exported_mjcf_has_the_dynamics_of_the_compiled_model(factory):
    design = np.random.default_rng(11).uniform(0.6, 1.4, 4)  # long decimals, which MuJoCo's writer rounds
    spec = factory.spec(design)
    original, exported = spec.compile(), mujoco.MjModel.from_xml_string(to_mjcf(spec))
    for name in ("body_mass", "body_inertia", "body_pos", "body_ipos", "geom_size", "geom_pos", "jnt_range"):
        assert_allclose(getattr(exported, name), getattr(original, name), rtol=1e-14, atol=1e-16)
    assert_allclose(exported.body_iquat, original.body_iquat, atol=1e-14)
    assert exported.opt.timestep == original.opt.timestep
    assert_allclose(exported.actuator_forcerange, original.actuator_forcerange)
    assert_allclose(exported.actuator_biasprm, original.actuator_biasprm)
    assert [exported.sensor(i).name for i in range(exported.nsensor)] == [
        original.sensor(i).name for i in range(original.nsensor)
    ]
    states = []
    for model in (original, exported):
        data = mujoco.MjData(model)
        batch = factory.batch(design)
        data.qpos[:], data.ctrl[:] = batch.stance_qpos[0], batch.stance_ctrl[0]
        mujoco.mj_step(model, data, 100)
        states.append(data.qpos.copy())
    assert_allclose(states[1], states[0], atol=1e-9)


def test_render_draws_one_picture_per_body(tmp_path):
    picture = tmp_path / "two.png"
    assert main(["render", "--scales", "1", "1", "1", "1", *SCALES, "--labels", "old", "new", "-o", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["two.png"]


def test_picture_shows_links_to_scale_with_their_dimensions(factory):
    figure = draw_bodies(factory, [(1, 1, 1, 1), (0.7, 1.3, 1, 1)], ["nominal", "best"])
    nominal, best = figure.axes
    assert (nominal.get_title(), best.get_title()) == ("nominal", "best")
    texts = [text.get_text() for text in best.texts]
    assert "149 mm\n×0.70" in texts
    assert "277 mm\n×1.30" in texts
    assert nominal.get_xlim() == best.get_xlim()

    def lengths(ax):
        corners = [patch.get_xy() for patch in ax.patches if hasattr(patch, "get_xy") and len(patch.get_xy()) == 5]
        return sorted({round(max(np.linalg.norm(np.diff(c, axis=0), axis=1)), 6) for c in map(np.array, corners)})

    assert lengths(nominal) == [0.213, 0.3762]
    assert lengths(best) == [0.1491, 0.213, 0.2769, 0.3762]


def test_many_bodies_wrap_into_rows_and_infeasible_ones_say_so(factory):
    far = load_robot("go2", space=DesignSpace.leg_scales(0.2, 4.0))
    figure = draw_bodies(far, [(1, 1, 1, 1)] * 3 + [(4, 0.2, 0.2, 0.2)])
    drawn = [ax for ax in figure.axes if ax.patches]
    assert len(drawn) == 4
    assert any("no sound level stance" in text.get_text() for text in drawn[3].texts)
    assert not any("no sound level stance" in text.get_text() for text in drawn[0].texts)
    with pytest.raises(ValueError, match="as many labels"):
        draw_bodies(factory, [(1, 1, 1, 1)], ["a", "b"])


def test_dimension_table_matches_hand_values(factory):
    table = dimensions(factory, (1, 1.2, 1, 1.3))
    assert table["front_shank_length_m"] == pytest.approx(0.2556)
    assert table["hind_shank_mass_kg"] == pytest.approx(0.2002)
    assert table["hip_spacing_m"] == pytest.approx(0.3868)
    assert table["total_mass_kg"] == pytest.approx(15.019 + 2 * 0.154 * (0.2 + 0.3))
    assert dimensions(factory, np.ones(4))["front_leg_reach_m"] == pytest.approx(0.3892, abs=5e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scale", "--scales", "1", "1", "1", "nan"], "must be finite.*nan"),
        (["scale", "--scales", "1", "1", "1", "0"], "'hind_shank' must be positive"),
        (["scale", "--scales", "1", "-1", "1", "1"], "'front_shank' must be positive"),
        (["scale", "--scales", "4", ".2", ".2", ".2"], "go2: .*foot 'RL_foot' hangs .* above the floor.*--force"),
        (["scale", "--set", "tail=2"], "unknown design parameter 'tail'; known: front_thigh"),
        (["scale", "--set", "hip_offset=wide"], "expected hip_offset=number"),
        (["scale", "--set", "motor_placement=0.5"], "rule 'lumped'; rule 'paper' has none"),
        (["scale", "--robot", "go3", "--scales", *SCALES], "unknown robot 'go3'; known: go2"),
        (["scale", "--urdf", "missing.urdf", "--scales", *SCALES], "missing.urdf"),
        (["sample", "--count", "0"], "--count must be at least 1"),
        (["export", "--scales", "4", ".2", ".2", ".2"], "no sound level stance"),
        (["render", "--scales", *SCALES, "--labels", "a", "b"], "as many labels"),
    ],
)
def test_bad_input_ends_with_a_message_and_no_file(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main([*arguments, "-o", "out.png"]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_keeps_the_old_file(tmp_path, capsys):
    output = tmp_path / "out.urdf"
    output.write_text("old")
    assert main(["scale", "--scales", "1", "1", "1", "99", "-o", str(output)]) == 2
    assert output.read_text() == "old"
    assert main(["scale", "--scales", *SCALES, "-o", str(tmp_path / "none" / "out.urdf")]) == 2
    assert "none does not exist; create it" in capsys.readouterr().err


def test_a_body_that_cannot_stand_is_written_by_force(tmp_path, capsys):
    output = tmp_path / "out.urdf"
    assert main(["scale", "--scales", "4", ".2", ".2", ".2", "--force", "-o", str(output)]) == 0
    assert "no sound level stance" in capsys.readouterr().err
    knee = etree.parse(output).find("joint[@name='FL_calf_joint']/origin").get("xyz")
    assert float(knee.split()[2]) == pytest.approx(-0.213 * 4)


def test_further_parameters_are_set_by_name(tmp_path):
    output = tmp_path / "out.urdf"
    arguments = ["--robot", "lite3", "--rule", "lumped", "--set", "hip_offset=1.2", "fl_thigh=0.9"]
    assert main(["scale", *arguments, "-o", str(output)]) == 0
    root = etree.parse(output)
    hips = [float(root.find(f"joint[@name='{leg}_HipY']/origin").get("xyz").split()[1]) for leg in ("FL", "HR")]
    knees = [float(root.find(f"joint[@name='{leg}_Knee']/origin").get("xyz").split()[2]) for leg in ("FL", "HR")]
    assert hips == pytest.approx([0.09735 * 1.2, -0.09735 * 1.2])
    assert knees == pytest.approx([-0.2 * 0.9, -0.2])


def test_sample_writes_bodies_that_can_stand(tmp_path, capsys):
    folder = tmp_path / "bodies"
    arguments = ["--space", "wide", "--count", "3", "--seed", "5", "--urdfs", "-o", str(folder)]
    assert main(["sample", *arguments]) == 0
    names = ["body_0.urdf", "body_1.urdf", "body_2.urdf", "designs.csv", "sheet.png"]
    assert sorted(path.name for path in folder.iterdir()) == names
    rows = list(csv.DictReader((folder / "designs.csv").read_text().splitlines()))
    assert len(rows) == 3
    wide = DesignSpace.wide()
    designs = np.array([[float(row[name]) for name in wide.names] for row in rows])
    assert wide.contains(designs).all()
    for i, row in enumerate(rows):
        urdf = yourdfpy.URDF.load(str(folder / f"body_{i}.urdf"), load_meshes=False)
        mass = sum(link.inertial.mass for link in urdf.link_map.values())
        assert mass == pytest.approx(float(row["total_mass_kg"]))
        front = float(row["front_thigh"]) * 0.213
        assert urdf.get_transform("FL_calf", "FL_thigh")[2, 3] == pytest.approx(-front)


def test_stdout_of_inspect_is_json(tmp_path, capsys, factory):
    path = tmp_path / "go2.urdf"
    path.write_text(factory.urdf(np.ones(4)))
    assert main(["inspect", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["total_mass"] == pytest.approx(15.019)


def test_robots_are_found_by_entry_point():
    (entry,) = entry_points(group="legged.bodies", name="go2")
    assert entry.load()().layout == go2().layout
    with pytest.raises(MorphologyError, match="known: go2"):
        load_robot("spot")
