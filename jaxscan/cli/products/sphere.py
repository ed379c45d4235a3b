"""`jaxscan measure sphere`: centre and radius of a sphere."""

import dataclasses

import numpy as np

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.measure import Point, calibrated, finite, in_metres, notes_first
from jaxscan.cli.options import CloudPath, CloudUnit, OptionalCalibrationPath, coordinates, positive
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import calibration_at, check_paths, file_at


def sphere(
    cloud: CloudPath,
    /,
    *,
    near: Point,
    radius: float,
    held: bool = False,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    json: JsonTarget = None,
) -> None:
    """Centre and radius of a sphere: `jaxscan measure sphere room.ply --near 1 0.2 0.1 --radius 0.07`.

    Args:
        cloud: The cloud.
        near: About where its centre is, x y z in metres, to within 0.09 m.
        radius: About its radius [m]; it is found, too.
        held: Keep the radius as it is given, and find the centre only.
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
        json: Write the result as JSON too.
    """
    coordinates("--near", near)
    positive("--radius", radius)
    coordinates("--radius", (radius,))
    check_paths([*file_at("CLOUD", cloud), *calibration_at("--calibration", calibration)], file_at("--json", json))
    check_json(json)
    scanner, notes = calibrated(calibration)
    points, said = in_metres(cloud, unit)
    notes += said
    found = jaxscan.measure_sphere(points, np.array(near), radius_m=radius, held=held, scanner=scanner)
    result = finite(dataclasses.asdict(found))
    out = notes_first(notes, json)
    centre = " ".join(f"{x:.4f}" for x in found.centre_m)
    sigmas = " ".join(f"{1e3 * x:.2f}" for x in found.centre_sigma_m)
    out.print(f"centre {centre} m, sigmas {sigmas} mm")
    of_radius = "held" if held else f"sigma {1e3 * found.radius_sigma_m:.2f} mm"
    out.print(f"radius {found.radius_m:.4f} m, {of_radius}; RMS {1e3 * found.rms_m:.2f} mm of {found.points} points")
    emit_json(json, "measure-sphere", result | {"held": held, "notes": notes})
