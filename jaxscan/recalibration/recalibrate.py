"""Sweeps and a stored calibration to a better one, or to the reason why not."""

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
from jaxscan.recalibration.lengths import check_adjusted, check_lengths, found_lengths, lost_lengths
from jaxscan.recalibration.observe import observe_room
from jaxscan.recalibration.observed import Given, RecalibrationSettings, RoomObservations, SweepStripes
from jaxscan.recalibration.renew import require_prior
from jaxscan.recalibration.result import Adjusted, PanoramaOfWalls, Recalibration, Start, TableFindings
from jaxscan.recalibration.segment import find_patches, flat
from jaxscan.recalibration.stations import place_stations
from jaxscan.recalibration.table import check_angles, say_lost_steps
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

    @property
    def corrections(self) -> tuple[Float[np.ndarray, " records"], ...]:
        """Known faults of the angles of every sweep [rad]."""
        return self.table.corrections or tuple(np.zeros(len(sweep.angle)) for sweep in self.sweeps)


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
        sweeps: Stripes of each sweep; their `station` tells from where each was taken.
        stored: Its covariance is the prior; nothing in it is changed.
        settings: Of the recalibration.
        given: Beside the sweeps: tracks, known lengths, spheres, boards, places of stations.
        progress: Called with (stages done, stages in all).

    Returns:
        The new scanner and everything by which it can be judged. Where the update is refused, `updated` is False,
        `refused` says why in one line, and the scanner is the stored one.

    Raises:
        CalibrationError: If nothing can be adjusted at all: no sweeps, no plane in them, a stored calibration without
            covariance, sheet or table, or sweeps of a camera of another size.
        GivenError: If something that was given contradicts the sweeps.
    """
    settings, given = settings or RecalibrationSettings(), given or Given()
    scanner = require_prior(stored)
    _check(sweeps, scanner)
    done = _counter(progress)
    job = _Job(sweeps, scanner, settings, given, check_angles(sweeps, scanner))
    done()
    stations = _first_stations(job)
    if given.tracks is not None and len(stations) > 1:
        given = replace(given, tracks=place_tracks(given.tracks, _corrected(job), scanner, stations))
        job = job._replace(given=given)
    done()
    loose = judge.loose(scanner)
    start = Start(loose, stations, job.corrections)
    observed = observe_room(sweeps, start, given, settings)
    doubts = check_lengths(observed, _corrected(job), scanner, loose)
    if doubts:
        _check_without(job, observed, start, doubts[0])
    # Only the scanner of this solve is used: one angle per step would cost much and change it little.
    rough = adjust(loose, start._replace(scanner=scanner), observed, replace(settings, angles="model"))
    done()
    start = Start(rough.scanner, rough.stations, job.corrections)
    observed = observe_room(sweeps, start, given, settings)
    done()
    free = adjust(loose, start, observed, settings)
    done()
    kept = np.flatnonzero(flat(free))
    uneven = [judge.describe_surface(free.surfaces, k) for k in range(len(free.surfaces.kind)) if k not in kept]
    if "plane" not in {free.surfaces.kind[k] for k in kept}:
        raise CalibrationError(judge.none_is_flat(free))
    lost = lost_lengths(observed.lengths, kept.tolist())
    if uneven:
        observed = observed.only(kept.tolist())
        free = adjust(loose, _after(job, free), observed, settings)
    done()
    solve = lambda prior, before: adjust(prior, _after(job, before), observed, settings)
    verdict = judge.find_drift(scanner, free, solve, settings)
    done()
    result = _judged(job, verdict, done)
    notes = [f"left out, because it is not flat: {name}" for name in uneven]
    if settings.angles == "steps" and not job.table.jumps:
        notes += say_lost_steps(verdict.adjusted, [sweep.name for sweep in sweeps])
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

    Args:
        sweeps: Stripes of each sweep; their `station` tells from where each was taken.
        stored: As of `recalibrate`; without a covariance of its own nothing can be registered.
        settings: Of the adjustment.
        given: Beside the sweeps, as of `recalibrate`.
        progress: Called with (stages done, stages in all).

    Raises:
        CalibrationError: If nothing can be adjusted, as of `recalibrate`, or no wall is flat.
    """
    settings, given = settings or RecalibrationSettings(), given or Given()
    scanner = require_prior(stored)
    _check(sweeps, scanner)
    done = _counter(progress, _REGISTERED)
    job = _Job(sweeps, scanner, settings, given, check_angles(sweeps, scanner))
    done()
    stations = _first_stations(job)
    done()
    start = Start(scanner, stations, job.corrections)
    observed = observe_room(sweeps, start, given, settings)
    done()
    found = adjust(scanner, start, observed, settings)
    kept = np.flatnonzero(flat(found))
    if "plane" not in {found.surfaces.kind[k] for k in kept}:
        raise CalibrationError(judge.none_is_flat(found))
    if len(kept) < len(found.surfaces.kind):
        found = adjust(scanner, _after(job, found), observed.only(kept.tolist()), settings)
    done()
    return found


def _check_without(job: _Job, observed: RoomObservations, start: Start, doubt: str) -> None:
    """Refuse lengths that the stored calibration contradicts where the sweeps alone show no drift that explains them.

    With a rig that may have been knocked, a wrong length would bend the calibration until it fits.
    """
    alone = observed._replace(lengths=())
    solve = lambda prior, before: adjust(prior, _after(job, before), alone, job.settings)
    free = adjust(start.scanner, start, alone, job.settings)
    verdict = judge.find_drift(job.stored, free, solve, job.settings)
    if not verdict.drift.drifted:
        raise GivenError(f"{doubt}; without the known lengths, the sweeps show no drift.")
    check_adjusted(observed, _corrected(job, verdict.adjusted.corrections), verdict.adjusted.scanner)


def _after(job: _Job, before: Adjusted) -> Start:
    return Start(before.scanner, before.stations, job.corrections)


def _judged(job: _Job, verdict: judge.Verdict, done: Callable[[], None]) -> Recalibration:
    """Everything that is said of a solve."""
    stored, adjusted, settings = job.stored, verdict.adjusted, job.settings
    names = stored.parameter_names()
    prior = judge.with_covariance(stored, np.asarray(stored.covariance) + verdict.loosened)
    start = _after(job, adjusted)
    halves = lambda observations: adjust(prior, start, observations, settings)
    held_out = judge.hold_out(adjusted, stored, halves)
    done()
    gained, solved = judge.compared_of(verdict, stored)
    slopes = judge.scale_slopes(adjusted.scanner, adjusted.observations, adjusted.corrections)
    lengths = judge.length_gains(predict_lengths(stored), predict_lengths(adjusted.scanner))
    refused = judge.refuse_result(adjusted, gained, verdict.drift, held_out, lengths, settings)
    corrected = _corrected(job, adjusted.corrections)
    if not refused:
        check_adjusted(adjusted.observations, corrected, adjusted.scanner)
    panoramas, hidden = _panoramas(job, adjusted)
    result = Recalibration(
        scanner=stored if refused else adjusted.scanner,
        updated=not refused,
        refused=refused,
        # The stored covariance is told as the prior, also where a part of it was given up.
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


def _counter(progress: Progress | None, stages: int = _STAGES) -> Callable[[], None]:
    numbers = iter(range(1, stages + 1))
    return lambda: None if progress is None else progress(next(numbers), stages)


def _corrected(job: _Job, corrections: Sequence[np.ndarray] = ()) -> list[SweepStripes]:
    """The sweeps with the table's angles put right, by its known faults where no corrections are given."""
    both = zip(job.sweeps, corrections or job.corrections, strict=True)
    return [sweep.turned(correction) for sweep, correction in both]


def _first_stations(job: _Job) -> Float[np.ndarray, "stations 4 4"]:
    given = job.given.stations
    count = len({sweep.station for sweep in job.sweeps})
    if given is not None and np.shape(given) != (count, 4, 4):
        raise CalibrationError(f"stations: found {len(given)} poses, expected one for each of {count} stations.")
    start = None if given is None else dict(enumerate(np.asarray(given, np.float64)))
    return place_stations(_corrected(job), job.stored, tracks=job.given.tracks, start=start)


def _panoramas(job: _Job, adjusted: Adjusted) -> tuple[tuple[PanoramaOfWalls, ...], list[str]]:
    """A picture of the walls of every sweep that has some, and a note for each that has none."""
    scanners = job.stored, adjusted.scanner
    found, missed = [], []
    for number, sweep in enumerate(job.sweeps):
        corrections = adjusted.corrections[number]
        try:
            labels = find_patches(sweep.turned(corrections), adjusted.scanner).labels
        except CalibrationError as problem:
            missed.append(f"no panorama of {sweep.name}: {problem}")
            continue
        found.append(judge.panorama_of(sweep, labels, scanners, (job.corrections[number], corrections)))
    return tuple(found), missed
