"""The live view: a page on a viser server, fed by a simulation that runs in real time."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import Any

import mujoco
import numpy as np
import viser
from numpy.typing import NDArray

from locorl.bodies.designs import sample_designs
from locorl.checkpoint import CheckpointError
from locorl.play.choice import Choice
from locorl.play.renderer import AHEAD, MARK_RADIUS, NEXT, ON_GROUND, REACHED
from locorl.play.session import Command, Session
from locorl.play.shapes import surfaces

_WORLD = "/world"
_LATE = 0.2
"""Lag behind real time that is given up rather than caught up, s."""
_DEPTH_WIDTH = 360
"""Up to which the depth image is enlarged, px."""
_INFO_PERIOD = 0.2
"""Time between two updates of the numbers, s."""


class Page:
    """Shows one robot on a viser server; all browsers connected to it see the same.

    The world moves and the robot stays in the middle, so that the camera follows and still is the visitor's own.
    The page's callbacks only note what was asked for: `run` does it, in one thread.

    Args:
        server: a fresh server.
        choice: what to show first; one robot.
        session: the same, started.
        robots: names of the robots to choose from.

    Attributes:
        server: as above.
        choice: what is shown now.
        session: the same, running.
        message: why the last wish could not be fulfilled; empty otherwise.
        pause: whether time stands still.
        sliders: forward, left and turning velocity; none on a task whose waypoints lead.
    """

    def __init__(self, server: viser.ViserServer, choice: Choice, session: Session, robots: Sequence[str]) -> None:
        self.server = server
        self.choice = choice
        self.session = session
        self._random = np.random.default_rng()
        self._lock = threading.Lock()
        self._wanted: Choice | None = None
        self._restart = threading.Event()
        self._told = 0.0
        server.scene.configure_environment_map("studio", environment_intensity=0.2)
        server.initial_camera.position, server.initial_camera.look_at = (-1.2, -1.4, 0.7), (0.3, -0.2, 0.1)
        self._build_world()
        self._build_panel(sorted({self.choice.robot, *robots}))
        self.update()

    def run(self) -> None:
        """Play in real time; does not return."""
        due = time.monotonic()
        while True:
            self.advance()
            due = max(due + self.session.env.dt, time.monotonic() - _LATE)
            time.sleep(max(0.0, due - time.monotonic()))

    def advance(self) -> None:
        """Do what was asked for, simulate one control step unless paused, and show it."""
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._show(wanted)
        if self._restart.is_set():
            self._restart.clear()
            self.session.restart()
        if not self.pause.value:
            self.session.command = self._command()
            self.session.step()
        self.update()

    def ask(self, **changes: Any) -> None:
        """Note what of the choice shall change; the next `advance` does it."""
        with self._lock:
            self._wanted = replace(self._wanted or self.choice, **changes)

    def restart(self) -> None:
        """Note that the robot shall start anew; the next `advance` does it."""
        self._restart.set()

    def update(self) -> None:
        """Show the present state."""
        model, data = self._model, self._data
        data.qpos[:] = self.session.qpos(0)
        mujoco.mj_kinematics(model, data)
        with self.server.atomic():
            x, y, _ = data.xpos[self._base]
            self._world.position = (-float(x), -float(y), 0.0)
            for body, frame in self._frames.items():
                frame.position, frame.wxyz = data.xpos[body], data.xquat[body]
        if time.monotonic() - self._told > _INFO_PERIOD:
            self._told = time.monotonic()
            self._tell()

    def _tell(self) -> None:
        marks, reached = self.session.course(0)
        for index, (handle, mark) in enumerate(zip(self._marks, marks, strict=True)):
            handle.position = mark + ON_GROUND
            red, green, blue, _ = REACHED if index < reached else NEXT if index == reached else AHEAD
            handle.color = round(255 * red), round(255 * green), round(255 * blue)
        falls = int(self.session.falls[0])
        lines = [*self.session.caption(0), f"{falls} falls" if falls != 1 else "1 fall"]
        self._numbers.content = _html("<br>".join(escape(line) for line in lines))
        depth = self.session.depth(0)
        if depth is not None and self._depth is not None:
            self._depth.image = _gray(depth)

    def _show(self, wanted: Choice) -> None:
        """Replace robot, body, policy or level; what cannot be leaves all as it was."""
        try:
            self.session = wanted.start()
        except (ValueError, LookupError, OSError, CheckpointError) as error:
            self.message.content = _html(f'<span style="color:#b3261e">{escape(str(error))}</span>')
            return
        other = wanted.robot != self.choice.robot
        self.choice = wanted
        self.message.content = ""
        with self.server.atomic():
            self._world.remove()
            self._build_world()
        if other:
            self._build_design()

    def _build_world(self) -> None:
        scene = self.server.scene
        self._world = scene.add_frame(_WORLD, show_axes=False)
        self._model = self.session.env.sim.model_of(0)
        self._data = mujoco.MjData(self._model)
        self._base = int(self._model.jnt_bodyid[0])
        floor = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, "floor")
        scene.add_grid(
            f"{_WORLD}/floor",
            infinite_grid=True,
            cell_size=0.5,
            section_size=1.0,
            cell_color=(226, 229, 233),
            section_color=(196, 202, 210),
            plane_color=(247, 248, 250),
            plane_opacity=1.0,
            fade_distance=30.0,
            shadow_opacity=0.25,
            position=(0.0, 0.0, float(self._model.geom_pos[floor, 2])),
        )
        self._frames = {}
        for body, parts in surfaces(self._model).items():
            name = f"{_WORLD}/bodies/{self._model.body(body).name or body}"
            frame = scene.add_frame(name, show_axes=False)
            if body:
                self._frames[body] = frame
            for number, part in enumerate(parts):
                scene.add_mesh_simple(
                    f"{name}/{number}",
                    part.vertices,
                    part.faces,
                    color=part.color,
                    opacity=None if part.opacity == 1.0 else part.opacity,
                    flat_shading=True,
                )
        marks, _ = self.session.course(0)
        self._marks = [
            scene.add_icosphere(f"{_WORLD}/waypoint_{index}", radius=MARK_RADIUS, cast_shadow=False)
            for index in range(len(marks))
        ]

    def _build_panel(self, robots: Sequence[str]) -> None:
        gui, choice, task = self.server.gui, self.choice, self.session.env.task
        levels = choice.levels
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.set_panel_label(f"locorl: {task.name}")
        self.message = gui.add_html("")
        self._numbers = gui.add_html("")
        depth = self.session.depth(0)
        self._depth = None if depth is None else gui.add_image(_gray(depth), label="depth camera")
        self.pause = gui.add_checkbox("pause", initial_value=False)
        gui.add_button("restart").on_click(lambda _: self.restart())
        policy = gui.add_dropdown(
            "policy", list(dict.fromkeys((choice.policy, "stand", "random"))), initial_value=choice.policy
        )
        policy.on_update(lambda event: self.ask(policy=event.target.value))
        if levels > 1:
            level = gui.add_slider("level", 0, levels - 1, 1, choice.level, hint="Difficulty of the terrain")
            level.on_update(lambda event: self.ask(level=int(event.target.value)))
        self.sliders = []
        if self.session.env.goals is None:
            with gui.add_folder("Command"):
                bounds = task.command
                self.sliders = [
                    gui.add_slider(label, min(low, value), max(high, value, low + 0.1), 0.05, value)
                    for label, (low, high), value in zip(
                        ("forward [m/s]", "left [m/s]", "turn [rad/s]"),
                        (bounds.vx, bounds.vy, bounds.yaw_rate),
                        choice.command or (0.5, 0.0, 0.0),
                        strict=True,
                    )
                ]
        self._design_folder = gui.add_folder("Body")
        with self._design_folder:
            robot = gui.add_dropdown("robot", list(robots), initial_value=choice.robot)
            robot.on_update(lambda event: self.ask(robot=event.target.value, design=None))
            designs = gui.add_button_group("set to", ("Nominal", "Random"))
            designs.on_click(lambda event: self._set_design(event.target.value == "Random"))
        self._design: list[viser.GuiSliderHandle] = []
        self._build_design()

    def _build_design(self) -> None:
        for slider in self._design:
            slider.remove()
        space = self.session.env.factory.space
        bounds = (space.low.tolist(), space.high.tolist(), self.session.env.bodies.designs[0].tolist())
        with self._design_folder:
            self._design = [
                self.server.gui.add_slider(name.replace("_", " "), low, high, (high - low) / 100, value)
                for name, low, high, value in zip(space.names, *bounds, strict=True)
            ]
        for slider in self._design:
            slider.on_update(lambda _: self.ask(design=tuple(slider.value for slider in self._design)))

    def _set_design(self, random: bool) -> None:
        factory = self.session.env.factory
        design = sample_designs(factory, 1, self._random)[0] if random else factory.space.nominal
        for slider, value in zip(self._design, design.tolist(), strict=True):
            slider.value = value

    def _command(self) -> Command | None:
        """What the sliders ask for; without sliders, what was asked for at first."""
        if not self.sliders:
            return self.choice.command
        vx, vy, yaw_rate = (float(slider.value) for slider in self.sliders)
        return vx, vy, yaw_rate


def _gray(depth: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """As colours, and enlarged: browsers show small images in their own size."""
    times = max(1, _DEPTH_WIDTH // depth.shape[1])
    return np.repeat(depth.repeat(times, axis=0).repeat(times, axis=1)[:, :, None], 3, axis=2)


def _html(content: str) -> str:
    return f'<div style="padding:0.25em 1em;font-variant-numeric:tabular-nums">{content}</div>'
