"""A whole sweep to one coloured cloud."""

import numpy as np

from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import MOTIONS, Hand, Scanner, lit_points, stripe_pixel
from jaxscan.reconstruction.ahead import Progress
from jaxscan.reconstruction.along import SmoothedSweep, smooth_sweep
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.colours import colours_at
from jaxscan.reconstruction.extraction import extract, learned_lasers
from jaxscan.reconstruction.plan import Plan, plan_sweep
from jaxscan.reconstruction.points import Aim, Centres, Window, empty_points, fill_points, line_step
from jaxscan.reconstruction.settings import DEFAULTS, ReconstructSettings
from jaxscan.reconstruction.sweep import SweepSource, batches, colour_exposure, place, rows_of
from jaxscan.reconstruction.without_off import with_off
from jaxscan.stripes import NoiseModel, Stripes, laser_sites


_RANGES = 20_000
"""Points from which the usual distance is taken, about."""


def reconstruct(
    sweep: SweepSource,
    scanner: Scanner,
    *,
    stripes: Stripes | None = None,
    smoothed: SmoothedSweep | None = None,
    settings: ReconstructSettings = DEFAULTS,
    noise: NoiseModel | None = None,
    progress: Progress = None,
) -> PointCloud:
    """Reconstruct a sweep in one call.

    Frames are read and computed in chunks of one size, so memory does not grow with the sweep beyond its stripes and
    its cloud (about 30 and 60 bytes for each line of a profile), and the result does not depend on the size of the
    chunks.

    Args:
        sweep: Frames and angles, on the disk or in memory.
        scanner: The calibrated rig. Its lasers are found by name where it knows all names of the
            sweep, and by number otherwise.
        stripes: Stripe centres of this sweep where they are known already (`extract`);
            frames are then read for the colour only, and not at all if the stripes have it.
        smoothed: Those stripes smoothed, where that is done already (`smooth_stripes`).
        settings: Range limits, and how stripes are found.
        noise: Noise of a frame; estimated from the start of the sweep where not given.
        progress: Called with (records done, records in all).

    Returns:
        The cloud on the grid [profile, line], scanner frame, metres; NumPy arrays, float32.

    Raises:
        CaptureError: If the sweep has no records or no stripe.
        CalibrationError: If the scanner is not that of the sweep, or no point is in range.

    Source: the paper, equations (1)-(4) and (9)-(12).
    """
    plan = plan_sweep(sweep, scanner, settings)
    if stripes is None:
        stripes = extract(sweep, scanner, settings=settings, noise=noise, progress=progress).stripes
        # All frames are read; the rest takes no time.
        progress = None
    profiles, lines = np.shape(stripes.u)
    each, rest = divmod(profiles, len(sweep.record))
    if lines != plan.lines or each == 0 or rest:
        raise CaptureError(
            f"The stripes have {profiles} profiles of {lines} lines, the sweep has {len(sweep.record)} records of "
            f"{plan.lines} lines; pass the stripes of this sweep."
        )
    valid = np.asarray(stripes.valid)
    if not valid.any():
        raise CaptureError(
            "No stripe was found in any record of the sweep; check that the laser was lit in the on images, "
            "the exposure, and the laser's colour in the capture."
        )
    along, centres = None, Centres(np.asarray(stripes.u), np.asarray(stripes.sigma), valid)
    # Several candidates of a line are no neighbours of those of the next one.
    if settings.smooths and each == 1:
        along = smoothed or smooth_stripes(sweep, stripes, progress if stripes.rgb is not None else None)
        centres = Centres(along.u, along.sigma, valid)
    fields = _points(plan, centres, each)
    there = fields["valid"]
    if not there.any():
        raise CalibrationError(
            f"{np.count_nonzero(valid)} stripe centres were found, but none gives a point between "
            f"{settings.min_range_m} m and {settings.max_range_m} m; check that the calibration belongs to this rig."
        )
    rgb = _colours(plan, centres, each, progress) if stripes.rgb is None else np.asarray(stripes.rgb)
    fields["rgb"] = np.where(there[:, :, None], rgb, np.uint8(0))
    fields["intensity"] = np.where(there, np.asarray(stripes.amplitude, np.float32), np.float32(0))
    if along is not None:
        fields |= _beside(along, fields["sigma_random"])
    elif progress is not None and stripes.rgb is not None:
        progress(len(sweep), len(sweep))
    profile = np.arange(profiles) // each
    record = sweep.record[profile]
    angle = sweep.angles[record]
    return PointCloud(**fields, record=record, laser=plan.sheet[profile], angle=angle, stations=None, absent=None)


def smooth_stripes(sweep: SweepSource, stripes: Stripes, progress: Progress = None) -> SmoothedSweep:
    """`smooth_sweep` of the stripes of a sweep, one centre of a line at most."""
    tell = None if progress is None else lambda done, total: progress(len(sweep) * done // total, len(sweep))
    if not sweep.pixel_format.startswith("bayer"):
        return smooth_sweep(stripes, progress=tell)
    lasers = learned_lasers(sweep)
    sites = {int(k): laser_sites(sweep.pixel_format, lasers[k]) for k in np.unique(sweep.laser)}
    return smooth_sweep(stripes, sites, tell)


def _points(plan: Plan, centres: Centres, each: int) -> dict[str, np.ndarray]:
    """The fields of the cloud that are made of centres; neighbours are profiles of one laser, in the order of angles.

    Args:
        each: Profiles of the cloud for each of the sweep.
    """
    carries, fields = plan.scanner.turntable.carries, empty_points(np.shape(centres.u))
    profile, rank = np.divmod(np.arange(len(centres.u)), each)
    angle, sheet = plan.sweep.angles[plan.sweep.record[profile]], plan.sheet[profile]
    aim = Aim.of(plan.scanner, plan.settings, plan.stripe_axis)
    between, travel, place = line_step(plan.scanner, plan.stripe_axis), 1.0, angle
    if MOTIONS[carries].unit in ("m", "pose"):
        # Profiles differ by metres, not by an angle.
        travel = _usual_range(plan, centres, sheet)
    if plan.sweep.poses is not None:
        place = _way(plan, travel)[plan.sweep.record[profile]]
    for laser, number in np.unique(np.stack([sheet, rank], 1), axis=0):
        rows = np.flatnonzero((sheet == laser) & (rank == number))
        rows = rows[np.argsort(angle[rows], kind="stable")]
        step = float(np.median(np.diff(place[rows]))) / travel if len(rows) > 1 else np.inf
        # Profiles of a scanner that stands still are no neighbours.
        window = None if carries == "nothing" else Window.of(between, step)
        mine = aim._replace(laser=np.asarray(laser, np.int32))
        fill_points(fields, rows, mine, centres, angle.astype(np.float32), window, stripe_axis=plan.stripe_axis)
    if not plan.settings.normals:
        # Computing them takes less time than compiling a function without them.
        fields["normals"] = np.zeros_like(fields["normals"])
    if isinstance(plan.scanner.turntable, Hand):
        _scatter(fields, plan.scanner.turntable, plan.sweep.record[profile])
    return fields


def _way(plan: Plan, usual_range: float) -> np.ndarray:
    """How far the beam has gone from record to record [m], by travel and by turns at a usual range."""
    pose = np.asarray(plan.scanner.pose(plan.sweep.angles))
    ahead = pose[:, :3, 3] + usual_range * pose[:, :3, 2]
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ahead, axis=0), axis=1))])


def _scatter(fields: dict[str, np.ndarray], hand: Hand, record: np.ndarray) -> None:
    """Add the scatter of given poses to sigmas; all points of a record share it, so it counts as shared."""
    place, angle = np.asarray(hand.scatter)
    arm = np.linalg.norm(fields["xyz"] - np.asarray(hand.path)[record, None, :3, 3].astype(np.float32), axis=-1)
    moved = np.hypot(place, angle * arm)
    fields["sigma_systematic"] = np.where(fields["valid"], np.hypot(fields["sigma_systematic"], moved), 0.0).astype(
        np.float32
    )


def _usual_range(plan: Plan, centres: Centres, sheet: np.ndarray) -> float:
    """Median distance of some of the points from the camera [m]."""
    lines, settings = plan.lines, plan.settings
    # An odd number, so that it is not always the same lines.
    every = np.count_nonzero(centres.valid) // _RANGES | 1
    cells = every * np.flatnonzero(centres.valid.reshape(-1)[::every])
    u, (row, line) = centres.u.reshape(-1)[cells].astype(np.float64), np.divmod(cells, lines)
    p, _ = lit_points(plan.scanner.rig, stripe_pixel(u, line.astype(np.float64), plan.stripe_axis), sheet[row])
    away = np.linalg.norm(p, axis=-1)
    away = away[(away > 0) & (away >= settings.min_range_m) & (away <= settings.max_range_m)]
    return float(np.median(away)) if len(away) else 1.0


def _colours(plan: Plan, centres: Centres, each: int, progress: Progress) -> np.ndarray:
    """The colours at the centres, of frames that are read again."""
    sweep, rgb = plan.sweep, np.zeros((*np.shape(centres.u), 3), np.uint8)
    one = slice(None) if len(sweep.exposures) == 1 else np.s_[:, colour_exposure(sweep)]
    for batch in batches(sweep, plan.size, with_off(plan)):
        rows, off = place(rows_of(batch.profiles, each)), None if batch.off is None else batch.off[one]
        rgb[rows] = colours_at(centres.u[rows], centres.valid[rows], off, sweep.pixel_format, plan.stripe_axis)
        if progress is not None:
            progress(int(sweep.record[batch.profiles[-1]]) + 1, len(sweep))
    return rgb


def _beside(along: SmoothedSweep, sigma_random: np.ndarray) -> dict[str, np.ndarray]:
    """The fields that a cloud has where its points use their neighbours."""
    there = sigma_random > 0
    # The same factor turns both sigmas from px into m.
    metres = sigma_random / np.where(there, along.sigma, np.float32(1))
    shift, shared = (np.where(there, field, np.float32(0)) for field in (along.shift, along.shared_lines))
    return {"sigma_row": along.sigma_row * metres, "shift_px": shift, "shared_lines": shared}
