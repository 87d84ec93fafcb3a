"""Playing: what moves the robots, the film of them, and the page that shows them."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import locorl.providers
import mujoco
import numpy as np
import pytest
import torch
from locorl import NetworkConfig, TaskConfig
from locorl.env.depth_camera import DepthConfig
from locorl.learning.networks import ActorCritic
from locorl.learning.policy import Policy, PolicyCard
from locorl.play.actors import RandomActor, Stand, make_actor
from locorl.play.choice import Choice, at_level, calm
from locorl.play.errors import PlayError
from locorl.play.renderer import MARK_RADIUS, RobotCamera, gl_context
from locorl.play.session import Session
from locorl.play.video import Film, write_video
from locorl.tasks import make_task
from locorl.terrain.map import TerrainConfig
from locorl_box import BoxQuadruped
from numpy.testing import assert_allclose

NOMINAL = np.ones((1, 4))
NETWORK = NetworkConfig(actor=(16,), critic=(16,), encoder=(8,), latent=4)


@pytest.fixture
def gl(monkeypatch):
    """Skips where there is no OpenGL."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        gl_context(64, 64).free()
    except PlayError as error:
        pytest.skip(str(error))


@pytest.fixture
def installed(monkeypatch):
    """The robots `box` and `crate`, as if a package provided them."""

    class EntryPoint:
        def __init__(self, name):
            self.name = name

        def load(self):
            return lambda: BoxQuadruped(self.name)

    points = [EntryPoint("box"), EntryPoint("crate")]
    monkeypatch.setattr(locorl.providers, "entry_points", lambda group: points)


@pytest.fixture
def play(factory):
    def start(actor=None, designs=NOMINAL, task=None, **options) -> Session:
        return Session(factory, designs, calm(task or TaskConfig()), actor or Stand(), **options)

    return start


def save_policy(path: Path, task: TaskConfig, robot: str = "box") -> Path:
    """An untrained policy for the box robot on `task`."""
    session = Session(BoxQuadruped(), NOMINAL, calm(task), Stand())
    space, dims = session.env.factory.space, dict(session.env.group_dims)
    bounds = tuple(space.low.tolist()), tuple(space.high.tolist())
    card = PolicyCard(robot, space.names, *bounds, dims, task, NETWORK, samples=0, seed=0)
    Policy(ActorCritic(dims, 12, NETWORK), card).save(path)
    return path


# ------------------------------------------------------------------------ actors


def observation(robots: int) -> dict[str, torch.Tensor]:
    return {"proprio": torch.zeros(robots, 5)}


def test_noise_has_the_amplitude_and_correlation_asked_for():
    actor = RandomActor(amplitude=0.7, correlation=0.8, seed=3)
    actions = torch.stack([actor.act(observation(200)) for _ in range(100)]).numpy()
    assert actions.std() == pytest.approx(0.7, rel=0.02)
    assert np.corrcoef(actions[:-1].ravel(), actions[1:].ravel())[0, 1] == pytest.approx(0.8, abs=0.01)
    actor.reset()
    np.testing.assert_array_equal(actor.act(observation(200)), actions[0])
    assert not np.array_equal(RandomActor(0.7, 0.8, seed=4).act(observation(200)), actions[0])


def test_a_robot_that_restarts_goes_back_to_rest():
    actor = RandomActor(amplitude=1.0, correlation=0.99, seed=0)
    actor.act(observation(2))
    actor.reset(torch.tensor([True, False]))
    first, second = actor.act(observation(2)).abs().mean(dim=1)
    # what is left is the share of new noise, sqrt(1 - 0.99^2) = 0.14
    assert first < 0.3 < second


@pytest.mark.parametrize(("amplitude", "correlation"), [(-1.0, 0.0), (1.0, 1.0), (1.0, -0.1)])
def test_noise_that_cannot_be_is_refused(amplitude, correlation):
    with pytest.raises(ValueError, match="amplitude >= 0 and 0 <= correlation < 1"):
        RandomActor(amplitude, correlation)


def test_an_unknown_policy_is_refused():
    with pytest.raises(ValueError, match=r"no policy 'nowhere\.pt': give stand, random, or the path"):
        make_actor("nowhere.pt")


# ----------------------------------------------------------------------- session


def test_standing_stays_and_noise_moves(play):
    standing, moving = play(), play(RandomActor(seed=1))
    start = standing.qpos(0)
    for _ in range(50):
        standing.step()
        moving.step()
    assert np.abs(standing.qpos(0) - start).max() < 0.02
    assert np.abs(moving.qpos(0) - start).max() > 0.1
    assert standing.score().survived.all()


def test_the_score_counts_until_the_first_fall(play):
    session = play(designs=np.ones((2, 4)), command=(0.4, 0.0, 0.0))
    way = np.zeros(2)
    for step in range(40):
        session.env.sim.qvel[:, 0] = 0.5  # pushed along
        if step == 30:
            session.env.sim.qpos[1, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])  # turned over
        before = session.env.sim.qpos[:, 0].clone()
        session.step()
        if step < 30:
            way += (session.env.sim.qpos[:, 0] - before).numpy()
    score = session.score()
    assert score.survived.tolist() == [True, False]
    assert session.falls.tolist() == [0, 1]
    assert score.distance[1] == pytest.approx(way[1], rel=0.1)
    assert score.distance[0] > score.distance[1]
    assert_allclose(score.commanded, 0.4, rtol=1e-6)
    assert score.speed[1] == pytest.approx(score.distance[1] / (30 * 0.02), rel=1e-6)
    session.restart()
    assert session.score().survived.all()
    assert session.score().distance.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("preset", ["laptop", "paper"])  # in the latter, headings give the yaw rate
def test_a_command_replaces_that_of_the_task(play, preset):
    session = play(task=make_task("locomotion-flat", preset), command=(0.3, -0.1, 0.2))
    for _ in range(600):  # longer than a command of the task is held
        session.step()
    assert_allclose(session.env.command[0], (0.3, -0.1, 0.2), atol=0.01)
    assert session.caption(0)[1].startswith("asked 0.30, -0.10 m/s, 0.2")


def test_episodes_outlast_those_of_the_task(play):
    session = play(task=replace(TaskConfig(), episode_seconds=0.1))
    for _ in range(20):
        session.step()
    assert session.env.episode_step.tolist() == [20]


def test_waypoints_are_told(play):
    session = play(task=make_task("parkour-highjump"))
    course, reached = session.course(0)
    assert len(course) > 2
    assert reached == 0
    session.env.sim.qpos[0, :2] = torch.from_numpy(course[0, :2])
    for _ in range(10):
        session.env.sim.qvel[:] = 0.0
        session.step()
    assert session.course(0)[1] == 1


def test_near_things_are_bright_in_the_depth_image(play):
    assert play().depth(0) is None
    image = play(task=replace(TaskConfig(), camera=DepthConfig(rows=12, columns=16))).depth(0)
    assert image.shape == (12, 16)
    assert not image[0].any()  # the sky
    assert image[-1].min() > 100  # the ground before the feet
    assert (np.diff(image.astype(int), axis=0) >= 0).all()


# ------------------------------------------------------------------------ choice


def test_robots_get_a_camera_where_the_task_has_none(installed, tmp_path):
    assert Choice(robot="box").start().depth(0) is None
    small = DepthConfig.small()
    assert Choice(robot="box", camera=True).start().depth(0).shape == (small.rows, small.columns)
    own = replace(TaskConfig(), camera=DepthConfig(rows=12, columns=16))
    path = save_policy(tmp_path / "policy.pt", own)
    assert Choice(robot="box", policy=str(path), camera=True).start().depth(0).shape == (12, 16)


def test_commands_that_are_no_numbers_are_refused(installed):
    with pytest.raises(ValueError, match="three finite numbers"):
        Choice(robot="box", command=(float("nan"), 0.0, 0.0)).start()


def test_choices_of_bodies(installed, factory):
    np.testing.assert_array_equal(Choice(robot="box").designs(factory), NOMINAL)
    np.testing.assert_array_equal(
        Choice(design=(1.0, 1.2, 1.0, 1.2), bodies=2).designs(factory), [(1, 1.2, 1, 1.2)] * 2
    )
    random = Choice(bodies=3, seed=1).designs(factory)
    assert len(np.unique(random, axis=0)) == 3
    with pytest.raises(ValueError, match="at least one robot, got 0"):
        Choice(bodies=0).designs(factory)


@pytest.mark.parametrize(("level", "difficulty"), [(0, 0.2), (2, 0.6), (4, 1.0)])
def test_the_whole_map_is_of_one_level(level, difficulty):
    terrain = TerrainConfig(kinds=("hurdles",), tile=make_task("parkour-highjump").terrain.tile, levels=5)
    task = replace(make_task("parkour-highjump"), terrain=replace(terrain, difficulty=(0.2, 1.0)))
    session = Session(BoxQuadruped(), NOMINAL, at_level(calm(task), level), Stand())
    assert_allclose(session.env.terrain.difficulty, difficulty)
    assert session.caption(0)[2] == f"hurdles, difficulty {difficulty:.2f}"
    with pytest.raises(ValueError, match="levels 0 to 4, got 5"):
        at_level(task, 5)


def test_the_task_is_that_of_the_policy_unless_named(installed, tmp_path):
    task = replace(make_task("locomotion-slope"), name="my-slope")
    path = str(save_policy(tmp_path / "policy.pt", task))
    assert Choice(robot="box", policy=path).start().env.task.name == "my-slope"
    assert Choice(robot="box", policy=path, task="locomotion-hills").start().env.task.name == "locomotion-hills"
    assert Choice(robot="box").start().env.task.name == "locomotion-flat"
    assert (Choice(robot="box").levels, Choice(robot="box", policy=path).levels) == (1, task.terrain.levels)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "crate"}, "trained on 'box' .* cannot control 'crate'"),
        (
            {"task": "locomotion-steps"},
            "task 'locomotion-flat'; task 'locomotion-steps' gives .*play it on its own task",
        ),
        ({"task": "nonsense"}, "there is no task 'nonsense'"),
    ],
)
def test_a_policy_is_refused_where_it_does_not_fit(installed, tmp_path, options, message):
    path = save_policy(tmp_path / "policy.pt", TaskConfig())
    with pytest.raises(ValueError, match=message):
        Choice(**{"robot": "box", "policy": str(path), **options}).start()


def test_a_policy_is_refused_where_actions_mean_something_else(installed, tmp_path):
    path = save_policy(tmp_path / "policy.pt", replace(TaskConfig(), action_scale=0.5))
    with pytest.raises(ValueError, match=r"acts with scale 0\.5 every 0\.02 s; .* takes scale 0\.25"):
        Choice(robot="box", policy=str(path), task="locomotion-flat").start()


# ------------------------------------------------------------------------- video


def read(path: Path):
    """Frames (T, H, W, 3) and frames per second of a video."""
    imageio = pytest.importorskip("imageio.v3")
    return imageio.imread(path), imageio.immeta(path)["fps"]


@pytest.mark.usefixtures("gl")
def test_a_video_shows_every_control_step(play, tmp_path):
    """Half a second is 25 frames at 50 Hz; only noise changes the picture."""
    change = {}
    for name, actor in (("stand", Stand()), ("random", RandomActor(seed=1))):
        path = tmp_path / f"{name}.mp4"
        write_video(play(actor), path, 0.5, (160, 96), quiet=True)
        frames, fps = read(path)
        assert frames.shape == (25, 96, 160, 3)
        assert fps == pytest.approx(50.0)
        # below the numbers, from the settled stance on
        change[name] = (np.abs(frames[-1].astype(int) - frames[12])[40:].max(axis=2) > 40).sum()
    assert change["stand"] < 20 < 200 < change["random"]
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["random.mp4", "stand.mp4"]


@pytest.mark.usefixtures("gl")
def test_a_pane_for_each_body(play):
    pytest.importorskip("PIL")
    film = Film(play(designs=np.array([[1, 1, 1, 1], [1.4, 1.4, 1.4, 1.4], [0.6, 0.6, 0.6, 0.6]])), (320, 240))
    frame = film.frame().astype(int)
    film.close()
    first, second, third, none = frame[:120, :160], frame[:120, 160:], frame[120:, :160], frame[120:, 160:]
    for one, other in ((first, second), (first, third), (second, third)):
        assert (np.abs(one - other)[40:].max(axis=2) > 60).sum() > 100
    assert np.ptp(none.reshape(-1, 3), axis=0).max() == 0


@pytest.mark.usefixtures("gl")
def test_the_depth_image_lies_in_the_corner(play):
    pytest.importorskip("PIL")
    session = play(task=replace(TaskConfig(), camera=DepthConfig(rows=12, columns=16)))
    film = Film(session, (320, 240))
    frame = film.frame()
    film.close()
    depth = session.depth(0)
    inset = frame[-8 - 67 : -8, -8 - 90 : -8]  # 0.28 of the width, in the shape of the image
    for row, column in ((1, 3), (6, 8), (11, 15)):
        assert_allclose(inset[int((row + 0.5) * 67 / 12), int((column + 0.5) * 90 / 16)], depth[row, column])


@pytest.mark.usefixtures("gl")
def test_the_first_picture_is_as_the_second(play):
    """MuJoCo lays an endless plane around the camera of the picture before."""
    session = play()
    camera = RobotCamera(session.env.sim.model_of(0), 160, 120, dt=0.02)
    first, second = (camera.draw(session.qpos(0), np.zeros((0, 3))).copy() for _ in range(2))
    camera.close()
    np.testing.assert_array_equal(first, second)


@pytest.mark.usefixtures("gl")
def test_a_waypoint_is_drawn_where_it_is(play):
    """Its ball appears where a pinhole camera of 40 degrees, 1.9 m behind the robot, sees it."""
    session, size = play(), (320, 240)
    camera = RobotCamera(session.env.sim.model_of(0), *size, dt=0.02)
    nothing, mark = np.zeros((0, 3)), np.array([[0.8, 0.3, 0.5]])
    before = camera.draw(session.qpos(0), nothing).astype(int)
    after = camera.draw(session.qpos(0), mark).astype(int)
    gone = camera.draw(session.qpos(0), mark, reached=1).astype(int)
    camera.close()
    changed = np.abs(after - before).max(axis=2) > 60
    rows, columns = np.nonzero(changed)

    azimuth, elevation = np.radians(35.0), np.radians(-18.0)
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.cross(forward, (0, 0, 1)) / np.linalg.norm(np.cross(forward, (0, 0, 1)))
    way = mark[0] + (0, 0, MARK_RADIUS) - (session.qpos(0)[:3] - 1.9 * forward)
    focal = size[1] / 2 / np.tan(np.radians(20.0))
    x = size[0] / 2 + focal * (way @ right) / (way @ forward)
    y = size[1] / 2 - focal * (way @ np.cross(right, forward)) / (way @ forward)
    radius = focal * MARK_RADIUS / (way @ forward)
    assert_allclose((columns.mean(), rows.mean()), (x, y), atol=1.0)
    assert changed.sum() == pytest.approx(np.pi * radius**2, rel=0.2)
    red, _, blue = after[int(y), int(x)]
    assert red > blue  # orange while it lies ahead, grey behind
    red, _, blue = gone[int(y), int(x)]
    assert blue >= red


@pytest.mark.usefixtures("gl")
def test_a_film_that_breaks_off_leaves_the_old_file(play, tmp_path, monkeypatch):
    path = tmp_path / "out.mp4"
    path.write_bytes(b"old")
    session, steps = play(), []

    def step():
        steps.append(0)
        if len(steps) == 3:
            raise ValueError("broken")

    monkeypatch.setattr(session, "step", step)
    with pytest.raises(ValueError, match="broken"):
        write_video(session, path, 0.2, (64, 64), quiet=True)
    assert [file.name for file in tmp_path.iterdir()] == ["out.mp4"]
    assert path.read_bytes() == b"old"


@pytest.mark.parametrize(
    ("name", "seconds", "size", "message"),
    [
        ("out.gif", 1.0, (64, 64), r"out\.gif: a video is an \.mp4 file"),
        ("out.mp4", 0.0, (64, 64), "at least one frame"),
        ("out.mp4", float("nan"), (64, 64), "at least one frame"),
        ("out.mp4", float("inf"), (64, 64), "at least one frame"),
        ("out.mp4", 1.0, (65, 64), "even width and height"),
        ("nowhere/out.mp4", 1.0, (64, 64), "folder .*nowhere does not exist"),
    ],
)
def test_impossible_videos_are_refused(play, tmp_path, name, seconds, size, message):
    pytest.importorskip("imageio_ffmpeg")
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        write_video(play(), tmp_path / name, seconds, size)


def test_too_many_robots_are_refused(play):
    pytest.importorskip("PIL")
    with pytest.raises(ValueError, match="at most 16 robots, got 17"):
        Film(play(designs=np.ones((17, 4))), (640, 480))


@pytest.mark.skipif(sys.platform != "linux", reason="EGL is of Linux")
def test_without_opengl_the_error_says_what_to_do(play, tmp_path, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(PlayError, match=r"need OpenGL.*apt install libegl1.*without -o"):
        write_video(play(), tmp_path / "out.mp4", 0.1)
    assert not list(tmp_path.iterdir())


def test_a_window_system_without_a_screen_is_an_error_too(play, tmp_path, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")

    def fail(*arguments):
        raise mujoco.FatalError("an OpenGL platform library has not been loaded into this process")

    monkeypatch.setattr(mujoco, "MjrContext", fail)
    with pytest.raises(PlayError, match=r"does not work here: leave MUJOCO_GL unset"):
        write_video(play(), tmp_path / "out.mp4", 0.1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("package", ["imageio_ffmpeg", "PIL"])
def test_a_missing_extra_says_what_to_install(play, tmp_path, monkeypatch, package):
    if package == "PIL":
        pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(PlayError, match=rf"{package}: pip install 'legged-locorl\[play\]'"):
        write_video(play(), tmp_path / "out.mp4", 0.1)


# ----------------------------------------------------------------------- browser

EVERY_SHAPE = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.4 0  0 0 0.5"/>
    <hfield name="hill" nrow="3" ncol="4" size="0.9 0.6 0.5 0.1" elevation="0 .1 .2 .3 .4 .5 .6 .7 .8 .9 1 0"/>
  </asset>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <geom type="hfield" hfield="hill" pos="9 0 0.5" rgba="0 1 0 1"/>
    <body pos="1 2 3" euler="10 20 30">
      <geom type="box" size="0.1 0.2 0.3" pos="0 0 0.5" euler="0 40 0"/>
    </body>
    <body pos="0 0 2">
      <freejoint/>
      <geom type="sphere" size="0.2" rgba="1 0 0 0.5"/>
      <geom type="capsule" size="0.1 0.3" pos="0 2 0" euler="30 0 0"/>
      <geom type="cylinder" size="0.1 0.3" pos="0 4 0" euler="30 0 0"/>
      <geom type="ellipsoid" size="0.1 0.2 0.3" pos="0 6 0" euler="30 0 0"/>
      <geom type="mesh" mesh="wedge" pos="0 8 0" euler="30 0 0"/>
      <geom type="box" size="1 1 1" group="3"/>
      <geom type="box" size="1 1 1" rgba="1 1 1 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_surfaces_lie_on_the_geoms():
    """A ray from outside onto the middle of each triangle meets the geom there, but for the sag of round ones."""
    pytest.importorskip("viser")
    from locorl.play.shapes import surfaces

    model = mujoco.MjModel.from_xml_string(EVERY_SHAPE)
    data = mujoco.MjData(model)
    data.qpos[:] = (0.3, -0.2, 2.5, 0.8, 0.0, 0.6, 0.0)
    mujoco.mj_kinematics(model, data)
    groups, hit = np.array((1, 1, 1, 0, 0, 0), np.uint8), np.zeros(1, np.int32)
    met = set()
    found = surfaces(model)
    assert set(found) == {0, 2}
    for body, parts in found.items():
        turn, shift = data.xmat[body].reshape(3, 3), data.xpos[body]
        for part in parts:
            corners = (part.vertices @ turn.T + shift)[part.faces]
            outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            outward /= np.linalg.norm(outward, axis=1, keepdims=True)
            for middle, normal in zip(corners.mean(axis=1), outward, strict=True):
                distance = mujoco.mj_ray(model, data, middle + 0.05 * normal, -normal, groups, 1, -1, hit)
                assert distance == pytest.approx(0.05, abs=0.01)
                met.add((int(hit[0]), part.color))
    gray, green, red = (128, 128, 128), (0, 255, 0), (255, 0, 0)
    assert met == {(1, green), (2, gray), (3, red), *((geom, gray) for geom in (4, 5, 6, 7))}
    assert [part.opacity for part in found[2] if part.color == red] == [pytest.approx(0.5, abs=0.01)]


@pytest.fixture
def page(installed):
    viser = pytest.importorskip("viser")
    from locorl.play.browser import Page

    servers = []

    def open_page(**options) -> Page:
        servers.append(viser.ViserServer("127.0.0.1", 0, verbose=False))
        choice = Choice(robot="box", **options)
        return Page(servers[-1], choice, choice.start(), ("box", "crate"))

    yield open_page
    for server in servers:
        server.stop()


def test_the_page_is_served_and_shows_the_geoms_where_they_are(page, monkeypatch):
    viser = pytest.importorskip("viser")
    sent = {}
    add = viser.SceneApi.add_mesh_simple

    def record(self, name, vertices, faces, **options):
        sent[name] = vertices
        return add(self, name, vertices, faces, **options)

    monkeypatch.setattr(viser.SceneApi, "add_mesh_simple", record)
    shown = page(design=(1.0, 1.2, 0.9, 1.3), policy="random")
    server = shown.server
    with urlopen(f"http://127.0.0.1:{server.get_port()}") as answer:
        assert answer.status == 200
        assert b"<html" in answer.read()
    shown.session.env.sim.qpos[0, :2] = torch.tensor((1.5, -0.7))
    for _ in range(10):
        shown.advance()

    model = BoxQuadruped().compiled(np.array((1.0, 1.2, 0.9, 1.3)))
    data = mujoco.MjData(model)
    data.qpos[:] = shown.session.qpos(0)
    mujoco.mj_kinematics(model, data)
    middle = data.body("base").xpos * (1, 1, 0)
    assert np.linalg.norm(middle) > 1.0
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    boxes = [geom for geom in range(model.ngeom) if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX]
    assert len(boxes) == 13
    for geom in boxes:
        name = f"/world/bodies/{model.body(int(model.geom_bodyid[geom])).name}"
        frame = server.scene.get_handle_by_name(name)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.asarray(frame.wxyz, dtype=float))
        vertices = np.concatenate([sent[part] for part in sent if part.startswith(f"{name}/")])
        seen = vertices @ turn.reshape(3, 3).T + frame.position + server.scene.get_handle_by_name("/world").position
        corners = (signs * model.geom_size[geom]) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        distances = np.linalg.norm(corners[:, None] - middle - seen[None], axis=-1)
        assert_allclose(distances.min(axis=1), 0.0, atol=1e-5, err_msg=name)
    assert server.scene.get_handle_by_name("/world/floor") is not None


def test_pause_restart_and_command(page):
    shown = page(policy="random")
    for _ in range(5):
        shown.advance()
    shown.pause.value = True
    before = shown.session.qpos(0)
    shown.advance()
    np.testing.assert_array_equal(shown.session.qpos(0), before)
    shown.restart()
    shown.advance()
    assert shown.session.env.episode_step.tolist() == [0]
    shown.pause.value = False
    for slider, value in zip(shown.sliders, (0.7, 0.1, -0.3), strict=True):
        slider.value = value
    shown.advance()
    assert_allclose(shown.session.env.command[0], (0.7, 0.1, -0.3))


def test_body_level_and_policy_change_while_it_runs(page):
    shown = page(task="locomotion-steps", level=0)
    easy = shown.session.env.terrain.obstacle.max()
    shown.ask(level=4)
    shown.ask(design=(1.0, 1.2, 1.0, 1.2), policy="random")
    assert shown.session.env.terrain.obstacle.max() == easy  # only `advance` does what was asked for
    shown.advance()
    assert shown.session.env.terrain.obstacle.max() > 1.5 * easy
    np.testing.assert_array_equal(shown.session.env.bodies.designs, [(1.0, 1.2, 1.0, 1.2)])
    assert isinstance(shown.session.actor, RandomActor)
    shown.ask(robot="crate", design=None)
    shown.advance()
    assert shown.session.env.factory.name == "crate"


def test_what_cannot_be_shown_is_told_and_changes_nothing(page, tmp_path):
    path = save_policy(tmp_path / "policy.pt", TaskConfig())
    shown = page(policy=str(path))
    session = shown.session
    shown.ask(robot="crate", design=None)
    shown.advance()
    assert shown.session is session
    assert "cannot control &#x27;crate&#x27;" in shown.message.content
    shown.ask(level=4)
    shown.advance()
    assert shown.session is not session
    assert shown.message.content == ""


def test_waypoints_on_the_page(page):
    shown = page(task="parkour-longjump")
    assert not shown.sliders
    course, _ = shown.session.course(0)
    ball = shown.server.scene.get_handle_by_name("/world/waypoint_1")
    assert_allclose(ball.position, course[1] + (0, 0, MARK_RADIUS), atol=1e-6)
