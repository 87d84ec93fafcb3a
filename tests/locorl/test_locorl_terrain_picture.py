"""`locorl terrain`: its table, its picture, and the view in it."""

from __future__ import annotations

import numpy as np
import pytest
from locorl.commands.terrain import Terrain
from locorl.terrain.map import TerrainConfig, TerrainMap
from locorl.terrain.tile import PARKOUR


def test_the_table_lists_sizes(capsys):
    Terrain(kinds=("steps", "long_jump"), levels=2).run()
    lines = {line.split("│")[1].strip(): line for line in capsys.readouterr().out.splitlines() if line.count("│") > 3}
    assert "0.05 m" in lines["steps"]
    assert "0.23 m" in lines["steps"]
    assert "18 x 4 m" in lines["long_jump"]
    assert "0.80 m" in lines["long_jump"]


@pytest.fixture
def picture():
    """The module, where there is a renderer to draw with."""
    pytest.importorskip("matplotlib")
    from locorl.play.errors import PlayError
    from locorl.play.renderer import gl_context

    try:
        gl_context(16, 16).free()
    except PlayError as error:
        pytest.skip(str(error))
    from locorl.terrain import picture

    return picture


def test_the_view_shows_waypoints_and_a_robot(picture):
    config = TerrainConfig(kinds=("long_jump",), levels=1, columns=1, tile=PARKOUR)
    course = picture.render(TerrainMap(config), 0, 0, 320, 240).astype(int)
    flat = picture.render(TerrainMap(TerrainConfig(kinds=("flat",), levels=1)), 0, 0, 320, 240).astype(int)
    assert course.shape == flat.shape == (240, 320, 3)
    red, green, _ = np.moveaxis(np.stack((course, flat)), -1, 0)
    teal = (green - red > 40).sum(axis=(1, 2))
    assert teal[0] > 60
    assert teal[1] == 0
    assert (flat.mean(axis=-1) < 90).sum() > 40  # the robot's figure is dark


def test_the_picture_is_written_whole(picture, tmp_path):
    import matplotlib.image

    path = tmp_path / "terrain.png"
    Terrain(kinds=("hurdles",), levels=2, show=True, output=path).run()
    image = matplotlib.image.imread(path)
    assert image.shape[0] > 400
    assert image.shape[1] > 1000
    assert np.ptp(image[..., :3], axis=-1).max() > 0.3  # in colour
    assert [file.name for file in path.parent.iterdir()] == ["terrain.png"]


@pytest.mark.parametrize(
    ("kinds", "name", "message"),
    [
        (("hills",), "terrain.txt", r"terrain\.txt: a picture is a \.png file"),
        (("hills",), "nowhere/terrain.png", "folder .*nowhere does not exist"),
        ((), "terrain.png", "name at least one kind"),
    ],
)
def test_impossible_pictures_are_refused(tmp_path, kinds, name, message):
    pytest.importorskip("matplotlib")
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        Terrain(kinds=kinds, levels=1, show=True, output=tmp_path / name).run()
    assert not list(tmp_path.iterdir())
