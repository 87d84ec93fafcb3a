"""Pictures of a robot by MuJoCo's renderer, without a screen."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import os
import platform
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from locorl.interfaces import Array
from locorl.play.errors import PlayError

Frame = NDArray[np.uint8]

NEXT, AHEAD, REACHED = (0.95, 0.45, 0.1, 1.0), (0.2, 0.47, 0.75, 1.0), (0.55, 0.6, 0.65, 0.5)
"""Colours of the next waypoint, of those after it and of those behind."""
MARK_RADIUS = 0.04
"""Of the ball that lies on a waypoint, m."""
ON_GROUND = np.array((0.0, 0.0, MARK_RADIUS))
"""From a waypoint to the middle of its ball, m."""
_SUN = 4.0
"""Distance of the sun from the robot, m: the shadow map is centred below it."""
_VIEW = 8.0
"""Half-width of what casts shadows, m; its border is ragged and should lie out of sight."""
_HAZE = (0.90, 0.93, 0.96)
_CALM, _STEADY = 0.15, 1.0
"""Time constants with which the camera follows the robot's position and heading, s."""


_WAY_OUT = (
    "leave MUJOCO_GL unset and install EGL (Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri); "
    "`locorl play` without -o needs none"
)


def gl_context(width: int, height: int) -> Any:
    """An OpenGL context, made current; EGL on Linux, which needs no screen, unless MUJOCO_GL says otherwise.

    Raises:
        PlayError: there is no OpenGL here.
    """
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    try:
        # MuJoCo reads MUJOCO_GL when it is first imported, and without it wants a screen
        if platform.system() == "Linux" and chosen in ("", "egl"):
            from mujoco.egl import GLContext
        else:
            from mujoco.gl_context import GLContext
        context = GLContext(width, height)
        context.make_current()
    except (ImportError, AttributeError, RuntimeError, OSError) as error:
        raise PlayError(f"pictures need OpenGL, and there is none here ({error}): {_WAY_OUT}") from error
    return context


def render_context(model: mujoco.MjModel) -> mujoco.MjrContext:
    """MuJoCo's resources for drawing off the screen, in the present OpenGL context.

    Raises:
        PlayError: OpenGL does not work, as GLFW without a screen.
    """
    try:
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    except mujoco.FatalError as error:
        raise PlayError(f"pictures need OpenGL, and it does not work here: {_WAY_OUT}") from error
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
    return context


class RobotCamera:
    """Draws one robot in its world; the camera follows it from behind and to the right.

    Args:
        model: the robot's; its settings of the picture are changed.
        width: of the picture, px.
        height: of the picture, px.
        dt: time between two pictures, s.

    Raises:
        PlayError: there is no OpenGL.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, dt: float) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._base = int(model.jnt_bodyid[0])
        self._dt = dt
        settings = model.vis
        settings.global_.offwidth, settings.global_.offheight = width, height
        settings.global_.fovy = 40.0
        settings.quality.shadowsize = 4096 if height > 300 else 2048
        settings.headlight.ambient[:], settings.headlight.diffuse[:], settings.headlight.specular[:] = 0.42, 0.15, 0.0
        model.light_ambient[:], model.light_diffuse[:] = 0.0, 0.6
        # clipping and shadows are measured in extents, which a large terrain would make coarse
        model.stat.extent = 1.0
        settings.map.znear, settings.map.zfar = 0.05, 60.0
        settings.map.shadowclip = _VIEW
        settings.rgba.haze[:3] = _HAZE
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._camera.distance, self._camera.elevation = 1.9, -18.0
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
        # one for each camera: MuJoCo's contexts disturb each other within one
        self._gl = gl_context(width, height)
        self._context = render_context(model)
        self._heading: float | None = None

    def draw(self, qpos: Array, marks: Array, reached: int = 0) -> Frame:
        """Picture of the robot at `qpos` (19,), (height, width, 3).

        Args:
            qpos: generalised position.
            marks: waypoints, world, (k, 3), m.
            reached: how many of them lie behind.
        """
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        base = data.xpos[self._base]
        data.light_xpos[:] = base - _SUN * data.light_xdir
        self._follow(base, float(np.arctan2(data.xmat[self._base, 3], data.xmat[self._base, 0])))
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        # an endless plane is drawn around the camera as it was: without this the first picture has no ground
        mujoco.mjv_updateCamera(model, data, self._camera, self._scene)
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        for index, mark in enumerate(marks):
            self._add_ball(mark, REACHED if index < reached else NEXT if index == reached else AHEAD)
        self._gl.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._context)
        pixels = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._context)
        return pixels[::-1]

    def close(self) -> None:
        """Give back what the graphics driver holds."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def _follow(self, position: Array, yaw: float) -> None:
        camera = self._camera
        if self._heading is None or np.linalg.norm(position - camera.lookat) > 1.0:  # placed elsewhere
            self._heading = yaw
            camera.lookat[:] = position
        turn = (yaw - self._heading + np.pi) % (2 * np.pi) - np.pi
        self._heading += turn * min(1.0, self._dt / _STEADY)
        camera.lookat[:] += (position - camera.lookat) * min(1.0, self._dt / _CALM)
        camera.azimuth = np.degrees(self._heading) + 35.0

    def _add_ball(self, position: Array, color: tuple[float, float, float, float]) -> None:
        if self._scene.ngeom >= self._scene.maxgeom:
            return
        ball, size = self._scene.geoms[self._scene.ngeom], np.full(3, MARK_RADIUS)
        rotation, rgba = np.eye(3).ravel(), np.array(color, np.float32)
        mujoco.mjv_initGeom(ball, mujoco.mjtGeom.mjGEOM_SPHERE, size, position + ON_GROUND, rotation, rgba)
        self._scene.ngeom += 1
