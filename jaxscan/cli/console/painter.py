"""Draws what the camera sees, in a thread: the picture as JPEG, the stripe in it, its level."""

import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxscan.cli.boards import line_finder
from jaxscan.cli.console.outliving import outlived
from jaxscan.cli.console.slate import Slate
from jaxscan.vision import encode_jpeg, to_grey


if TYPE_CHECKING:
    from scanrig.config import RigConfig

WIDTH = 960
"""Widest picture that a page gets [px]."""
_QUALITY = 80
_POINTS = 256
"""Points of the stripe that a page gets."""
_BINS = 64
"""Of the histogram of levels: four of 256 levels each."""
_BETWEEN_S = 0.25
"""Least time between two pictures."""


class Seen(NamedTuple):
    """Frames to show."""

    on: np.ndarray | None
    """Laser-on frame, or None."""
    off: np.ndarray
    laser: int
    facts: Mapping[str, Any]
    """Shown beside the picture."""


class Painter:
    """Shows the newest frames on the slate, and drops those that come too fast; within `with`."""

    def __init__(self, rig: "RigConfig", slate: Slate) -> None:
        """Prepare for the frames of a rig."""
        self._rig, self._slate = rig, slate
        self._newest: Seen | None = None
        self._come, self._end = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._paint, name="jaxscan-painter", daemon=True)

    def __enter__(self) -> "Painter":
        self._rehearse()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._come.set()
        self._thread.join()

    def show(self, seen: Seen) -> None:
        """Show these frames; returns at once."""
        on = None if seen.on is None else np.array(seen.on)
        # Copies: the camera may use the memory of its frames again.
        self._newest = seen._replace(on=on, off=np.array(seen.off))
        self._come.set()

    def _rehearse(self) -> None:
        """Compile what finds the stripe: later, while the laser may be on, this would hold up an order to stop."""
        camera = self._rig.camera
        shape = (camera.height, camera.width) + ((3,) if camera.layout == "rgb8" else ())
        off = np.random.default_rng(0).integers(10, 20, shape, np.uint8)
        on = off.copy()
        on[:, camera.width // 2] += 200
        for laser in range(len(self._rig.laser)):
            self._draw(Seen(on, off, laser, {}))

    def _paint(self) -> None:
        while not self._end.is_set():
            self._come.wait()
            self._come.clear()
            seen = self._newest
            if seen is None or self._end.is_set():
                continue
            with outlived(self._slate, "the camera's picture"):
                jpeg, live = self._draw(seen)
                self._slate.show(jpeg)
                self._slate.write(live=live)
            self._end.wait(_BETWEEN_S)

    def _draw(self, seen: Seen) -> tuple[bytes, dict[str, Any]]:
        from scanrig.doctor import stripe_level

        camera = self._rig.camera
        frame = seen.off if seen.on is None else seen.on
        step = -(-frame.shape[1] // WIDTH)
        grey = to_grey(frame, camera.layout)[::step, ::step]
        jpeg = encode_jpeg(np.repeat(np.ascontiguousarray(grey)[:, :, None], 3, 2), quality=_QUALITY)
        live = {"width": camera.width, "height": camera.height, "stripe": [], **seen.facts}
        live["histogram"] = np.bincount(grey.ravel() >> 2, minlength=_BINS).tolist()
        if seen.on is not None:
            peak, clipped = stripe_level(seen.on, seen.off, self._rig, seen.laser)
            points = line_finder(self._rig, self._rig.laser[seen.laser].line)(seen.on, seen.off)
            few = points[:: -(-len(points) // _POINTS) or 1]
            live |= {"peak_dn": peak, "clipped": clipped, "stripe": few.round(1).tolist()}
        return jpeg, live
