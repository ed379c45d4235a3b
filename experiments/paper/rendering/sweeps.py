"""A sweep that is rendered while it is read: no frame is kept."""

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from jaxscan.reconstruction import FrameChunk
from jaxscan.simulation import RenderedRecord, SimulationConfig, render_sweep
from jaxscan.simulation.scene import Scene
from jaxscan.stripes import LaserLine, PixelFormat, Response


Watch = Callable[[int, np.ndarray, np.ndarray], None]
"""Called with the first record of a chunk, and its frames on and off, uint8 [records, rows, columns(, 3)]."""


class RenderedSweep:
    """A sweep of a simulated rig, as `jaxscan.reconstruct` takes it; every reading renders the same frames."""

    compression = None
    exposures = (1.0,)

    def __init__(
        self,
        config: SimulationConfig,
        angles: np.ndarray,
        *,
        seed: int,
        scene: Scene | None = None,
        watch: Watch | None = None,
    ) -> None:
        """Of a rig with one laser.

        Args:
            config: The rig; `worlds.windowed` reads fewer columns.
            angles: Commanded angles of the table [rad].
            seed: Of the noise.
            scene: The surroundings, in place of the configuration's room.
            watch: Called with all frames as they are read, at every reading.
        """
        self.config, self.seed, self.scene, self.watch = config, seed, scene, watch
        self.angles = np.asarray(angles, np.float64)
        self.record = np.arange(len(self.angles), dtype=np.int32)
        self.laser = np.zeros(len(self.angles), np.int32)

    pixel_format: PixelFormat = property(lambda self: self.config.sensor.pixel_format)  # type: ignore[assignment]
    response: Response = property(lambda self: self.config.sensor.response)  # type: ignore[assignment]

    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The one laser."""
        laser = self.config.laser[0]
        return (LaserLine(name=laser.name, colour=laser.colour, stripe_axis=laser.stripe_axis),)

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.config.camera.width, self.config.camera.height

    @property
    def carries(self) -> str:
        """The table's load: "scanner" or "object"."""
        return self.config.turntable.carries

    def __len__(self) -> int:
        return len(self.angles)

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        """All frames in order, `size` records at a time."""
        records = self._records()
        first = 0
        while part := list(itertools.islice(records, size)):
            on, off = (np.stack([getattr(record, side) for record in part]) for side in ("on", "off"))
            if self.watch is not None:
                self.watch(first, on, off)
            first += len(part)
            yield FrameChunk(on, off)

    def _records(self) -> Iterator[RenderedRecord]:
        return render_sweep(self.config, seed=self.seed, angles=self.angles, scene=self.scene)
