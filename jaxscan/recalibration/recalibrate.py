"""Sweeps and a stored calibration to a better one, or to the reason why not: segment, associate, solve, judge."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.calibration import Calibration, predict_lengths
from jaxscan.errors import CalibrationError, GivenError
from jaxscan.geometry import Scanner
from jaxscan.recalibration import judge
from jaxscan.recalibration.adjust import adjust
from jaxscan.recalibration.lengths import check_adjusted, check_lengths, found_lengths, lost_lengths, place_lengths
from jaxscan.recalibration.lost_steps import check_angles
from jaxscan.recalibration.observed import Given, RecalibrationSettings, RoomObservations, SweepStripes
from jaxscan.recalibration.renew import require_prior
from jaxscan.recalibration.result import Adjusted, PanoramaOfWalls, Recalibration, Start, TableFindings
from jaxscan.recalibration.segment import label_planes, observe_surfaces
from jaxscan.recalibration.stations import place_stations
from jaxscan.recalibration.tracks import place_tracks


Progress = Callable[[int, int], None]
_STAGES, _REGISTERED = 9, 4


class _Job(NamedTuple):
    """The inputs that stay the same through all stages."""

    sweeps: Sequence[SweepStripes]
    stored: Scanner
    settings: RecalibrationSettings
    given: Given
    table: TableFindings
    stations: Float[np.ndarray, "stations 4 4"]
    """First poses."""

    def start(self, scanner: Scanner, stations: Float[np.ndarray, "stations 4 4"] | None = None) -> Start:
        return Start(scanner, self.stations if stations is None else stations, self.table.corrections)

    def turned(self, corrections: Sequence[np.ndarray] = ()) -> list[SweepStripes]:
        """The sweeps with the table's angles put right, by its known faults where no corrections are given."""
        both = zip(self.sweeps, corrections or self.table.corrections, strict=True)
        return [sweep.turned(correction) for sweep, correction in both]

    def observe(self, start: Start) -> RoomObservations:
        """Surfaces of the room and points on them, found with a scanner as it is, and everything that was given."""
        turned, tracks = self.turned(), self.given.tracks
        points, surfaces = observe_surfaces(turned, start.scanner, start.stations, self.settings.points)
        if tracks is not None and len(tracks.q):
            # Tracks were observed before the stations and faults of angles were known.
            tracks = place_tracks(tracks, turned, start.scanner, start.stations)
        observed = RoomObservations(
            points=points,
            surfaces=surfaces,
            angles=tuple(np.asarray(sweep.angle, np.float64) for sweep in self.sweeps),
            station=np.array([sweep.station for sweep in self.sweeps], np.int32),
            stripe_axis=self.sweeps[0].stripe_axis,
            tracks=tracks,
            boards=self.given.boards,
        )
        return observed._replace(lengths=place_lengths(self.given.lengths, observed, start))

    def solve(self, prior: Scanner, before: Adjusted, observed: RoomObservations) -> Adjusted:
        """An adjustment that begins where another one ended."""
        return adjust(prior, self.start(before.scanner, before.stations), observed, self.settings)

    def flat(self, found: Adjusted) -> tuple[Adjusted, list[int]]:
        """The adjustment of the flat surfaces alone, and the numbers of these."""
        kept = np.flatnonzero(judge.flat(found)).tolist()
        if not kept:
            raise CalibrationError(judge.none_is_flat(found))
        if len(kept) < len(found.surfaces.distance):
            found = self.solve(found.prior, found, found.observations.only(kept))
        return found, kept


def recalibrate(
    sweeps: Sequence[SweepStripes],
    stored: Calibration,
    settings: RecalibrationSettings | None = None,
    given: Given | None = None,
    *,
    progress: Progress | None = None,
) -> Recalibration:
    """Refine a stored calibration with sweeps of a room that have planes in them.

    Planes are found with the stored calibration, the scanner is adjusted to them with that calibration as prior, planes
    are found again, and the result is judged: drift, gain, planes that were held out.

    Args:
        sweeps: Stripes of each sweep; `station` is the place that it was taken from.
        stored: Its covariance is the prior; nothing in it is changed.
        settings: How the sweeps are used.
        given: What is known beside the sweeps: tracks, lengths, boards, places of stations.
        progress: Called with (stages done, stages in all).

    Returns:
        The new scanner and everything by which it can be judged. Where the update is refused, `updated` is False,
        `refused` says why in one line, and the scanner is the stored one.

    Raises:
        CalibrationError: If nothing can be adjusted at all: no sweeps, no plane in them, a stored calibration without
            covariance, sheet or table, or sweeps of a camera of another size.
        GivenError: If something that was given contradicts the sweeps.
    """
    done = _counter(progress, _STAGES)
    job = _begin(sweeps, stored, settings, given, done)
    loose = judge.loose(job.stored)
    start = job.start(loose)
    observed = job.observe(start)
    doubts = check_lengths(observed, job.turned(), job.stored, loose)
    if doubts:
        _check_without(job, observed, start, doubts[0])
    # Only the scanner and the stations of this first solve are used.
    rough = adjust(loose, job.start(job.stored), observed, job.settings)
    done()
    start = job.start(rough.scanner, rough.stations)
    observed = job.observe(start)
    done()
    every = adjust(loose, start, observed, job.settings)
    done()
    free, kept = job.flat(every)
    done()
    solve = lambda prior, before: job.solve(prior, before, free.observations)
    verdict = judge.find_drift(job.stored, free, solve)
    done()
    result = _judged(job, verdict, done)
    uneven = [judge.describe_surface(every.surfaces, k) for k in range(len(every.surfaces.distance)) if k not in kept]
    notes = [f"left out, because it is not flat: {name}" for name in uneven]
    lost = lost_lengths(observed.lengths, kept)
    return replace(result, notes=(*job.table.sentences, *result.notes, *notes, *doubts, *lost))


def register(
    sweeps: Sequence[SweepStripes],
    stored: Calibration,
    settings: RecalibrationSettings | None = None,
    given: Given | None = None,
    *,
    progress: Progress | None = None,
) -> Adjusted:
    """The places of the stations of several sweeps, in one least squares with the stored calibration as prior.

    Nothing is judged, and no calibration is refined to be kept: that is `recalibrate`, which takes many solves.
    Arguments are those of `recalibrate`.

    Raises:
        CalibrationError: If nothing can be adjusted (as in `recalibrate`), or no wall is flat.
    """
    done = _counter(progress, _REGISTERED)
    job = _begin(sweeps, stored, settings, given, done)
    start = job.start(job.stored)
    observed = job.observe(start)
    done()
    found, _ = job.flat(adjust(job.stored, start, observed, job.settings))
    done()
    return found


def _begin(
    sweeps: Sequence[SweepStripes],
    stored: Calibration,
    settings: RecalibrationSettings | None,
    given: Given | None,
    done: Callable[[], None],
) -> _Job:
    """The sweeps checked, their lost steps, and the first places of their stations."""
    settings, given = settings or RecalibrationSettings(), given or Given()
    scanner = require_prior(stored)
    _check(sweeps, scanner)
    table = check_angles(sweeps, scanner)
    done()
    count, start = len({sweep.station for sweep in sweeps}), None
    if given.stations is not None:
        if np.shape(given.stations) != (count, 4, 4):
            raise CalibrationError(
                f"stations: found {len(given.stations)} poses, expected one for each of {count} stations."
            )
        start = dict(enumerate(np.asarray(given.stations, np.float64)))
    job = _Job(sweeps, scanner, settings, given, table, np.eye(4)[None])
    job = job._replace(stations=place_stations(job.turned(), scanner, tracks=given.tracks, start=start))
    done()
    return job


def _check(sweeps: Sequence[SweepStripes], scanner: Scanner) -> None:
    if not sweeps:
        raise CalibrationError("No sweep was given; a recalibration needs at least one sweep of a room.")
    camera = scanner.camera
    for sweep in sweeps:
        size, word = (camera.height, "rows") if sweep.stripe_axis == "rows" else (camera.width, "columns")
        if size and sweep.centre.shape[1] != size:
            raise CalibrationError(
                f"{sweep.name}: has stripes on {sweep.centre.shape[1]} {word}, the calibration is for images of "
                f"{camera.width} x {camera.height} px; use the calibration of this camera mode."
            )
        if sweep.stripe_axis != sweeps[0].stripe_axis:
            raise CalibrationError(f"{sweep.name}: its stripes run along the other axis; expected one rig for all.")
        if len(sweep.laser) and int(np.max(sweep.laser)) >= len(scanner.laser_names):
            raise CalibrationError(
                f"{sweep.name}: has {int(np.max(sweep.laser)) + 1} lasers, the calibration {len(scanner.laser_names)}; "
                "use the calibration of this rig."
            )


def _check_without(job: _Job, observed: RoomObservations, start: Start, doubt: str) -> None:
    """Refuse lengths that the stored calibration contradicts where the sweeps alone show no drift that explains them.

    With a rig that may have been knocked, a wrong length would bend the calibration until it fits.
    """
    alone = observed._replace(lengths=())
    free = adjust(start.scanner, start, alone, job.settings)
    verdict = judge.find_drift(job.stored, free, lambda prior, before: job.solve(prior, before, alone))
    if not verdict.drift.drifted:
        raise GivenError(f"{doubt}; without the known lengths, the sweeps show no drift.")
    check_adjusted(observed, job.turned(verdict.adjusted.corrections), verdict.adjusted.scanner)


def _judged(job: _Job, verdict: judge.Verdict, done: Callable[[], None]) -> Recalibration:
    """The result of a solve, with its verdicts."""
    stored, adjusted = job.stored, verdict.adjusted
    names = stored.parameter_names()
    prior = judge.with_covariance(stored, np.asarray(stored.covariance) + verdict.loosened)
    held_out = judge.hold_out(adjusted, stored, lambda observations: job.solve(prior, adjusted, observations))
    done()
    gained, solved = judge.compared_of(verdict, stored)
    slopes = judge.scale_slopes(adjusted.scanner, adjusted.observations, adjusted.corrections)
    lengths = judge.length_gains(predict_lengths(stored), predict_lengths(adjusted.scanner))
    refused = judge.refuse_result(adjusted, gained, verdict.drift, held_out, lengths)
    corrected = job.turned(adjusted.corrections)
    if not refused:
        check_adjusted(adjusted.observations, corrected, adjusted.scanner)
    panoramas, hidden = _panoramas(job, adjusted)
    result = Recalibration(
        scanner=stored if refused else adjusted.scanner,
        updated=not refused,
        refused=refused,
        # The gain is reported against the stored covariance, even where a part of that prior was given up.
        adjusted=replace(adjusted, prior=stored),
        drift=verdict.drift,
        gains=judge.gains_of(gained, judge.scales_of(gained, slopes), names),
        unobserved=judge.unobserved(solved, judge.scales_of(solved, slopes), names),
        moved=judge.moved_parameters(stored, adjusted.departure, solved, verdict.loosened),
        hold_out=held_out,
        table=job.table,
        closure=judge.closure_of(adjusted, stored),
        panoramas=panoramas,
        notes=(*verdict.notes, *hidden),
        lengths=lengths,
        known=found_lengths(adjusted.observations, corrected, adjusted.scanner),
    )
    done()
    return result


def _panoramas(job: _Job, adjusted: Adjusted) -> tuple[tuple[PanoramaOfWalls, ...], list[str]]:
    """A picture of the walls of every sweep that has some, and a note for each that has none."""
    scanners = job.stored, adjusted.scanner
    found, missed = [], []
    for sweep, known, corrections in zip(job.sweeps, job.table.corrections, adjusted.corrections, strict=True):
        try:
            labels = label_planes(sweep.turned(corrections), adjusted.scanner)
        except CalibrationError as problem:
            missed.append(f"no panorama of {sweep.name}: {problem}")
            continue
        found.append(judge.panorama_of(sweep, labels, scanners, (known, corrections)))
    return tuple(found), missed


def _counter(progress: Progress | None, stages: int) -> Callable[[], None]:
    numbers = iter(range(1, stages + 1))
    return lambda: None if progress is None else progress(next(numbers), stages)
