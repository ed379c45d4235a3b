"""`locate` for a CPU, where XLA's code for it is many times slower: the same integers, natively.

It computes the same numbers as `locate.locate`; a test holds the two equal.
"""

import threading

import numpy as np

from jaxscan.stripes.search.candidates import (
    BIN_EXTENT_PX,
    CANDIDATES,
    FINE_SHIFT,
    HALF_SPAN,
    LANES,
    NARROW,
    WIDE,
    ZONE_SPAN,
    Candidates,
    Located,
    fixed_point,
)
from jaxscan.stripes.search.memory import Rules, Scratch
from jaxscan.stripes.search.native_loops import EDGE, GROUP, locate_lines
from jaxscan.stripes.search.planes import Planes
from jaxscan.stripes.search.search import Search


_ALIGNMENT = 64
"""Address of an array that JAX takes on a CPU without a copy [bytes]."""


class NativeLocator(threading.local):
    """Finds candidates; keeps its memory, since the pages of new memory cost more than the search.

    Every thread has its own. A result is good until the next call in the same thread.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple, np.ndarray] = {}

    def locate(self, planes: Planes, search: Search, *, pitch: int, saturation: int) -> Located:
        """Candidates of all frames: a list of those with narrow windows, one of those with wide ones.

        Arguments as of `jaxscan.stripes.search.locate.locate`; there must be laser-off frames.
        """
        on, off = planes.on, planes.off
        frames, lines, samples = on.shape
        low, high = (np.asarray(limit).astype(np.int64) for limit in (search.low, search.high))
        levels = np.asarray(search.levels).astype(np.float32)
        constants = CANDIDATES, HALF_SPAN, ZONE_SPAN, FINE_SHIFT, np.float32(BIN_EXTENT_PX)
        rules = Rules(low, high, np.asarray(search.thresholds), levels, pitch, saturation, *constants)
        room = frames * lines * CANDIDATES
        found = Located(
            (self._list("narrow", room, NARROW), self._list("wide", room, WIDE)),
            self._memory(("slots",), (frames, lines, CANDIDATES), np.int32),
        )
        ratio = np.asarray(fixed_point(planes.lamp_ratio)).astype(np.int64)
        locate_lines(on, off, ratio, rules, found, self._scratch(samples, room))
        return found

    def _list(self, name: str, room: int, samples: int) -> Candidates:
        blocks = -(-room // LANES)

        def memory(field: str, dtype: type, *window: int) -> np.ndarray:
            return self._memory((name, field), (blocks, *window, LANES), dtype)

        whole = {field: memory(field, np.int32) for field in ("frame", "bins", "saturated")}
        real = {field: memory(field, np.float32) for field in ("start", "extent", "middle")}
        windows = {field: memory(field, np.float32, samples) for field in ("on", "off")}
        return Candidates(total=np.zeros((), np.int32), **whole, **real, **windows)

    def _scratch(self, samples: int, room: int) -> Scratch:
        groups = samples // int(GROUP) + 1
        padded = samples + 2 * int(EDGE)
        sizes = {"lattice": padded, "fine": padded, "response": groups * int(GROUP), "highest": groups}
        kinds = {"line": np.int32, "place": np.float32, "extent": np.float32, "bins": np.int32}
        return Scratch(
            **{name: self._memory((name,), (size,), np.int16) for name, size in sizes.items()},
            **{name: self._memory((name,), (2, room), kind) for name, kind in kinds.items()},
        )

    def _memory(self, key: tuple, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        kept = self._kept.get(key)
        if kept is None or kept.shape != shape:
            size = int(np.prod(shape)) * np.dtype(dtype).itemsize
            memory = np.zeros(size + _ALIGNMENT, np.uint8)
            first = -memory.ctypes.data % _ALIGNMENT
            kept = self._kept[key] = memory[first : first + size].view(dtype).reshape(shape)
        return kept
