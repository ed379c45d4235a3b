"""Small statistics of every pair of frames, taken while the frames pass by."""

import functools
import hashlib
from typing import NamedTuple

import numpy as np


_BLOCKS = 8
"""Places of a frame that are looked at, two neighbouring lines each, so that a mosaic shows all its colours."""
TRACE_BINS = 160
"""Samples of a frame's trace."""
_PREFIX = "seen_"
_NO_TWINS = 0.1
"""Part of the pixels that noise changes from which two frames are never the same by chance [1]."""
_LOST = 0.98
"""Part of a place's pixels that may be darker in the laser-on frame [1]."""
_MOST_DN = 255
"""Largest difference of two pixels [DN]."""
_FEW = 8
"""Neighbouring columns that are looked at first."""
_LIGHT_DN = 3
"""Level [DN] of a row that no sensor gives as zeros in its next frame."""


class Seen(NamedTuple):
    """Statistics of records; those of the laser-off frame are 0 where there is none."""

    prints: np.ndarray
    """Fingerprints of the laser-on and the laser-off frame, uint64 [records, 2]; 0 for frames without noise."""
    level: np.ndarray
    """Mean of both frames [DN], float32 [records, 2]."""
    grain: np.ndarray
    """Roughness of both frames from pixel to pixel [DN], float32 [records, 2]."""
    change: np.ndarray
    """Part of the pixels that are brighter, and darker, in the laser-on frame, float32 [records, 2]."""
    unrest: np.ndarray
    """Median difference between the frames of a pair [DN], float32 [records]."""
    lost: np.ndarray
    """Light that the laser-on frame lacks at one pixel in fifty of each place [DN], float32 [records, places]."""
    blank: np.ndarray
    """Rows of the laser-on and of the laser-off frame that are zero while the other frame has light there, int32
    [records, 2]."""
    colours: np.ndarray
    """Mean of the laser-off frame in the four phases of a mosaic or the three channels [DN], float32 [records, 4]."""
    light: np.ndarray
    """The laser's light in the same phases or channels [DN], float32 [records, 4]."""
    trace: np.ndarray
    """The laser-off frame across the turning axis, at each of the places [DN], float16 [records, places, bins]."""

    def arrays(self) -> dict[str, np.ndarray]:
        """For keeping, by name."""
        return {_PREFIX + name: array for name, array in self._asdict().items()}

    @staticmethod
    def names() -> tuple[str, ...]:
        """The names under which `arrays` keeps them."""
        return tuple(_PREFIX + name for name in Seen._fields)

    @staticmethod
    def taken_from(arrays: dict[str, np.ndarray], records: int) -> "Seen | None":
        """Take kept statistics out of other arrays; None if they are not those of so many records."""
        found = {name: arrays.pop(_PREFIX + name) for name in Seen._fields if _PREFIX + name in arrays}
        expected = _empty(records)._asdict()
        if found.keys() != expected.keys():
            return None
        kinds = ([(array.dtype, array.shape) for _, array in sorted(arrays.items())] for arrays in (found, expected))
        return Seen(**found) if next(kinds) == next(kinds) else None


def _empty(records: int) -> Seen:
    pairs = (records, 2)
    return Seen(
        prints=np.zeros(pairs, np.uint64),
        level=np.zeros(pairs, np.float32),
        grain=np.zeros(pairs, np.float32),
        change=np.zeros(pairs, np.float32),
        unrest=np.zeros(records, np.float32),
        lost=np.zeros((records, _BLOCKS), np.float32),
        blank=np.zeros(pairs, np.int32),
        colours=np.zeros((records, 4), np.float32),
        light=np.zeros((records, 4), np.float32),
        trace=np.zeros((records, _BLOCKS, TRACE_BINS), np.float16),
    )


class FrameWatch:
    """Takes the statistics of a sweep's frames, in threads and in any order; keeps no frame."""

    def __init__(self, records: int, *, upright: bool, brackets: bool, colours: bool) -> None:
        """
        Args:
            upright: Whether the turning axis runs along the columns of the image.
            brackets: Whether frames have a first axis of exposures.
            colours: Whether frames have a last axis of colours.
        """
        self._upright, self._brackets, self._colours = upright, brackets, colours
        self.seen = _empty(records)

    def look(self, record: int, on: np.ndarray, off: np.ndarray | None) -> None:
        """Take the statistics of one record."""
        lit, seen = self._sample(on), self.seen
        seen.prints[record, 0], seen.level[record, 0], seen.grain[record, 0] = _texture(lit)
        if off is None:
            return
        dark = self._sample(off)
        seen.prints[record, 1], seen.level[record, 1], seen.grain[record, 1] = _texture(dark)
        difference = lit.astype(np.int16) - dark
        # The values are whole numbers, so their counts suffice for what is wanted.
        counts = _counted(difference.reshape(_BLOCKS, -1))
        whole = counts.sum(0)
        sizes = whole[_MOST_DN:] + np.pad(whole[:_MOST_DN][::-1], (1, 0))
        unrest = int(np.searchsorted(np.cumsum(sizes), difference.size / 2))
        least = 8 + 4 * unrest
        lower, upper = whole[: max(_MOST_DN - least, 0)].sum(), whole[_MOST_DN + least + 1 :].sum()
        seen.change[record] = upper / difference.size, lower / difference.size
        seen.unrest[record] = unrest
        # A laser adds light; what is darker is noise, or one of the frames is of something else there.
        seen.lost[record] = _high(counts[:, ::-1])
        seen.blank[record] = _blank_rows(self._middle(on), self._middle(off))
        seen.colours[record] = self._phases(dark)
        seen.light[record] = self._phases(np.where(difference > least, difference, 0))
        seen.trace[record] = _trace(dark)

    def _sample(self, frame: np.ndarray) -> np.ndarray:
        """Some lines across the turning axis, uint8 [lines, samples(, 3)]; of a bracket the middle exposure."""
        frame = self._middle(frame)
        if not self._upright:
            frame = frame.swapaxes(0, 1)
        last = max(len(frame) // 2 - 1, 0)
        first = 2 * np.linspace(0, last, _BLOCKS + 2).astype(int)[1:-1]
        lines = np.stack([first, np.minimum(first + 1, len(frame) - 1)], 1).reshape(-1)
        return frame[lines]

    def _middle(self, frame: np.ndarray) -> np.ndarray:
        frame = np.asarray(frame)
        return frame[len(frame) // 2] if self._brackets else frame

    def _phases(self, sample: np.ndarray) -> np.ndarray:
        found = np.zeros(4, np.float32)
        if self._colours:
            # Line by line first: sums of three neighbouring numbers are slow.
            found[:3] = sample.sum(0, dtype=np.int32).sum(0) / (sample.shape[0] * sample.shape[1])
            return found
        # Lines come in pairs, so a phase of the sample is one of the mosaic; a frame may be one line or column wide.
        parts = [[sample[a::2, b::2] for b in (0, 1)] for a in (0, 1)]
        phases = np.array([[part.mean() if part.size else 0.0 for part in row] for row in parts])
        found[:] = (phases if self._upright else phases.T).reshape(-1)
        return found


def _counted(difference: np.ndarray) -> np.ndarray:
    """How often each place has each difference from -255 to 255 DN [places, 511]."""
    kinds = 2 * _MOST_DN + 1
    number = difference + (kinds * np.arange(len(difference), dtype=np.int16)[:, None] + np.int16(_MOST_DN))
    return np.bincount(number.reshape(-1), minlength=kinds * len(difference)).reshape(-1, kinds)


def _high(counts: np.ndarray) -> np.ndarray:
    """The quantile `_LOST` of each place, as `np.quantile` has it, by how often its values from -255 to 255 come."""
    total = np.cumsum(counts, 1)
    place = _LOST * (total[0, -1] - 1)
    low = np.argmax(total > int(place), 1) - _MOST_DN
    high = np.argmax(total > min(int(place) + 1, total[0, -1] - 1), 1) - _MOST_DN
    return low + (place - int(place)) * (high - low)


def _blank_rows(on: np.ndarray, off: np.ndarray) -> tuple[int, int]:
    """Rows of each frame that are zero where the other's are not: lost blocks of raw frames are whole rows."""
    on, off = (frame.reshape(len(frame), -1) for frame in (on, off))

    def blank(frame: np.ndarray, other: np.ndarray) -> int:
        # Most rows show by a few of their pixels that they are not.
        some = functools.reduce(np.bitwise_or, frame.T[frame.shape[1] // 2 :][:_FEW])
        few = (row for row in np.flatnonzero(some == 0) if not frame[row].any())
        return sum(int(np.median(other[row]) >= _LIGHT_DN) for row in few)

    return blank(on, off), blank(off, on)


def _texture(sample: np.ndarray) -> tuple[int, float, float]:
    """Fingerprint, mean level and roughness of some lines."""
    plane = sample if sample.ndim == 2 else np.ascontiguousarray(sample[:, :, 1])
    # Over a mosaic, pixels of one colour.
    rough = np.abs(plane[:, 2:].astype(np.int16) - plane[:, :-2])
    noisy = rough.size > 0 and np.count_nonzero(rough) > _NO_TWINS * rough.size
    digest = hashlib.blake2b(np.ascontiguousarray(sample).data, digest_size=8).digest()
    grain = float(np.minimum(rough, 16).mean()) if rough.size else 0.0
    return int.from_bytes(digest, "little") | 1 if noisy else 0, float(plane.mean()), grain


def _trace(sample: np.ndarray) -> np.ndarray:
    plane = sample if sample.ndim == 2 else sample[:, :, 1]
    # The two lines of a place together, and all pixels of a bin.
    pairs = plane.reshape(_BLOCKS, 2, -1).sum(1, dtype=np.float32) / 2
    edges = np.linspace(0, pairs.shape[1], TRACE_BINS + 1).astype(int)
    starts, counts = np.minimum(edges[:-1], pairs.shape[1] - 1), np.maximum(np.diff(edges), 1)
    return np.add.reduceat(pairs, starts, axis=1) / counts
