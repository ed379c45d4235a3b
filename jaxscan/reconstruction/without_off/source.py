"""A sweep whose records have no laser-off frames, with predicted ones."""

import dataclasses
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.reconstruction.ahead import workers
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.reconstruction.without_off.moved import Lattice, moved, places
from jaxscan.stripes import LaserLine, PixelFormat, Response, laser_sites, predict_off, read_channels


_APART_PX = 24.0
"""Motion of the room from one step to another from which its stripe is out of the way [px]."""
_SEEN = 0.35
"""Part of the image by which the room may move, so that most of it is seen twice [1]."""
_FARTHEST = 16
"""Records on either side that are kept."""
_RANGES = 7
_NEAREST_M, _FARTHEST_M = 0.3, 10.0
"""Distances between which the room is taken to be where the range limits are wider [m]."""


def with_off(sweep: SweepSource, scanner: Scanner, settings: ReconstructSettings) -> SweepSource:
    """The sweep; where its records have no laser-off frames, with predicted ones.

    A laser whose colour is to be learned needs true ones: there the frames stay as they are.
    """
    if any(line.colour == "auto" for line in sweep.lasers) and sweep.pixel_format != "mono8":
        return sweep
    return PredictedPairs(sweep, scanner, settings)


@dataclass(frozen=True)
class PredictedPairs:
    """A `SweepSource`: another one, whose missing laser-off frames are predicted while they pass by."""

    sweep: SweepSource
    scanner: Scanner
    settings: ReconstructSettings

    @property
    def pixel_format(self) -> PixelFormat:
        return self.sweep.pixel_format

    @property
    def response(self) -> Response:
        return self.sweep.response

    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        return self.sweep.lasers

    @property
    def image_size(self) -> tuple[int, int]:
        return self.sweep.image_size

    @property
    def carries(self) -> str | None:
        return self.sweep.carries

    @property
    def compression(self) -> str | None:
        return self.sweep.compression

    @property
    def angles(self) -> np.ndarray:
        return self.sweep.angles

    @property
    def record(self) -> np.ndarray:
        return self.sweep.record

    @property
    def laser(self) -> np.ndarray:
        return self.sweep.laser

    @property
    def exposures(self) -> tuple[float, ...]:
        return self.sweep.exposures

    def __len__(self) -> int:
        return len(self.sweep)

    @cached_property
    def predicts(self) -> bool:
        """Whether there is no laser-off frame, as the first record says."""
        return next(self.sweep.chunks(1)).off is None

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        kept: list[np.ndarray] = []
        first, done = 0, 0
        with ThreadPoolExecutor(workers()) as pool:
            for chunk in self.sweep.chunks(size):
                if chunk.off is not None:
                    yield chunk
                    continue
                kept += list(np.asarray(chunk.on))
                last = first + len(kept) == len(self)
                while done < len(self) and (last or done + size + _FARTHEST <= first + len(kept)):
                    records = range(done, min(done + size, len(self)))
                    off = pool.map(lambda k, known=kept, start=first: self._off(k, known, start), records)
                    on = np.stack(kept[done - first : records.stop - first])
                    yield FrameChunk(on, np.stack(list(off)))
                    done = records.stop
                    passed = max(0, done - _FARTHEST - first)
                    first, kept = first + passed, kept[passed:]

    def _off(self, record: int, kept: list[np.ndarray], first: int) -> np.ndarray:
        """The laser-off frames of a record, of all its exposures."""
        own, line = kept[record - first], self._line(record)
        if len(self.exposures) == 1:
            return self._predicted(record, {k + first: frame[None] for k, frame in enumerate(kept)}, line)[0]
        frames = [{k + first: frame[e : e + 1] for k, frame in enumerate(kept)} for e in range(len(own))]
        return np.concatenate([self._predicted(record, one, line) for one in frames])

    def _line(self, record: int) -> LaserLine:
        (laser, *_) = self.laser[self.record == record].tolist() or [0]
        return dataclasses.replace(self.lasers[laser], name="laser")

    def _predicted(self, record: int, frames: dict[int, np.ndarray], line: LaserLine) -> np.ndarray:
        own = frames[record]
        neighbours, sites = self._neighbours(record, frames), laser_sites(self.pixel_format, line)
        if not neighbours or len(sites.offsets) > 1:
            return predict_off(own, self.pixel_format, line)
        seen, *others = (read_channels(frames[k], self.pixel_format, line) for k in (record, *neighbours))
        lattice = Lattice.of(seen.laser.shape[1:], sites)
        where = [
            places(self.scanner, (self.angles[record], self.angles[k]), self._ranges, lattice, line.stripe_axis)
            for k in neighbours
        ]
        elsewhere = moved(seen, (others[0], others[1]), (where[0], where[1]))
        return predict_off(own, self.pixel_format, line, elsewhere=elsewhere)

    @property
    def _ranges(self) -> np.ndarray:
        near, far = max(self.settings.min_range_m, _NEAREST_M), min(self.settings.max_range_m, _FARTHEST_M)
        return 1.0 / np.linspace(1.0 / min(near, far), 1.0 / max(near, far), _RANGES)

    def _neighbours(self, record: int, frames: dict[int, np.ndarray]) -> list[int]:
        """Two steps in which the camera has turned far enough and not too far, if possible before and after."""
        if self.scanner.turntable.carries != "scanner":
            return []
        camera = self.scanner.camera
        focal = float(max(np.asarray(camera.fx), np.asarray(camera.fy)))
        turn = (self.angles - self.angles[record] + np.pi) % (2 * np.pi) - np.pi
        motion = focal * np.abs(turn)
        fits = (motion >= _APART_PX) & (motion <= _SEEN * min(self.image_size))
        near = [k for k in frames if fits[k] and abs(k - record) <= _FARTHEST]
        before, after = [k for k in near if k < record][::-1], [k for k in near if k > record]
        if before and after:
            return [before[0], after[0]]
        # At an end of the sweep two on one side, of which again only one has a stripe at any place.
        one = before or after
        return next(([one[0], k] for k in one[1:] if abs(motion[k] - motion[one[0]]) >= _APART_PX), [])
