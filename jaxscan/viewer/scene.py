"""The scene that all browsers share: clouds, style, picks and measurements. Any thread may call."""

import threading
from collections.abc import Callable, Sequence

import numpy as np
import viser

from jaxscan.geometry import Scanner
from jaxscan.viewer.colours import Colouring, Scale
from jaxscan.viewer.measuring import (
    Kind,
    Measured,
    measure_between,
    measure_flatness,
    measure_point,
    measure_sides,
    said,
)
from jaxscan.viewer.picking import pick
from jaxscan.viewer.shown import Section, ShownCloud
from jaxscan.viewer.stage import Stage, Style


BUDGET = 400_000
"""Points shown at rest, at most, until a person chooses."""
_CONE_PX = 8.0
"""A click means a point within so many pixels."""
_APART = 1.2
"""Distance of clouds side by side, as a multiple of their width."""
_MARK = (255, 140, 0)


class Scene:
    """Clouds and what is measured in them; calls `changed` after each change of the list or of a message."""

    def __init__(
        self, server: viser.ViserServer, clouds: Sequence[ShownCloud], scanner: Scanner | None
    ) -> None:
        """Show clouds.

        Args:
            server: The drawing server.
            clouds: One or more, with the same origin.
            scanner: With which they were made, for the systematic part of sigma.
        """
        self._server, self.clouds, self._scanner = server, list(clouds), scanner
        self.style = Style([], BUDGET)
        self.kind: Kind = "point"
        """What the next click measures."""
        self.measured: list[Measured] = []
        self.message = ""
        self.changed: Callable[[], None] = lambda: None
        self.scale: Scale | None = None
        self._by: Colouring = "photograph"
        self._stages: dict[int, Stage] = {}
        self._first: tuple[ShownCloud, np.ndarray] | None = None
        """The first place of a distance."""
        self._lock = threading.RLock()
        self.colour("photograph")
        low, high = self.bounds()
        self._stand(server.initial_camera, low, high)
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._go)
        server.scene.on_click()(self._clicked)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the visible clouds without their outermost hundredth, in the scene's frame."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for cloud in [cloud for cloud in self.clouds if cloud.visible] or self.clouds:
            some = cloud.xyz[:: max(1, cloud.points // 50_000)]
            ends = np.percentile(some, [1, 99], axis=0) + cloud.shift
            low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
        return low, high

    def colour(self, by: Colouring) -> None:
        """Choose what the colours show."""
        with self._lock:
            self._by = by
            planes = [one for one in self.measured if one.plane is not None]
            plane = planes[-1].plane if planes else None
            self.message = ""
            if by == "deviation" and plane is None:
                self.message = "Measure the flatness of a place first: deviations are those from its plane."
            elif not any(cloud.has(by) for cloud in self.clouds):
                self.message = f"The cloud has no {by}."
            found = [cloud.coloured(by, plane=plane) for cloud in self.clouds]
            self.style.colours = [colours for colours, _ in found]
            self.scale = next((scale for _, scale in found if scale is not None), None)
            self._restyle()

    def choose(self, kind: Kind) -> None:
        """Choose what clicks measure."""
        with self._lock:
            self.kind, self._first, self.message = kind, None, ""
            self._mark_first(None)
            self.changed()

    def limit(self, section: Section | None) -> None:
        """Show only what is within a box."""
        with self._lock:
            self.style.section = section
            self._restyle()

    def draw(self, *, budget: int | None = None, size: float | None = None) -> None:
        """Choose how many points are shown at rest, and how large."""
        with self._lock:
            self.style.budget = budget or self.style.budget
            self.style.size = size or self.style.size
            self._restyle()

    def show(self, number: int, visible: bool) -> None:
        """Show or hide a cloud."""
        with self._lock:
            self.clouds[number].visible = visible
            self._refresh()

    def spread(self, apart: bool) -> None:
        """Put the clouds side by side, or where they are."""
        with self._lock:
            place = 0.0
            for cloud in self.clouds:
                cloud.shift = np.zeros(3)
                if apart:
                    cloud.shift[0] = place
                    place += _APART * float(np.ptp(cloud.xyz[:, 0]))
            self._restyle()

    def look_from(self, client: viser.ClientHandle, where: str) -> None:
        """Move a browser's camera: "above", "outside", or "station 1"."""
        low, high = self.bounds()
        if not where.startswith("station"):
            return self._stand(client.camera, low, high, above=where == "above")
        stations = [cloud.stations() + cloud.shift for cloud in self.clouds]
        place = np.concatenate(stations)[int(where.split()[1]) - 1]
        client.camera.position, client.camera.look_at = place, place + np.array([1.0, 0.0, 0.0])

    def measure_room(self) -> None:
        """Length, width and height of the first visible cloud."""
        with self._lock:
            cloud = next((cloud for cloud in self.clouds if cloud.visible), self.clouds[0])
            sides: list[Measured] = []

            def work() -> Measured:
                sides.extend(measure_sides(cloud, self._scanner))
                return sides[0]

            found = said(work)
            self.message = found if isinstance(found, str) else ""
            self.measured += sides
            self.changed()

    def undo(self) -> None:
        """Take back the first place of a distance, or the last measurement."""
        with self._lock:
            if self._first is not None:
                self._first = None
                self._mark_first(None)
            elif self.measured:
                self.measured.pop()
                self._server.scene.remove_by_name(f"/measured/{len(self.measured)}")
            self.message = ""
            self.changed()

    def click(self, origin: np.ndarray, direction: np.ndarray, cone_rad: float) -> None:
        """Measure where a ray meets a visible cloud, in the scene's frame."""
        with self._lock:
            hits = []
            for cloud in self.clouds:
                if not cloud.visible:
                    continue
                section = self.style.section
                shown = None if section is None else section.holds(cloud.xyz)
                index = pick(cloud.xyz, origin - cloud.shift, direction, cone_rad=cone_rad, shown=shown)
                if index is not None:
                    away = float(np.linalg.norm(cloud.xyz[index] + cloud.shift - origin))
                    hits.append((away, cloud, index))
            if not hits:
                self.message = "There is no point: click on the cloud."
                return self.changed()
            _, cloud, index = min(hits, key=lambda hit: hit[0])
            self._measure(cloud, index)
            self.changed()

    def _measure(self, cloud: ShownCloud, index: int) -> None:
        picked = measure_point(cloud, index)
        place, found = picked.at[0], None
        if self.kind == "point":
            found = said(lambda: picked)
        elif self.kind == "flatness":
            found = said(lambda: measure_flatness(cloud, place))
        elif self._first is None or self._first[0] is not cloud:
            self._first = (cloud, place)
            self._mark_first(place - cloud.origin + cloud.shift)
            self.message = "Now the other place, in the same cloud."
            return
        else:
            first = self._first[1]
            self._first = None
            self._mark_first(None)
            found = said(lambda: measure_between(cloud, first, place, self._scanner))
        if isinstance(found, str):
            self.message = found
            return
        self.message = ""
        self._mark(len(self.measured), found, found.at - cloud.origin + cloud.shift)
        self.measured.append(found)

    def _mark(self, number: int, found: Measured, at: np.ndarray) -> None:
        scene, name = self._server.scene, f"/measured/{number}"
        scene.add_frame(name, show_axes=False)
        for end, place in enumerate(at):
            scene.add_icosphere(f"{name}/{end}", 0.02, _MARK, subdivisions=2, position=place)
        if len(at) == 2:
            scene.add_line_segments(f"{name}/line", at[None].astype(np.float32), colors=_MARK, line_width=3.0)
        scene.add_label(f"{name}/label", f"{number + 1}: {found.words[0].split(', ')[0]}", position=at.mean(0))

    def _mark_first(self, at: np.ndarray | None) -> None:
        name = "/first"
        self._server.scene.remove_by_name(name)
        if at is not None:
            self._server.scene.add_icosphere(name, 0.02, _MARK, subdivisions=2, position=at)

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        camera = event.client.camera
        cone = _CONE_PX * 2 * np.tan(0.5 * camera.fov) / max(camera.image_height, 1)
        self.click(np.array(event.ray_origin), np.array(event.ray_direction), float(np.arctan(cone)))

    def _come(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._stages[client.client_id] = Stage(client, self.clouds, self.style)

    def _go(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if (stage := self._stages.pop(client.client_id, None)) is not None:
                stage.end()

    def _restyle(self) -> None:
        self.style.version += 1
        self._refresh()

    def _refresh(self) -> None:
        for stage in self._stages.values():
            stage.refresh()
        self.changed()

    def _stand(
        self,
        camera: viser.CameraHandle | viser.InitialCameraConfig,
        low: np.ndarray,
        high: np.ndarray,
        *,
        above: bool = False,
    ) -> None:
        """Look at a box from outside: half from above, or from right above."""
        middle, wide = 0.5 * (low + high), float(np.linalg.norm(high - low))
        away = np.array([0.0, -0.02, 0.75]) if above else np.array([0.4, -0.48, 0.42])
        camera.position = middle + wide * away
        camera.look_at = middle
