"""Reports of reconstructions."""

import dataclasses
from pathlib import Path

import numpy as np

from jaxscan.api.sweeps import doubts_of, find_stripes
from jaxscan.calibration import Calibration
from jaxscan.errors import CaptureError, MeasurementError, OutputError
from jaxscan.files import load_calibration, load_scanner
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.capture import Capture
from jaxscan.files.clouds import read_cloud
from jaxscan.files.disk import write_atomically
from jaxscan.geometry import Scanner
from jaxscan.measurement import RoomBox, measure_room
from jaxscan.reconstruction import DEFAULTS, PointCloud, Progress, reconstruct
from jaxscan.report import Beside, Facts, calibration_date, cloud_page, drawn_records, facts_of, thumbnail


def save_report(
    cloud: PointCloud, path: str | Path, *, scanner: Scanner | None = None, beside: Beside | None = None
) -> tuple[Facts, RoomBox | None]:
    """Write the report of a reconstruction: one HTML file that needs no other files.

    Args:
        cloud: In metres, z up.
        path: Report to write.
        scanner: The scanner it was made with; the sigmas of the room's dimensions then include the calibration's part.
        beside: What else is known of it, as text.

    Returns:
        The numbers of the report, and the room's dimensions where two opposite walls were found.

    Raises:
        CloudError: If the cloud has no point.
        OutputError: If the file cannot be written.
    """
    beside = Beside(name=Path(path).stem) if beside is None else beside
    try:
        box = measure_room(cloud, scanner=scanner)
    except MeasurementError as problem:
        box, beside = None, dataclasses.replace(beside, no_dimensions=str(problem))
    facts = facts_of(cloud, box)
    write_atomically(Path(path), cloud_page(facts, box, beside).encode(), error=OutputError)
    return facts, box


def report_files(cloud: Path, calibration: Path, path: Path) -> None:
    """Write the report of a cloud's file and of the calibration it was made with, by their names and digests."""
    stored = read_cloud(cloud)
    rows = calibration_rows(calibration, stored.about.calibration)
    save_report(
        stored.cloud, path, scanner=load_scanner(calibration), beside=Beside(path.stem, calibration=tuple(rows))
    )


def calibration_rows(path: Path, named: str) -> list[tuple[str, str]]:
    """Name, digest and date of a calibration, and whether it is the one that a cloud names; for `Beside`."""
    digest = calibration_digest(path)
    rows = [("file", path.name), ("digest", digest), ("date", calibration_date(load_calibration(path), path))]
    if named and named != digest:
        rows.append(("not that of the cloud", f"which was made with {named}"))
    elif named:
        rows.append(("used", "for this cloud"))
    return rows


def board_photographs(capture: Capture, calibration: Calibration) -> dict[int, bytes]:
    """Small JPEGs of the records whose views a calibration's report draws, by record.

    Raises:
        CaptureError: If the capture is not one of the calibration's, or an image cannot be read.
    """
    captures = calibration.provenance.get("captures")
    known = [one.get("digest") for one in captures if isinstance(one, dict)] if isinstance(captures, list) else []
    if capture.digest() not in known:
        raise CaptureError(f"{capture.path}: is not a capture that this calibration was made from.")
    wanted = set(drawn_records(calibration))
    found = {}
    for index, record in enumerate(capture.records):
        if record.i not in wanted:
            continue
        lit, dark = capture.pictures(index)
        frame = lit if dark is None else dark
        if frame is not None:
            found[record.i] = thumbnail(frame, capture.pixel_format)
    return found


def look_again(capture: Capture, scanner: Scanner, progress: Progress = None) -> tuple[tuple[str, ...], str]:
    """What the capture of a sweep says that its cloud does not hold.

    Stripes that were kept beside the capture serve again; else they are found, and kept.

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        progress: Called with (records done, records in all).

    Returns:
        Doubts whether all frames and angles are as they were taken, a sentence each, and a sentence on the stripes
        that gave no point.

    Raises:
        CaptureError: If the sweep has no records or no stripe, a frame cannot be read, or the images turn otherwise
            than the angles say.
        CalibrationError: If the scanner is not that of the sweep.
    """
    found = find_stripes(capture, scanner, DEFAULTS, progress=progress)
    cloud = reconstruct(capture, scanner, stripes=found.stripes, smoothed=found.smoothed)
    doubts = doubts_of(capture, scanner, cloud, found.seen)
    stripes, points = int(np.asarray(found.stripes.valid).sum()), int(np.asarray(cloud.valid).sum())
    sentence = (
        f"Of {stripes} stripe centres in the frames, {stripes - points} gave no point, because their light would be "
        f"nearer than {DEFAULTS.min_range_m:g} m, farther than {DEFAULTS.max_range_m:g} m or along the light sheet. On "
        "a line with several stripes the others are left out before they are counted."
    )
    return (*found.notes, *doubts), sentence
