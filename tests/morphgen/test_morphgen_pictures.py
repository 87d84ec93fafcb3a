import numpy as np
import pytest
import trimesh
from morphgen import BodyFactory, DesignSpace, MorphologyError, draw_bodies, go2
from morphgen.views.shading import RIGHT_SIDE, THREE_QUARTER, Camera, Surface, bounds_of, shade, surface_of
from morphgen.views.sheet import contact_sheet

FRONT = Camera.looking_from(0, 0)
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def surface(*meshes):
    """Meshes, each with its colour."""
    return Surface(
        np.concatenate([mesh.triangles for mesh, _ in meshes]),
        np.concatenate([np.tile(color, (len(mesh.faces), 1)) for mesh, color in meshes]),
    )


def picture(shown, camera, half, width=100):
    return shade(shown, camera, np.full(2, -half), np.full(2, half), width)


@pytest.fixture
def meshed(tmp_path):
    """A robot with one visual mesh, a bright trunk wider than its collision box."""
    trunk = trimesh.creation.box((0.6, 0.1, 0.1))
    trunk.visual.face_colors = (255, 0, 0, 255)
    trunk.export(tmp_path / "trunk.ply")
    box = '<box size="0.3762 0.0935 0.114"/>'
    text = go2().urdf(np.ones(4)).replace(box, '<mesh filename="trunk.ply"/>', 1)
    path = tmp_path / "dog.urdf"
    path.write_text(text)
    return BodyFactory("dog", text, rule="stretch", source=path)


def test_cameras_are_right_handed_and_look_where_they_say():
    for camera in (RIGHT_SIDE, THREE_QUARTER, FRONT):
        np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(camera.axes) == pytest.approx(1)
    np.testing.assert_allclose(RIGHT_SIDE.axes, [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12)


def test_area_and_place_of_a_box_in_the_picture():
    box = trimesh.creation.box((0.4, 0.2, 0.6)).apply_translation([0.2, 0, 0.1])
    image = picture(surface((box, RED)), RIGHT_SIDE, 0.5)
    assert image[..., 3].sum() / image[..., 3].size == pytest.approx(0.4 * 0.6, rel=0.02)
    rows, columns = np.nonzero(image[..., 3] > 0.5)
    assert (columns.min(), columns.max()) == (50, 89)  # x from 0 to 0.4
    assert (rows.min(), rows.max()) == (10, 69)  # z from 0.4 on top down to -0.2


def test_area_of_a_ball_is_that_of_its_disc():
    ball = trimesh.creation.icosphere(5, 0.4)
    image = picture(surface((ball, RED)), THREE_QUARTER, 0.5, 300)
    assert image[..., 3].mean() == pytest.approx(np.pi * 0.4**2, rel=0.01)


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearer_body_hides_the_other(order):
    near = trimesh.creation.box((0.2, 0.2, 0.2)).apply_translation([0.5, 0, 0])
    far = trimesh.creation.box((0.2, 0.8, 0.8)).apply_translation([-0.5, 0, 0])
    image = picture(surface(*[(near, RED), (far, BLUE)][::order]), FRONT, 0.5)
    assert image[50, 50, :3].argmax() == 0
    assert image[50, 20, :3].argmax() == 2


def test_interpenetrating_bodies_are_cut_where_they_meet():
    left = trimesh.creation.box((0.4, 0.8, 0.4)).apply_transform(
        trimesh.transformations.rotation_matrix(0.5, [0, 0, 1])
    )
    right = left.copy().apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    image = picture(surface((left, RED), (right, BLUE)), FRONT, 0.5)
    seen = image[50, :, :3].argmax(axis=1)
    assert set(seen[25:45]) != set(seen[55:75])
    np.testing.assert_array_equal(seen[20:49] == 0, seen[51:80][::-1] == 2)


def test_light_comes_from_above_and_both_sides_of_a_face_are_lit():
    box = trimesh.creation.box((0.5, 0.5, 0.5))
    image = picture(surface((box, (1.0, 1.0, 1.0))), Camera.looking_from(-90, 35), 0.5)
    top, side = image[30, 50, 0], image[70, 50, 0]
    assert top > side + 0.1
    inside_out = trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False)
    again = picture(surface((inside_out, (1.0, 1.0, 1.0))), Camera.looking_from(-90, 35), 0.5)
    np.testing.assert_allclose(again, image)


def test_a_shadow_lies_on_the_floor_below():
    box = trimesh.creation.box((0.2, 0.2, 0.1)).apply_translation([0, 0, 0.3])
    shown, camera = surface((box, RED)), Camera.looking_from(-90, 45)
    low, high = bounds_of(shown, camera, shadow=True)
    assert low[1] == pytest.approx(-0.1 * np.sin(np.pi / 4))
    half = np.array([0.5, 0.5])
    image = shade(shown, camera, -half, half, 100, shadow=True)
    assert 0.1 < image[50, 50, 3] < 0.5  # the origin of the floor
    assert image[50, 50, :3].max() == 0
    assert shade(shown, camera, -half, half, 100)[50, 50, 3] == 0


def test_what_lies_outside_the_picture_is_cut_off():
    box = trimesh.creation.box((4, 4, 4))
    assert picture(surface((box, RED)), THREE_QUARTER, 0.5)[..., 3].min() == 1
    assert picture(surface((box.apply_translation([0, 30, 0]), RED)), RIGHT_SIDE, 0.5)[..., 3].min() == 1
    assert picture(surface((box.apply_translation([30, 0, 0]), RED)), RIGHT_SIDE, 0.5)[..., 3].max() == 0


def test_surface_of_a_scene_is_in_world_axes():
    box = trimesh.creation.box((1, 1, 1))
    box.visual.face_colors = (255, 0, 0, 255)
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    shown = surface_of(scene)
    assert shown.triangles[..., 0].min() == pytest.approx(4.5)
    np.testing.assert_array_equal(shown.colors, np.tile(RED, (12, 1)))


def test_side_by_side_shows_the_meshes_of_a_robot(meshed):
    figure = draw_bodies(meshed, [(1, 1, 1, 1), (0.7, 1.3, 1, 1)], ["nominal", "best"])
    for ax in figure.axes:
        image, (left, right, bottom, top) = ax.images[0].get_array(), ax.images[0].get_extent()
        red = (image[..., 3] > 0.5) & (image[..., 0] > image[..., 1] + 0.2)
        columns = np.flatnonzero(red.any(axis=0))
        width = (columns[-1] - columns[0] + 1) / image.shape[1] * (right - left)
        assert width == pytest.approx(0.6, abs=0.01)
        assert (left, right) == ax.get_xlim()
        assert (bottom, top) == ax.get_ylim()
    assert "149 mm\n×0.70" in [text.get_text() for text in figure.axes[1].texts]


def test_scales_are_shown_for_spaces_of_single_legs():
    robot = BodyFactory("go2", go2().urdf(np.ones(4)), space=DesignSpace.of(fr_thigh=(0.8, 1.2)), rule="stretch")
    texts = [text.get_text() for text in draw_bodies(robot, [(1.1,)]).axes[0].texts]
    assert "234 mm\n×1.10" in texts
    assert "213 mm\n×1.00" in texts


def shown_axes(figure):
    return [ax for ax in figure.axes if ax.images]


def test_contact_sheet_has_a_picture_for_each_body(factory):
    figure = contact_sheet(factory, [(1, 1, 1, 1), (0.7, 1.3, 1, 1), (1.2, 1, 1, 1)])
    axes = shown_axes(figure)
    assert len(axes) == 3
    assert axes[1].texts[0].get_text().startswith("0.70  1.30  1.00  1.00\n")
    assert len({ax.get_xlim() for ax in axes}) == 1
    assert "3 bodies of go2" in figure.get_suptitle()


def test_contact_sheet_marks_bodies_that_cannot_stand():
    wide = BodyFactory("go2", go2().urdf(np.ones(4)), space=DesignSpace.leg_scales(0.2, 4), rule="stretch")
    designs = np.array([(1, 1, 1, 1), (4, 4, 0.2, 0.2)])
    assert wide.feasible(designs).tolist() == [True, False]
    good, bad = shown_axes(contact_sheet(wide, designs, ["a", "b"]))
    assert good.texts[0].get_text() == "a"
    assert bad.texts[0].get_text() == "b\nno sound level stance"
    assert good.images[0].get_array().min() < bad.images[0].get_array()[..., :3].min()


def test_contact_sheet_wraps_and_refuses_bad_input(factory):
    figure = contact_sheet(factory, np.ones((5, 4)), max_columns=2)
    assert len(figure.axes) == 6
    assert len(shown_axes(figure)) == 5
    with pytest.raises(ValueError, match="as many captions"):
        contact_sheet(factory, np.ones((2, 4)), ["one"])
    with pytest.raises(MorphologyError, match="front_thigh"):
        contact_sheet(factory, [(9, 1, 1, 1)])
