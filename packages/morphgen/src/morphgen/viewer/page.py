"""The viewer's page: the picture of a design in a viser scene, with sliders and buttons beside it."""

from __future__ import annotations

import threading

import numpy as np
import trimesh
import viser

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.palette import PALETTE
from morphgen.scaling.design import PARAMETERS
from morphgen.skeleton import Array
from morphgen.viewer import text
from morphgen.viewer.files import mjcf_file, urdf_file
from morphgen.viewer.picture import Picture, Pictures, Solid
from morphgen.views.gltf import to_glb

_STEPS = 50
"""Least number of steps of a slider."""
_GHOST_COLOR, _GHOST_OPACITY = (232, 140, 60), 0.35
_GHOST_SCALE = 0.985
"""So that the ghost hides in what it shares with the body."""
_FAILED = 5000
"""How long a message stays [ms]."""


class Page:
    """Shows one robot on a viser server; all browsers connected to it see the same body.

    The page's callbacks only note that something changed; `update` redraws. So a fast drag is drawn as often as
    the machine can, and never out of order.
    """

    def __init__(self, server: viser.ViserServer, factory: BodyFactory) -> None:
        """Fill the page with the nominal body.

        Args:
            server: a fresh server.
            factory: makes the bodies.
        """
        self._server = server
        self._factory = factory
        self._random = np.random.default_rng()
        self._changed = threading.Event()
        self._pictures = Pictures(factory)
        self._shown = self._pictures.nominal
        self._meshes: dict[str, trimesh.Trimesh] = {}
        self._body: dict[str, viser.GlbHandle] = {}
        self._ghost: list[viser.MeshHandle] = []
        self._build_scene()
        self._build_panel()
        self._draw(self._shown)

    @property
    def shown(self) -> Picture:
        """The body on the page."""
        return self._shown

    def run(self) -> None:
        """Redraw whenever a slider moves; does not return."""
        while True:
            # a wait without end cannot be interrupted on every system
            if self._changed.wait(timeout=0.5):
                self.update()

    def update(self) -> None:
        """Show the body of the sliders, or say that there is none."""
        self._changed.clear()
        values = [slider.value for slider in self._sliders]
        try:
            # the browser rounds what is typed
            shown = self._pictures.of(np.clip(values, self._factory.space.low, self._factory.space.high))
        except MorphologyError as error:
            self._verdict.content = text.failure(str(error))
            return
        self._shown = shown
        with self._server.atomic():
            self._draw(shown)

    def _build_scene(self) -> None:
        server = self._server
        size = max(float(np.linalg.norm(solid.position)) for solid in self._shown.solids)
        server.scene.add_grid(
            "/floor",
            infinite_grid=True,
            cell_size=0.1,
            section_size=0.5,
            cell_color=(226, 229, 233),
            section_color=(196, 202, 210),
            plane_color=(247, 248, 250),
            plane_opacity=1.0,
            fade_distance=12 * size,
            shadow_opacity=0.25,
        )
        server.scene.configure_environment_map("studio", environment_intensity=0.35)
        server.initial_camera.position = (2.2 * size, -2.9 * size, 1.4 * size)
        # the panel covers the right of the page
        server.initial_camera.look_at = (0.24 * size, 0.2 * size, 0.37 * size)
        server.initial_camera.fov = np.radians(35)

    def _build_panel(self) -> None:
        gui, space = self._server.gui, self._factory.space
        gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, brand_color=PALETTE["shank"][:3]
        )
        gui.set_panel_label(f"morphgen: {self._factory.name}")
        self._verdict = gui.add_html("")
        with gui.add_folder("Design"):
            self._sliders = [
                gui.add_slider(name.replace("_", " "), low, high, _step(low, high), nominal, hint=PARAMETERS[name])
                for name, low, high, nominal in zip(
                    space.names, space.low.tolist(), space.high.tolist(), space.nominal.tolist(), strict=True
                )
            ]
            designs = gui.add_button_group("set to", ("Nominal", "Random"))
            ghost = gui.add_checkbox("nominal ghost", initial_value=False, hint="Show the nominal body behind this one")
        with gui.add_folder("Dimensions"):
            self._measurements = gui.add_html("")
        files = gui.add_button_group("download", ("URDF", "MJCF"))

        for slider in self._sliders:
            slider.on_update(lambda _: self._changed.set())
        designs.on_click(lambda event: self._set_design(event.target.value == "Random"))
        ghost.on_update(lambda event: self._show_ghost(event.target.value))
        files.on_click(self._download)

    def _set_design(self, random: bool) -> None:
        space = self._factory.space
        design = space.sample(1, self._random)[0] if random else space.nominal
        for slider, value in zip(self._sliders, design.tolist(), strict=True):
            slider.value = value

    def _show_ghost(self, visible: bool) -> None:
        for handle in self._ghost:
            handle.remove()
        self._ghost = [
            self._server.scene.add_mesh_simple(
                f"/nominal/{solid.name}",
                solid.mesh.vertices,
                solid.mesh.faces,
                color=_GHOST_COLOR,
                opacity=_GHOST_OPACITY,
                flat_shading=True,
                scale=_GHOST_SCALE,
                position=solid.position,
                wxyz=solid.wxyz,
                cast_shadow=False,
            )
            for solid in self._pictures.nominal.solids
            if visible
        ]

    def _download(self, event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
        assert event.client is not None
        make = urdf_file if event.target.value == "URDF" else mjcf_file
        try:
            name, content = make(self._factory, self._shown.design)
        except (MorphologyError, OSError) as error:
            event.client.add_notification("No file", str(error), auto_close_seconds=_FAILED / 1000)
            return
        event.client.send_file_download(name, content, save_immediately=True)

    def _draw(self, shown: Picture) -> None:
        self._verdict.content = text.verdict(shown)
        self._measurements.content = text.measurements(shown, self._pictures.nominal)
        for solid in shown.solids:
            # a surface is much to send, a pose and a scale are not
            if self._meshes.get(solid.name) is not solid.mesh:
                self._meshes[solid.name] = solid.mesh
                self._body[solid.name] = self._server.scene.add_glb(f"/body/{solid.name}", to_glb(solid.mesh))
            _place(self._body[solid.name], solid)


def _place(handle: viser.GlbHandle, solid: Solid) -> None:
    handle.position, handle.wxyz, handle.scale = solid.position, solid.wxyz, _triple(solid.scale)


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _step(low: float, high: float) -> float:
    """The power of ten that divides a slider's range into at least `_STEPS` steps."""
    return 10.0 ** np.floor(np.log10((high - low) / _STEPS)) if high > low else 1.0
