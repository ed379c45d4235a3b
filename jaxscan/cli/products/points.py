"""`jaxscan measure points`: between two points as they were measured."""

import dataclasses

import numpy as np

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.measure import Point, calibrated, finite, in_metres, notes_first
from jaxscan.cli.options import CloudPath, CloudUnit, OptionalCalibrationPath, coordinates, positive
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import calibration_at, check_paths, file_at


def points(
    cloud: CloudPath,
    /,
    *,
    a: Point,
    b: Point,
    within_mm: float = 50.0,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    json: JsonTarget = None,
) -> None:
    """Between two single points: `jaxscan measure points room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.

    Takes the points of the cloud that are nearest, and averages nothing: for corners and edges. For points on surfaces
    `jaxscan measure distance` is better.

    Args:
        cloud: The cloud.
        a: First place, x y z in metres.
        b: Second place, x y z in metres.
        within_mm: A point must lie within this distance of its place.
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
        json: Write the result as JSON too.
    """
    coordinates("--a", a)
    coordinates("--b", b)
    positive("--within-mm", within_mm)
    check_paths([*file_at("CLOUD", cloud), *calibration_at("--calibration", calibration)], file_at("--json", json))
    check_json(json)
    scanner, notes = calibrated(calibration)
    measured, said = in_metres(cloud, unit)
    notes += said
    found = jaxscan.measure_points(measured, np.array(a), np.array(b), within_m=within_mm / 1e3, scanner=scanner)
    result = finite(dataclasses.asdict(found))
    out = notes_first(notes, json)
    ends = (" ".join(f"{x:.4f}" for x in end) for end in (found.a_m, found.b_m))
    out.print(f"{found.value_m:.4f} m, sigma {1e3 * found.sigma_m:.2f} mm, from {next(ends)} to {next(ends)}")
    emit_json(json, "measure-points", result | {"notes": notes})
