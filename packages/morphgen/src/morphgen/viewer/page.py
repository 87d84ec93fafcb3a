"""The viewer's page: the picture of a design in a viser scene, with sliders and buttons beside it."""

from __future__ import annotations

import threading

import numpy as np
import viser
from numpy.typing import NDArray

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.simulation.mjcf import to_mjcf
from morphgen.viewer import text
from morphgen.viewer.picture import Picture, Solid, picture

_STEPS = 50
"""Least number of steps of a slider."""
_GHOST_COLOR = (120, 130, 145)
_RESET, _RANDOM = "Nominal", "Random"
_URDF, _MJCF = "URDF", "MJCF"


class Page:
    """Shows one robot on a viser server; all browsers connected to it see the same body.

    Callbacks of the page only note that something changed. `update` redraws, so a fast drag is drawn as often
    as the machine can and never out of order.
    """

    def __init__(self, server: viser.ViserServer, factory: BodyFactory, seed: int | None = None) -> None:
        """Fill the page with the nominal body.

        Args:
            server: a fresh server.
            factory: makes the bodies.
            seed: of the random designs; None for other ones at every start.
        """
        self._server = server
        self._factory = factory
        self._random = np.random.default_rng(seed)
        self._changed = threading.Event()
        self._nominal = self._shown = picture(factory, factory.space.nominal)
        self._body: dict[str, viser.MeshHandle] = {}
        self._build_scene()
        self._build_panel()
        self._draw(self._shown)

    @property
    def shown(self) -> Picture:
        """The body on the page."""
        return self._shown

    @property
    def design(self) -> NDArray[np.float64]:
        """(d,) where the sliders are."""
        values = np.array([slider.value for slider in self._sliders])
        return np.clip(values, self._factory.space.low, self._factory.space.high)

    def run(self) -> None:
        """Redraw whenever a slider moves; does not return."""
        while True:
            # a wait without end cannot be interrupted on every system
            if self._changed.wait(timeout=0.5):
                self.update()

    def update(self) -> None:
        """Show the body of the sliders; says so in place of the verdict if there is none."""
        self._changed.clear()
        try:
            shown = picture(self._factory, self.design)
        except MorphologyError as error:
            self._verdict.content = text.failure(str(error))
            return
        self._shown = shown
        with self._server.atomic():
            self._draw(shown)

    def _build_scene(self) -> None:
        server, size = self._server, self._nominal.size
        server.scene.add_grid(
            "/floor",
            infinite_grid=True,
            cell_size=0.1,
            section_size=0.5,
            cell_color=(222, 226, 230),
            section_color=(190, 196, 204),
            plane_color=(246, 247, 249),
            plane_opacity=1.0,
            fade_distance=12 * size,
            shadow_opacity=0.25,
        )
        server.scene.configure_environment_map("studio", environment_intensity=0.6)
        server.initial_camera.position = (1.5 * size, -2.1 * size, 1.0 * size)
        server.initial_camera.look_at = (0.0, 0.0, 0.3 * size)
        server.initial_camera.fov = np.radians(38)
        self._ghost = server.scene.add_frame("/nominal", show_axes=False, visible=False)
        for solid in self._nominal.solids:
            _add(server, f"/nominal/{solid.name}", solid, color=_GHOST_COLOR, opacity=0.3)

    def _build_panel(self) -> None:
        gui, space = self._server.gui, self._factory.space
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False, brand_color=(51, 120, 191))
        gui.set_panel_label(f"morphgen: {self._factory.name}")
        self._verdict = gui.add_html("")
        with gui.add_folder("Design"):
            self._sliders = [
                gui.add_slider(name.replace("_", " "), low, high, _step(low, high), nominal)
                for name, low, high, nominal in zip(
                    space.names, space.low.tolist(), space.high.tolist(), space.nominal.tolist(), strict=True
                )
            ]
            choice = gui.add_button_group("set to", (_RESET, _RANDOM))
            ghost = gui.add_checkbox("nominal ghost", initial_value=False, hint="Show the nominal body behind this one")
        with gui.add_folder("Dimensions"):
            self._measurements = gui.add_html("")
        download = gui.add_button_group("download", (_URDF, _MJCF))

        for slider in self._sliders:
            slider.on_update(lambda _: self._changed.set())
        choice.on_click(lambda event: self._set(event.target.value))
        ghost.on_update(lambda event: setattr(self._ghost, "visible", event.target.value))
        download.on_click(self._download)

    def _set(self, choice: str) -> None:
        space = self._factory.space
        design = space.nominal if choice == _RESET else self._random.uniform(space.low, space.high)
        for slider, value in zip(self._sliders, design.tolist(), strict=True):
            slider.value = value

    def _download(self, event: viser.GuiEvent[viser.GuiButtonGroupHandle[str]]) -> None:
        assert event.client is not None
        name, design = self._factory.name, self._shown.design
        if event.target.value == _URDF:
            file, content = f"{name}.urdf", self._factory.urdf(design)
        else:
            file, content = f"{name}.xml", to_mjcf(self._factory.spec(design))
        event.client.send_file_download(file, content.encode(), save_immediately=True)

    def _draw(self, shown: Picture) -> None:
        self._verdict.content = text.verdict(shown)
        self._measurements.content = text.measurements(shown, self._nominal)
        for solid in shown.solids:
            handle = self._body.get(solid.name)
            if handle is None:
                color = tuple(round(255 * float(channel)) for channel in solid.color)
                self._body[solid.name] = _add(self._server, f"/body/{solid.name}", solid, color=color)
                continue
            # a surface is much to send, a pose and a scale are not
            if not np.array_equal(handle.vertices, solid.vertices.astype(np.float32)):
                handle.vertices = solid.vertices.astype(np.float32)
            handle.position, handle.wxyz = solid.position, solid.wxyz
            handle.scale = _triple(solid.scale)


def _add(
    server: viser.ViserServer, path: str, solid: Solid, *, color: tuple[int, ...], opacity: float | None = None
) -> viser.MeshHandle:
    return server.scene.add_mesh_simple(
        path,
        solid.vertices,
        solid.faces,
        color=color,
        opacity=opacity,
        flat_shading=not solid.round,
        scale=_triple(solid.scale),
        position=solid.position,
        wxyz=solid.wxyz,
        cast_shadow=opacity is None,
    )


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _step(low: float, high: float) -> float:
    """The power of ten that divides a slider's range into at least `_STEPS` steps."""
    return 10.0 ** np.floor(np.log10((high - low) / _STEPS)) if high > low else 1.0
