"""Captured sweeps of a room to a better calibration of the rig that took them."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan import recalibration
from jaxscan.api.calibration import observe_boards, versions, with_stops
from jaxscan.api.stages import Stage, Stages, megapixels
from jaxscan.api.sweeps import find_stripes, reconstruct_capture
from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.calibration import calibration_digest, load_calibration
from jaxscan.files.capture import Capture, common_board, refuse_copies
from jaxscan.files.clouds import save_cloud, save_clouds
from jaxscan.geometry import Scanner
from jaxscan.observation import Observations, Progress
from jaxscan.recalibration import Adjusted, FeatureEyes, Given, Recalibration, RecalibrationSettings, SweepStripes
from jaxscan.reconstruction import DEFAULTS, Plan, ReconstructSettings, plan_sweep, refuse_other_motion, smooth_stripes


def recalibrate(
    captures: Capture | Sequence[Capture],
    calibration: Calibration | str | Path,
    *,
    boards: Sequence[Capture] = (),
    given: Given | None = None,
    settings: RecalibrationSettings | None = None,
    progress: Progress | None = None,
) -> Recalibration:
    """Refine a stored calibration with ordinary sweeps of a room.

    The walls must be flat; nothing else need be known of them. The stored calibration holds the directions that
    sweeps do not determine. Stripes are kept beside each capture, so that a second time only a few images are read.

    Args:
        captures: Sweeps of one room, taken with the rig as it is now.
        calibration: The stored calibration, or its file.
        boards: Captures of a calibration board, taken with the rig as it is now.
        given: Known lengths and places of stations.
        settings: Settings of the recalibration.
        progress: Called with (work done, work in all).

    Returns:
        The new scanner and everything that is needed to judge it; `calibration` is to be saved. Where nothing is to be
        updated, `refused` says why, and `calibration` is None.

    Raises:
        CaptureError: If a capture is not a sweep, is given twice, or cannot be read, or its images turn otherwise than
            its angles say.
        CalibrationError: If the calibration cannot be refined, the captures are not those of its rig, or no plane is
            found in them.
    """
    captures = [captures] if isinstance(captures, Capture) else list(captures)
    settings, given = with_stops(settings or RecalibrationSettings(), captures), given or Given()
    stored, origin = _stored(calibration)
    named = "the calibration" if isinstance(calibration, Calibration) else str(calibration)
    scanner = recalibration.require_prior(stored, named)
    _check_captures(captures, boards, scanner.camera.width, scanner.camera.height)
    recalibration.refuse_used([(str(one.path), one.digest()) for one in (*captures, *boards)], stored.provenance, named)
    # Everything that is wrong with a header or a journal is reported before an image is read.
    plans = [_named(capture, plan_sweep, capture, scanner, settings.stripes) for capture in captures]
    stages = _stages(progress, captures, boards, _SOLVES)
    sweeps, notes = _swept(captures, plans, scanner, settings, stages)
    if boards:
        given = replace(given, boards=_observed(boards, scanner.laser_names, stages.part(len(captures))))
    if given.tracks is None:
        board = boards[0].board if boards else None
        tracks, more = recalibration.observe_features(captures, sweeps, scanner, _feature_eyes(), settings, board)
        given, notes = replace(given, tracks=tracks), [*notes, *more]
    stages.done(len(captures) + 1)
    solving = lambda done, total: stages.done(len(captures) + 1 + done)
    result = recalibration.recalibrate(sweeps, stored, settings, given, progress=solving)
    result = replace(result, notes=(*notes, *result.notes), settings=settings)
    provenance = {
        "captures": [{"name": one.path.name, "digest": one.digest()} for one in (*captures, *boards)],
        "calibration": origin,
        "earlier": recalibration.earlier_captures(stored.provenance),
        "held": stored.provenance.get("held", []),
        "recalibration": _judgement(result),
        "versions": versions(),
    }
    return recalibration.renew_calibration(result, provenance)


def register(
    captures: Sequence[Capture], calibration: Calibration | str | Path, *, progress: Progress | None = None
) -> tuple[Adjusted, tuple[str, ...]]:
    """The places from which sweeps of one room were taken, by its walls; and notes on the captures.

    Targets are looked for in the images only where walls alone leave a station open.

    Args:
        captures: Sweeps, each from a place of its own; the first is in the middle of the frame.
        calibration: The calibration of the rig that took them, or its file.
        progress: Called with (work done, work in all).

    Raises:
        CaptureError: As for `recalibrate`.
        CalibrationError: As for `recalibrate`, or if the places are not found.
    """
    captures, settings = list(captures), with_stops(RecalibrationSettings(stations=True), captures)
    stored, _ = _stored(calibration)
    scanner = recalibration.require_prior(
        stored, "the calibration" if isinstance(calibration, Calibration) else str(calibration)
    )
    _check_captures(captures, (), scanner.camera.width, scanner.camera.height)
    plans = [_named(capture, plan_sweep, capture, scanner, settings.stripes) for capture in captures]
    stages = _stages(progress, captures, (), _PLACED, features=0.0)
    sweeps, notes = _swept(captures, plans, scanner, settings, stages)
    solving = lambda done, total: stages.done(len(captures) + 1 + done)
    found: Adjusted | None = None
    problem: CalibrationError | None = None
    try:
        found = recalibration.register(sweeps, stored, settings, progress=solving)
        if found.converged and not _open(found):
            return found, tuple(notes)
    except CalibrationError as raised:
        problem = raised
    # Targets may determine what walls leave open.
    tracks, said = recalibration.observe_features(captures, sweeps, scanner, _feature_eyes(), settings, None)
    if tracks is not None:
        found = recalibration.register(sweeps, stored, settings, Given(tracks=tracks))
        notes += said
    elif problem is not None:
        raise problem
    if found is None or not found.converged:
        raise CalibrationError(
            "the places of the stations were not found: walls and features of the images fit no arrangement; take the "
            "sweeps from places that see the same walls."
        )
    return found, tuple(notes)


_OPEN_M = 0.01
"""If the place of a station has a larger standard deviation [m], the walls leave it open."""


def _open(found: Adjusted) -> bool:
    """Whether the place of a station is not determined."""
    places = np.asarray(found.station_covariance)[1:, :3, :3]
    return bool(len(places)) and float(np.linalg.eigvalsh(places).max()) > _OPEN_M**2


def save_recalibrated_cloud(
    captures: Sequence[Capture],
    adjusted: Adjusted,
    scanner: Scanner,
    path: str | Path,
    *,
    settings: ReconstructSettings = DEFAULTS,
    calibration_digest: str = "",
) -> None:
    """Write the cloud of all sweeps with one scanner, in the frame of the room.

    Angles of the table that were found wrong are put right, and each sweep is turned to its station.

    Args:
        captures: The sweeps that were adjusted.
        adjusted: As `recalibrate` and `register` give it.
        scanner: With which points are computed.
        path: Its suffix chooses the format, as of `save_cloud`.
        settings: Settings of the stripes.
        calibration_digest: Digest of the scanner's calibration file.

    Raises:
        CaptureError: If a sweep cannot be read.
        CloudError: If the cloud cannot be written.
    """
    clouds = []
    for number, capture in enumerate(captures):
        right = turned(capture, adjusted.corrections[number])
        cloud = reconstruct_capture(right, scanner, settings=settings).cloud
        place = int(adjusted.observations.station[number])
        clouds.append((cloud, adjusted.stations[place], adjusted.station_covariance[place]))
    if len(clouds) == 1:
        save_cloud(clouds[0][0], path, calibration_digest=calibration_digest)
    else:
        save_clouds(clouds, path, calibration_digest=calibration_digest)


def _swept(
    captures: Sequence[Capture],
    plans: Sequence[Plan],
    scanner: Scanner,
    settings: RecalibrationSettings,
    stages: Stages,
) -> tuple[list[SweepStripes], list[str]]:
    """The stripes of every sweep, and notes on them."""
    sweeps, notes = list[SweepStripes](), list[str]()
    for number, (capture, plan) in enumerate(zip(captures, plans, strict=True)):
        found = find_stripes(capture, scanner, settings.stripes, progress=stages.part(number))
        along = found.smoothed or smooth_stripes(capture, found.stripes)
        sweeps.append(
            SweepStripes(
                name=str(capture.path),
                centre=along.u,
                sigma=along.sigma,
                shared_lines=along.shared_lines,
                valid=np.asarray(found.stripes.valid) & (along.sigma > 0),
                record=np.asarray(found.stripes.record),
                laser=np.asarray(plan.sheet),
                angle=capture.angles,
                stripe_axis=plan.stripe_axis,
                station=number if settings.stations else 0,
            )
        )
        shown = recalibration.points_of_records(scanner, sweeps[-1])
        refuse_other_motion(capture, scanner, shown, capture.off_frame, str(capture.path))
        notes += [f"{capture.path}: {note}" for note in (*capture.notes, *found.notes)]
    return sweeps, notes


def _stored(calibration: Calibration | str | Path) -> tuple[Calibration, dict[str, str]]:
    """A stored calibration, and the name and digest of its file."""
    if isinstance(calibration, Calibration):
        return calibration, {}
    digest = calibration_digest(calibration)
    return load_calibration(calibration), {"name": Path(calibration).name, "digest": digest}


def _check_captures(captures: Sequence[Capture], boards: Sequence[Capture], width: int, height: int) -> None:
    if not captures:
        raise CaptureError("No sweep was given; a recalibration needs at least one capture of a room.")
    for capture in captures:
        if capture.header.kind != "sweep":
            raise CaptureError(
                f"{capture.path}: is a calibration capture, expected a sweep of a room; give captures of a board as "
                "boards (--boards)."
            )
    for capture in boards:
        if capture.image_size != (width, height):
            raise CalibrationError(
                f"{capture.path}: its images have {capture.image_size[0]} x {capture.image_size[1]} px, the "
                f"calibration is for {width} x {height} px; use the calibration of this camera mode."
            )
    if boards:
        common_board(boards, single_lasers=True)
    refuse_copies([*captures, *boards])


def _named(capture: Capture, function: Any, *arguments: Any) -> Any:
    """The result of a function; its complaint names the capture."""
    try:
        return function(*arguments)
    except CalibrationError as problem:
        raise CalibrationError(f"{capture.path}: {problem}") from problem


def _observed(boards: Sequence[Capture], lasers: Sequence[str], progress: Progress | None) -> Observations:
    """Observations of boards whose lasers are counted as the scanner counts them."""
    seen = observe_boards(boards, progress=progress)
    names = list(seen.laser_names)
    if set(names) <= set(lasers):
        number = np.array([lasers.index(name) for name in names], np.int32)
    elif len(names) == len(lasers) == 1:
        number = np.zeros(1, np.int32)
    else:
        raise CalibrationError(
            f"{boards[0].path}: found lasers {', '.join(names)}, expected those of the calibration "
            f"({', '.join(lasers)}); use the same names in its capture.toml."
        )
    stripes = replace(seen.stripes, laser=number[np.asarray(seen.stripes.laser)])
    return replace(seen, stripes=stripes, laser_names=tuple(lasers))


def _feature_eyes() -> FeatureEyes:
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.vision import feature_eyes

    return feature_eyes()


def turned(capture: Capture, correction: np.ndarray) -> Capture:
    """A capture whose angles or positions are shifted by these amounts [rad or m]."""
    if not np.any(correction):
        return capture
    angles = (capture.angles + correction).tolist()
    records = tuple(replace(record, angle=angle) for record, angle in zip(capture.records, angles, strict=True))
    return replace(capture, records=records)


def _judgement(result: Recalibration) -> dict[str, Any]:
    """What a file records of a recalibration."""
    return {
        "settings": asdict(result.settings),
        "drift": asdict(result.drift),
        "gains": [asdict(gain) | {"factor": gain.factor} for gain in result.gains],
        "unobserved": list(result.unobserved),
        "points": int(np.count_nonzero(result.adjusted.point_kept)),
        "wall_m": result.adjusted.wall_m,
    }


# What the stages of both take, in seconds of one processor, of a sweep of 180 pairs of 640 x 512 px whose images have
# texture: faults of the table, places of the stations, a rough solve, walls, a solve, one more where a wall is not
# flat, drift, two halves, the rest.
_SOLVES = (0.1, 0.1, 51.0, 1.1, 13.0, 0.1, 17.0, 31.0, 3.0)
_PLACED = (0.2, 6.0, 1.5, 17.0)


def _stages(
    progress: Progress | None,
    captures: Sequence[Capture],
    boards: Sequence[Capture],
    solves: Sequence[float],
    *,
    features: float = 0.06,
) -> Stages:
    """Stages for every capture, the boards, features (in seconds a megapixel), and the solves."""
    pixels = [megapixels(*capture.image_size, len(capture)) for capture in captures]
    shown = sum(megapixels(*capture.image_size, len(capture)) for capture in boards)
    # What smooths the stripes of the first sweep is compiled behind its frames.
    looks = [Stage((4.2, 4.5)[number] if number < 2 else 0.0, 0.03 * size) for number, size in enumerate(pixels)]
    on_boards = Stage(2.0, 0.14 * shown) if boards else Stage(0.0)
    track = Stage(features * sum(pixels) + (4.5 if len(captures) == 1 else 0.0))
    return Stages(progress, (*looks, on_boards, track, *map(Stage, solves)))
