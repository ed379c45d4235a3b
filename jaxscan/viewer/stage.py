"""What one browser shows: the chunks that its view needs, coarse while it moves and fine when it rests."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import viser

from jaxscan.viewer.levels import chosen
from jaxscan.viewer.shown import Section, ShownCloud


MOVING = 150_000
"""Points shown while the view moves, at most."""
_REST_S = 0.25
"""So long without a motion, the view rests."""
_LOOK_S = 0.1
"""Between two looks at a view that moves."""
_KEPT = 3
"""Points that a browser keeps, as a multiple of those that it shows."""


@dataclass
class Style:
    """How all browsers show the clouds; `colours` has one array for each cloud."""

    colours: list[np.ndarray]
    budget: int
    """Points shown at rest, at most."""
    size: float = 1.0
    """Of points, as a multiple of their spacing."""
    section: Section | None = None
    version: int = 0
    """Counts what makes the points that were sent wrong."""
    lock: threading.Lock = field(default_factory=threading.Lock)


_Key = tuple[int, int]
"""A cloud, and one of its chunks."""


class Stage:
    """The points in one browser; a thread follows its camera."""

    def __init__(self, client: viser.ClientHandle, clouds: Sequence[ShownCloud], style: Style) -> None:
        self._client, self._clouds, self._style = client, clouds, style
        self._sent: dict[_Key, viser.PointCloudHandle | None] = {}
        """None: nothing of the chunk is within the section."""
        self._seen: set[_Key] = set()
        self._version = style.version
        self._moved_at = 0.0
        self._wake = threading.Event()
        self._wake.set()
        self._ended = False
        self._frames = [
            client.scene.add_frame(f"/clouds/{k}", show_axes=False, position=cloud.shift)
            for k, cloud in enumerate(clouds)
        ]
        client.camera.on_update(lambda camera: self._moved())
        self._thread = threading.Thread(target=self._follow, name="jaxscan-stage", daemon=True)
        self._thread.start()

    def refresh(self) -> None:
        """Show what has changed."""
        self._wake.set()

    def end(self) -> None:
        """The browser has gone."""
        self._ended = True
        self._wake.set()

    @property
    def points(self) -> int:
        """How many are shown now."""
        return sum(self._size(key) for key in self._seen)

    def _moved(self) -> None:
        self._moved_at = time.monotonic()
        self._wake.set()

    @property
    def _moves(self) -> bool:
        return time.monotonic() - self._moved_at < _REST_S

    def _follow(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            while self._moves and not self._ended:
                self._show(min(MOVING, self._style.budget), send=False)
                time.sleep(_LOOK_S)
            if self._ended:
                return
            self._show(self._style.budget, send=True)

    def _show(self, budget: int, *, send: bool) -> None:
        style = self._style
        if self._version != style.version:
            self._version = style.version
            self._forget(list(self._sent))
        for frame, cloud in zip(self._frames, self._clouds, strict=True):
            if not np.array_equal(frame.position, cloud.shift):
                frame.position = cloud.shift
        wanted = self._wanted(budget)
        for key in self._seen - set(wanted):
            self._see(key, False)
        for key in wanted:
            if key not in self._sent:
                if not send:
                    continue
                self._send(key)
            self._see(key, True)
            if send and (self._ended or self._wake.is_set()):
                return
        self._fit_sizes()
        kept = sum(self._size(key) for key in self._sent)
        hidden = [key for key in self._sent if key not in self._seen]
        while hidden and kept > _KEPT * style.budget:
            kept -= self._size(hidden[0])
            self._forget([hidden.pop(0)])

    def _wanted(self, budget: int) -> list[_Key]:
        """The chunks that the view needs, the most needed first."""
        camera = self._client.camera
        forward = viser.transforms.SO3(camera.wxyz).apply(np.array([0.0, 0.0, 1.0]))
        focal_px = 0.5 * max(camera.image_height, 1) / np.tan(0.5 * camera.fov)
        half = float(np.arctan(np.tan(0.5 * camera.fov) * np.hypot(1.0, camera.aspect)))
        visible = [k for k, cloud in enumerate(self._clouds) if cloud.visible]
        keys = []
        for k in visible:
            cloud = self._clouds[k]
            indices = chosen(
                cloud.levels.chunks,
                eye=camera.position - cloud.shift,
                forward=forward,
                half_view_rad=half,
                focal_px=focal_px,
                budget=budget // len(visible),
            )
            keys += [(k, index) for index in indices]
        return keys

    def _send(self, key: _Key) -> None:
        k, index = key
        chunk, cloud, style = self._clouds[k].levels.chunks[index], self._clouds[k], self._style
        xyz, colours = cloud.xyz[chunk.start : chunk.stop], style.colours[k][chunk.start : chunk.stop]
        if style.section is not None:
            inside = style.section.holds(xyz)
            xyz, colours = xyz[inside], colours[inside]
        self._sent[key] = None
        if not len(xyz):
            return
        # Numbers from the middle of the tile lose nothing by their size.
        middle = chunk.centre.astype(np.float32)
        self._sent[key] = self._client.scene.add_point_cloud(
            f"/clouds/{k}/{index}",
            xyz - middle,
            colours,
            position=middle,
            point_size=style.size * chunk.spacing,
            precision="float32",
            point_shape="circle",
            point_shading="flat",
        )

    def _see(self, key: _Key, visible: bool) -> None:
        handle = self._sent.get(key)
        if handle is not None and handle.visible is not visible:
            handle.visible = visible
        (self._seen.add if visible else self._seen.discard)(key)

    def _fit_sizes(self) -> None:
        """Points of a tile are as large as their finest neighbours are apart, so that coarse ones hide no fine ones."""
        finest: dict[tuple[int, int], float] = {}
        for k, index in self._seen:
            chunk = self._clouds[k].levels.chunks[index]
            finest[k, chunk.tile] = min(chunk.spacing, finest.get((k, chunk.tile), np.inf))
        for k, index in self._seen:
            handle = self._sent.get((k, index))
            size = self._style.size * finest[k, self._clouds[k].levels.chunks[index].tile]
            if handle is not None and abs(handle.point_size - size) > 1e-6 * size:
                handle.point_size = size

    def _forget(self, keys: list[_Key]) -> None:
        for key in keys:
            handle = self._sent.pop(key)
            self._seen.discard(key)
            if handle is not None:
                handle.remove()

    def _size(self, key: _Key) -> int:
        chunk = self._clouds[key[0]].levels.chunks[key[1]]
        return 0 if self._sent.get(key) is None else chunk.stop - chunk.start
