"""A whole sweep to one coloured cloud, streamed through one compiled function."""

import functools
from collections.abc import Callable, Iterator

import jax
import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction.ahead import Lender, map_ahead, workers
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.grid import GrowingCloud
from jaxscan.reconstruction.points import Centres, Points, Rig, line_step, locate_points
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.sweep import SweepSource
from jaxscan.stripes.extract import stripes_of_frames, takes_shifted
from jaxscan.stripes.frames import LaserLine, PixelFormat, Response, StripeAxis
from jaxscan.stripes.noise import estimate_noise
from jaxscan.stripes.shifted import Frames
from jaxscan.stripes.stripes import NoiseModel, Stripes


CHUNK_BYTES = 20e6
"""Frames per chunk: enough to keep the cores busy, little enough that what is copied is still in
the cache when it is used: 8 pairs of 1280 x 1024 took a quarter less processor time than 18."""

NOISE_RECORDS = 8
"""Records at the start of the sweep from which the noise is estimated where it is not given."""

Batch = tuple[np.ndarray, LaserLine, Array, Array | None]
"""Record numbers, laser line, on, off: frames beyond the record numbers are padding."""


def reconstruct(
    sweep: SweepSource,
    scanner: Scanner,
    *,
    stripes: Stripes | None = None,
    settings: ReconstructSettings = DEFAULTS,
    noise: NoiseModel | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PointCloud:
    """Reconstruct a sweep in one call.

    Frames are read and computed in chunks of one size, so memory does not grow with the sweep
    beyond its cloud, and the result does not depend on the size of the chunks.

    Args:
        sweep: Frames at known angles, in memory or on disk.
        scanner: The calibrated rig. Its lasers are found by name where it knows all names of the
            sweep, and by number otherwise.
        stripes: Stripe centres of this sweep, one profile per record, where they are known
            already; the frames then only give the colour.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all) after every chunk.

    Returns:
        The cloud on the grid [record, line], scanner frame, metres; NumPy arrays, float32.

    Raises:
        CaptureError: If the sweep has no records or no stripe.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.

    Source: PAPER.md equations (1)-(4) and (9)-(12).
    """
    stripe_axis, laser = _check(sweep, scanner, stripes)
    width, height = sweep.image_size
    rig = Rig.of(scanner, stripe_axis)
    cloud = GrowingCloud(len(sweep), height if stripe_axis == "rows" else width)
    # Single precision throughout, so that the result does not depend on the caller's setting.
    with jax.enable_x64(False):
        _stream(sweep, rig, cloud, laser, stripe_axis, stripes, settings, noise, progress)
        _check_result(cloud, settings)
        between_lines = line_step(rig.scanner.camera, stripe_axis) if settings.normals else None
        return cloud.finish(laser, sweep.angles, between_lines)


def _stream(
    sweep: SweepSource,
    rig: Rig,
    cloud: GrowingCloud,
    laser: np.ndarray,
    stripe_axis: StripeAxis,
    stripes: Stripes | None,
    settings: ReconstructSettings,
    noise: NoiseModel | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Fill the cloud chunk by chunk."""
    options = {"pixel_format": sweep.pixel_format, "settings": settings}
    angles = sweep.angles.astype(np.float32)
    if stripes is None:
        noise = noise or _noise_of_start(sweep)
        levels = np.float32(noise.read_dn), np.float32(noise.electrons_per_dn)

    lender = Lender()

    def compute(batch: Batch) -> tuple[np.ndarray, Points]:
        records, line, on, off = batch
        size = len(on)
        lent: tuple[Frames, Frames | None] = on, off
        if takes_shifted(sweep.pixel_format, line):
            lent = lender.lend("on", on), None if off is None else lender.lend("off", off)
        lasers, phi = _padded(laser[records], size), _padded(angles[records], size)
        # JAX keeps this setting per thread.
        with jax.enable_x64(False):
            if stripes is not None:
                centres = _centres(stripes, records, size)
                points = _from_stripes(rig, centres, lent[1], lasers, phi, stripe_axis=stripe_axis, **options)
            else:
                points = _from_frames(rig, *lent, lasers, phi, *levels, line=line, response=sweep.response, **options)
            return records, jax.tree.map(np.asarray, points)

    for records, points in map_ahead(compute, _batches(sweep, _chunk_records(sweep, settings)), workers()):
        cloud.store(records, points)
        if progress is not None:
            progress(int(records[-1]) + 1, len(sweep))


@functools.partial(jax.jit, static_argnames=("pixel_format", "response", "line", "settings"))
def _from_frames(
    rig: Rig,
    on: Frames,
    off: Frames | None,
    laser: Array,
    phi: Array,
    noise_read: Array,
    noise_gain: Array,
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    settings: ReconstructSettings,
) -> Points:
    found = stripes_of_frames(
        on,
        off,
        noise_read,
        noise_gain,
        pixel_format=pixel_format,
        response=response,
        line=line,
        settings=settings.stripes,
    )
    centres = Centres(found.u, found.sigma, found.amplitude, found.valid)
    return locate_points(
        rig, centres, off, laser, phi, pixel_format=pixel_format, stripe_axis=line.stripe_axis, settings=settings
    )


@functools.partial(jax.jit, static_argnames=("pixel_format", "stripe_axis", "settings"))
def _from_stripes(
    rig: Rig,
    centres: Centres,
    off: Frames | None,
    laser: Array,
    phi: Array,
    *,
    pixel_format: PixelFormat,
    stripe_axis: StripeAxis,
    settings: ReconstructSettings,
) -> Points:
    return locate_points(
        rig, centres, off, laser, phi, pixel_format=pixel_format, stripe_axis=stripe_axis, settings=settings
    )


def _centres(stripes: Stripes, records: np.ndarray, size: int) -> Centres:
    u, sigma, amplitude = (
        _padded(np.asarray(field)[records].astype(np.float32), size)
        for field in (stripes.u, stripes.sigma, stripes.amplitude)
    )
    return Centres(u, sigma, amplitude, _padded(np.asarray(stripes.valid)[records], size))


def _noise_of_start(sweep: SweepSource) -> NoiseModel:
    # A fixed number of records, so that the result does not depend on the size of the chunks.
    first = next(iter(sweep.chunks(min(NOISE_RECORDS, len(sweep)))))
    return estimate_noise(
        first.on,
        first.off,
        pixel_format=sweep.pixel_format,
        response=sweep.response,
        line=sweep.lines[sweep.laser[0]],
    )


def _chunk_records(sweep: SweepSource, settings: ReconstructSettings) -> int:
    if settings.chunk_records is not None:
        return settings.chunk_records
    width, height = sweep.image_size
    pair = 2 * width * height * (3 if sweep.pixel_format == "rgb8" else 1)
    return min(max(1, round(CHUNK_BYTES / pair)), len(sweep))


def _batches(sweep: SweepSource, size: int) -> Iterator[Batch]:
    """The sweep in batches of exactly `size` frames: record numbers, laser line, on, off.

    The records of a batch show lasers that look the same; frames beyond its record numbers are
    padding.
    """
    kinds = list(dict.fromkeys((line.colour, line.stripe_axis) for line in sweep.lines))
    kind_of_laser = np.array([kinds.index((line.colour, line.stripe_axis)) for line in sweep.lines])
    kind_of_record = kind_of_laser[sweep.laser]
    start = 0
    for chunk in sweep.chunks(size * len(kinds)):
        count = len(chunk.on)
        for kind, (colour, stripe_axis) in enumerate(kinds):
            chosen = np.flatnonzero(kind_of_record[start : start + count] == kind)
            for first in range(0, len(chosen), size):
                rows = chosen[first : first + size]
                on = _frames(chunk.on, rows, size)
                off = None if chunk.off is None else _frames(chunk.off, rows, size)
                yield start + rows, LaserLine(colour=colour, stripe_axis=stripe_axis), on, off
        start += count


def _frames(frames: Array, rows: np.ndarray, size: int) -> Array:
    if len(rows) == len(frames) == size:
        return frames
    return _padded(np.asarray(frames)[rows], size)


def _padded(array: np.ndarray, size: int) -> np.ndarray:
    if len(array) == size:
        return array
    padded = np.zeros((size, *array.shape[1:]), array.dtype)
    padded[: len(array)] = array
    return padded


def _check(sweep: SweepSource, scanner: Scanner, stripes: Stripes | None) -> tuple[StripeAxis, np.ndarray]:
    """Refuse what does not fit together; else what a line is, and the scanner's laser per record."""
    if len(sweep) == 0:
        raise CaptureError("The sweep has no records; a reconstruction needs at least one. Capture it again.")
    width, height = sweep.image_size
    camera = scanner.camera
    if (camera.width, camera.height) != (width, height):
        raise CalibrationError(
            f"The scanner is calibrated for images of {camera.width} x {camera.height} px, the sweep has "
            f"{width} x {height} px; use the calibration of this camera mode."
        )
    if sweep.carries is not None and sweep.carries != scanner.turntable.carries:
        raise CalibrationError(
            f"The table of the sweep carries the {sweep.carries}, that of the calibration the "
            f"{scanner.turntable.carries}; use a calibration made in the same arrangement."
        )
    known, names = scanner.laser_names, [line.name for line in sweep.lines]
    used = int(sweep.laser.max()) + 1
    if max(used, len(names)) > len(known):
        raise CalibrationError(
            f"The sweep has {max(used, len(names))} lasers, the calibration knows {len(known)} "
            f"({', '.join(known)}); calibrate with all lasers of the sweep."
        )
    if used > len(names):
        raise CaptureError(f"A record names laser {used - 1}, the sweep lists {len(names)}; list every laser.")
    axes = {line.stripe_axis for line in sweep.lines}
    if len(axes) > 1:
        raise CaptureError(
            "The sweep has lasers along the rows and along the columns; one grid holds one kind. "
            "Capture them as two sweeps."
        )
    (stripe_axis,) = axes
    expected = (len(sweep), height if stripe_axis == "rows" else width)
    if stripes is not None and tuple(np.shape(stripes.u)) != expected:
        raise CaptureError(
            f"The stripes have {np.shape(stripes.u)[0]} profiles of {np.shape(stripes.u)[1]} lines, the sweep "
            f"has {expected[0]} records of {expected[1]} lines; pass the stripes of this sweep."
        )
    by_name = all(name in known for name in names) and len(set(names)) == len(names)
    of_scanner = [known.index(name) if by_name else i for i, name in enumerate(names)]
    return stripe_axis, np.asarray(of_scanner, np.int32)[sweep.laser]


def _check_result(cloud: GrowingCloud, settings: ReconstructSettings) -> None:
    if cloud.stripes == 0:
        raise CaptureError(
            "No stripe was found in any record of the sweep; check that the laser was lit in the on images, "
            "the exposure, and the laser's colour in the capture."
        )
    if not cloud.valid.any():
        raise CalibrationError(
            f"{cloud.stripes} stripe centres were found, but none gives a point between {settings.min_range_m} m "
            f"and {settings.max_range_m} m; check that the calibration belongs to this rig."
        )
