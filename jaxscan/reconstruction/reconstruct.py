"""A whole sweep to one coloured cloud, streamed through one compiled function."""

from collections.abc import Iterator

import jax
import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Array, Scanner
from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.reconstruction.along import SmoothedSweep, SweepSmoother, smooth_sweep
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.extraction import Progress, rows_of, stripes_of_plan
from jaxscan.reconstruction.plan import Plan, check_stripes, make_plan
from jaxscan.reconstruction.points import Centres, Points, colours_at, line_step, points_alone
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.streaming import GrowingCloud, batches
from jaxscan.reconstruction.sweep import SweepSource
from jaxscan.stripes import (
    NoiseModel,
    Sites,
    Stripes,
    laser_sites,
)


def reconstruct(
    sweep: SweepSource,
    scanner: Scanner,
    *,
    stripes: Stripes | None = None,
    settings: ReconstructSettings = DEFAULTS,
    noise: NoiseModel | None = None,
    progress: Progress = None,
) -> PointCloud:
    """Reconstruct a sweep in one call.

    Frames are read and computed in chunks of one size, so memory does not grow with the sweep beyond its cloud, and
    the result does not depend on the size of the chunks. Where points use their neighbours (`smooth`), the stripes of
    the whole sweep are in memory too: about 30 bytes for each line of a profile.

    Args:
        sweep: Frames at known angles, in memory or on disk.
        scanner: The calibrated rig. Its lasers are found by name where it knows all names of the
            sweep, and by number otherwise.
        stripes: Stripe centres of this sweep where they are known already (`extract_sweep`);
            frames are then read for the colour only, and not at all if the stripes have it.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all) after every chunk.

    Returns:
        The cloud on the grid [profile, line], scanner frame, metres; NumPy arrays, float32.

    Raises:
        CaptureError: If the sweep has no records or no stripe.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.

    Source: the paper, equations (1)-(4) and (9)-(12).
    """
    return cloud_of_plan(make_plan(sweep, scanner, settings), stripes=stripes, noise=noise, progress=progress)


def extract_sweep(
    sweep: SweepSource,
    scanner: Scanner,
    *,
    settings: ReconstructSettings = DEFAULTS,
    noise: NoiseModel | None = None,
    progress: Progress = None,
) -> Stripes:
    """Stripes of a whole sweep, with their colours; `reconstruct` takes them instead of frames.

    Args:
        sweep: Frames at known angles, in memory or on disk.
        scanner: The calibrated rig; it only says where on a line stripes can lie.
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all) after every chunk.

    Raises:
        CaptureError: If the sweep has no records, or cannot be read.
        CalibrationError: If the scanner is not that of the sweep.

    Returns:
        Stripes, a profile per laser in a record; NumPy arrays, float32. `record` and `laser` are
        those of the sweep.
    """
    return stripes_of_plan(make_plan(sweep, scanner, settings), noise=noise, progress=progress)


def cloud_of_plan(
    plan: Plan, *, stripes: Stripes | None = None, noise: NoiseModel | None = None, progress: Progress = None
) -> PointCloud:
    """`reconstruct` by a plan that is made."""
    sweep, settings = plan.sweep, plan.settings
    if stripes is None:
        stripes = stripes_of_plan(plan, noise=noise, progress=progress)
        # All frames are read; the rest takes no time.
        progress = None
    check_stripes(plan, stripes)
    each = len(stripes.u) // len(sweep.record)
    # Before threads ask for it.
    plan.aim(0)
    carries = plan.scanner.turntable.carries
    cloud = GrowingCloud(each * len(sweep.record), plan.lines, travels=carries == "linear")
    for part in _from_stripes(plan, stripes, each, progress):
        cloud.store(*part)
    _check_result(cloud, settings)
    # Profiles of a scanner that stands still are no neighbours.
    normals = settings.normals and carries != "nothing"
    with jax.enable_x64(False):
        between_lines = line_step(plan.scanner, plan.stripe_axis) if normals else None
        profile, rank = np.divmod(np.arange(each * len(sweep.record)), each)
        record = sweep.record[profile]
        return cloud.finish(record, plan.sheet[profile], sweep.angles[record], rank, between_lines)


def smooth_stripes(plan: Plan, stripes: Stripes) -> SmoothedSweep:
    """`smooth_sweep` of the stripes of a plan, one centre of a line at most."""
    return smooth_sweep(stripes, _sites(plan))


def _sites(plan: Plan) -> dict[int, Sites]:
    """Where the colour of each laser is seen."""
    return {int(k): laser_sites(plan.sweep.pixel_format, plan.lasers[k]) for k in np.unique(plan.sweep.laser)}


def _from_stripes(
    plan: Plan, stripes: Stripes, each: int, progress: Progress
) -> Iterator[tuple[np.ndarray, Points, np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """The arguments of `GrowingCloud.store`, chunk by chunk, of known stripes."""
    sweep, size, axis = plan.sweep, plan.size, plan.stripe_axis
    angles = sweep.angles.astype(np.float32)
    # Several candidates of a line are no neighbours of those of the next one.
    smoother = SweepSmoother(stripes, _sites(plan)) if plan.settings.smooths and each == 1 else None

    def compute(item: tuple[np.ndarray, Array | None]) -> tuple[np.ndarray, Points, np.ndarray, dict[str, np.ndarray]]:
        profiles, off = item
        rows = rows_of(profiles, each)
        u, sigma, valid = (np.asarray(field)[rows] for field in (stripes.u, stripes.sigma, stripes.valid))
        along = None if smoother is None else smoother.smooth(int(stripes.laser[rows[0]]), rows)
        if along is not None:
            u, sigma = along.u, along.sigma
        centres = Centres(u.astype(np.float32), sigma.astype(np.float32), valid)
        phi = np.repeat(angles[sweep.record[profiles]], each)
        points = points_alone(plan.aim(int(profiles[0])), centres, phi, size * each, stripe_axis=axis)
        rgb = (
            colours_at(u, valid, off, sweep.pixel_format, axis)
            if stripes.rgb is None
            else np.asarray(stripes.rgb)[rows]
        )
        return rows, points, rgb, {} if along is None else along.beside(np.asarray(points.sigma_random))

    if stripes.rgb is not None:
        items: Iterator[tuple[np.ndarray, Array | None]] = ((profiles, None) for profiles in _blocks(plan))
    else:
        one = slice(None) if len(sweep.exposures) == 1 else np.s_[:, -1]
        frames = ((batch.profiles, batch.off) for batch in batches(sweep, size))
        items = ((profiles, None if off is None else off[one]) for profiles, off in frames)
    for rows, points, rgb, beside in map_ahead(compute, items, workers()):
        amplitude, valid = (np.asarray(field)[rows] for field in (stripes.amplitude, stripes.valid))
        yield rows, points, amplitude, rgb, valid, beside
        if progress is not None:
            progress(int(sweep.record[rows[-1] // each]) + 1, len(sweep))


def _blocks(plan: Plan) -> Iterator[np.ndarray]:
    """Profiles of one laser each, as many as a chunk has records."""
    for laser in np.unique(plan.sweep.laser):
        profiles = np.flatnonzero(plan.sweep.laser == laser)
        yield from (profiles[start : start + plan.size] for start in range(0, len(profiles), plan.size))


def _check_result(cloud: GrowingCloud, settings: ReconstructSettings) -> None:
    if cloud.stripes == 0:
        raise CaptureError(
            "No stripe was found in any record of the sweep; check that the laser was lit in the on images, "
            "the exposure, and the laser's colour in the capture."
        )
    if not cloud.fields["valid"].any():
        raise CalibrationError(
            f"{cloud.stripes} stripe centres were found, but none gives a point between {settings.min_range_m} m "
            f"and {settings.max_range_m} m; check that the calibration belongs to this rig."
        )
