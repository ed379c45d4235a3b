"""The panel beside the cloud: what can be chosen, and what was measured."""

import numpy as np
import viser

from jaxscan.printable import printable
from jaxscan.viewer.colours import COLOURINGS
from jaxscan.viewer.measuring import KINDS, as_csv, as_json
from jaxscan.viewer.scene import BUDGET, Scene
from jaxscan.viewer.shown import Section


_SAYS = {
    "point": "Click a point.",
    "distance": "Click two places: each is averaged over 20 mm, as `jaxscan measure distance` does.",
    "flatness": "Click a flat place: its plane within 200 mm, as `jaxscan measure plane` does.",
}
_NO_SCANNER = "sigma covers the noise of the points only; with `--calibration` it also covers the calibration."
_STATIONS = 20
"""Places that are listed, at most."""
_LEGEND = "white is the plane, red is on its side towards the scanner"


class Panel:
    """The controls; they belong to all browsers."""

    def __init__(self, server: viser.ViserServer, scene: Scene, *, systematic: bool) -> None:
        """Add the controls.

        Args:
            server: The drawing server.
            scene: What they change.
            systematic: Whether sigma covers the calibration.
        """
        self._server, self._scene, gui = server, scene, server.gui
        gui.set_panel_label("jaxscan")
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium", dark_mode=True)
        with gui.add_folder("Measure"):
            kind = gui.add_button_group("click for a", KINDS)
            self._says = gui.add_markdown(_SAYS[scene.kind])
            self._list = gui.add_markdown("")
            room = gui.add_button("The room's lengths", hint="as `jaxscan measure room`")
            undo = gui.add_button("Undo", hint="key U")
            save = gui.add_button_group("Save as", ("CSV", "JSON"))
            if not systematic:
                gui.add_markdown(_NO_SCANNER)
        with gui.add_folder("Colours"):
            known = [by for by in COLOURINGS if by == "deviation" or any(cloud.has(by) for cloud in scene.clouds)]
            by = gui.add_dropdown("show", known)
            self._bar = gui.add_image(np.zeros((16, 256, 3), np.uint8), visible=False)
            self._legend = gui.add_markdown("", visible=False)
        with gui.add_folder("View from"):
            self._places()
        self._section(server)
        if len(scene.clouds) > 1:
            self._clouds()
        with gui.add_folder("Points", expand_by_default=False):
            budget = gui.add_slider("thousands", 50, 5000, 50, BUDGET // 1000, hint="shown at rest, at most")
            size = gui.add_slider("size", 0.2, 4.0, 0.1, 1.0)
        kind.on_click(lambda event: scene.choose(event.target.value))
        room.on_click(lambda event: scene.measure_room())
        undo.on_click(lambda event: scene.undo())
        save.on_click(self._save)
        by.on_update(lambda event: scene.colour(event.target.value))
        budget.on_update(lambda event: scene.draw(budget=1000 * event.target.value))
        size.on_update(lambda event: scene.draw(size=event.target.value))
        for name, key in (("point", "P"), ("distance", "D"), ("flatness", "F")):
            command = gui.add_command(f"Measure a {name}", hotkey=key)
            command.on_trigger(lambda event, name=name: scene.choose(name))
        gui.add_command("Undo the last measurement", hotkey="U").on_trigger(lambda event: scene.undo())
        scene.changed = self.tell
        self.tell()

    def tell(self) -> None:
        """Show what was measured, and what the colours mean."""
        scene = self._scene
        self._says.content = f"**{scene.kind}**: {printable(scene.message) or _SAYS[scene.kind]}"
        rows = [f"{number}. {'; '.join(one.words)}" for number, one in enumerate(scene.measured, 1)]
        self._list.content = "\n".join(rows)
        scale = scene.scale
        self._bar.visible = self._legend.visible = scale is not None
        if scale is not None:
            self._bar.image = scale.bar()
            self._legend.content = f"{scale.words()}{'; ' + _LEGEND if scale.diverging else ''}"

    def _places(self) -> None:
        gui, scene = self._server.gui, self._scene
        stations = sum(len(cloud.stations()) for cloud in scene.clouds)
        names = ["outside", "above", *(f"station {k + 1}" for k in range(min(stations, _STATIONS)))]
        places = gui.add_button_group("", names)

        def go(event: viser.GuiEvent) -> None:
            if event.client is not None:
                scene.look_from(event.client, event.target.value)

        places.on_click(go)
        for name, key in (("outside", "O"), ("above", "A"), ("station 1", "S")):

            def come(event: viser.CommandEvent, name: str = name) -> None:
                if event.client is not None:
                    scene.look_from(event.client, name)

            gui.add_command(f"View from {name}", hotkey=key).on_trigger(come)

    def _section(self, server: viser.ViserServer) -> None:
        """A box that is dragged by its middle, and as large as three sliders say."""
        scene, gui = self._scene, server.gui
        low, high = scene.bounds()
        middle, whole = 0.5 * (low + high), np.maximum(high - low, 0.1)
        with gui.add_folder("Section", expand_by_default=False):
            used = gui.add_checkbox("only what is in the box", False)
            sizes = [
                gui.add_slider(f"{axis} [m]", 0.05, round(1.2 * float(most), 2), 0.01, round(float(most), 2))
                for axis, most in zip("xyz", whole, strict=True)
            ]
        handle = server.scene.add_transform_controls(
            "/section", scale=0.6, disable_rotations=True, position=middle, visible=False
        )
        box = server.scene.add_box("/section/box", (255, 200, 0), whole, wireframe=True, cast_shadow=False)

        def change() -> None:
            handle.visible = used.value
            extent = np.array([size.value for size in sizes])
            box.dimensions = extent
            place = np.array(handle.position)
            scene.limit(Section(place - extent / 2, place + extent / 2) if used.value else None)

        used.on_update(lambda event: change())
        for size in sizes:
            size.on_update(lambda event: change())
        handle.on_update(lambda event: change() if event.phase == "end" else None)

    def _clouds(self) -> None:
        gui, scene = self._server.gui, self._scene
        with gui.add_folder("Clouds"):
            for number, cloud in enumerate(scene.clouds):
                shown = gui.add_checkbox(printable(cloud.name), True)
                shown.on_update(lambda event, number=number: scene.show(number, event.target.value))
            apart = gui.add_checkbox("side by side", False)
        apart.on_update(lambda event: scene.spread(event.target.value))

    def _save(self, event: viser.GuiEvent) -> None:
        if event.client is None:
            return
        kind = str(event.target.value)
        data = as_csv(self._scene.measured) if kind == "CSV" else as_json(self._scene.measured)
        event.client.send_file_download(f"measured.{kind.lower()}", data, save_immediately=True)
