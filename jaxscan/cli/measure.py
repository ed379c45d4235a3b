"""`jaxscan measure`: lengths, planes, spheres, deviations and errors of a cloud."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import jaxscan
from jaxscan import measurement
from jaxscan.cli.help import Arg
from jaxscan.cli.options import (
    CloudPath,
    CloudUnit,
    CloudUp,
    OptionalCalibrationPath,
    check_paths,
    coordinates,
    positive,
)
from jaxscan.cli.terminal import console, emit_json, table
from jaxscan.errors import MeasurementError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import disk


if TYPE_CHECKING:
    from jaxscan.files.clouds import Unit, Up
    from jaxscan.geometry import Scanner
    from jaxscan.measurement import ErrorStatistics
    from jaxscan.reconstruction import PointCloud


Point = tuple[float, float, float]


def measure() -> None:
    """Measure a cloud: room, distance, plane, sphere and others (`jaxscan measure --help`)."""


def room(
    cloud: CloudPath,
    /,
    *,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
) -> None:
    """Wall to wall: `jaxscan measure room room.ply -c calibration.json`.

    Args:
        cloud: Cloud of a room, scanned from inside.
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
    """
    check_paths({"CLOUD": cloud, "--calibration": calibration})
    scanner, notes = calibrated(calibration)
    points, said = upright(cloud, unit, up)
    notes += said
    box = jaxscan.measure_room(points, scanner=scanner)
    notes += [f"a dimension is left out: {remark}." for remark in box.remarks]
    result = finite({name: dataclasses.asdict(side) for name, side in box.sides.items()})
    columns = ("", "m", "sigma mm", "wall RMS mm", "points", "not parallel by")
    rows = [
        (name, f"{side.value_m:.4f}", f"{1e3 * side.sigma_m:.2f}", f"{1e3 * side.rms_m:.2f}", f"{side.points}")
        + (f"{side.angle_deg:.3f}°",)
        for name, side in box.sides.items()
    ]
    more = "sigma covers the noise of the points only; with --calibration it also covers the calibration."
    _say([table("Room", columns, rows), *([more] if scanner is None else [])], result, notes)


def distance(
    cloud: CloudPath,
    /,
    *,
    a: Point,
    b: Point,
    radius_mm: float = 20.0,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
) -> None:
    """Between two picked points: `jaxscan measure distance room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.

    Args:
        cloud: The cloud.
        a: First point, x y z in metres.
        b: Second point, x y z in metres.
        radius_mm: The points within this distance of a picked point are averaged.
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
    """
    coordinates("--a", a)
    coordinates("--b", b)
    positive("--radius-mm", radius_mm)
    points, scanner, notes = opened(cloud, calibration, unit)
    found = jaxscan.measure_distance(points, np.array(a), np.array(b), radius_m=radius_mm / 1e3, scanner=scanner)
    _say(found.words(), finite(dataclasses.asdict(found)), notes)


def plane(cloud: CloudPath, /, *, at: Point, radius_mm: float = 200.0, unit: CloudUnit = None) -> None:
    """Flatness around a point: `jaxscan measure plane room.ply --at 1.9 0.2 0.1`.

    Args:
        cloud: The cloud.
        at: A point of the plane, x y z in metres.
        radius_mm: The plane is fitted to the points within this distance of it.
    """
    coordinates("--at", at)
    positive("--radius-mm", radius_mm)
    points, _, notes = opened(cloud, None, unit)
    found = jaxscan.measure_plane(points, np.array(at), radius_m=radius_mm / 1e3)
    _say([found.words()], finite(dataclasses.asdict(found)), notes)


def compare(
    cloud: CloudPath,
    truth: CloudPath,
    /,
    *,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
) -> None:
    """Against a true or better cloud: `jaxscan measure compare room.ply truth.npz`.

    Args:
        cloud: The cloud.
        truth: The cloud to compare with. If both have the same grid, cell is compared with cell.
        calibration: Calibration that the cloud was made with, for errors along the ray.
    """
    check_paths({"CLOUD": cloud, "TRUTH": truth, "--calibration": calibration})
    scanner, notes = calibrated(calibration)
    (points, said), (true_points, said_of_truth) = in_metres(cloud, unit), in_metres(truth, unit)
    notes += [*said, *said_of_truth]
    found = jaxscan.compare_clouds(points, true_points, scanner=scanner)
    errors = {"distance": found.error_m, "along the ray": found.along_ray_m}
    rows = [_error_row(name, error) for name, error in errors.items() if error is not None]
    lines = [
        table("Error, mm", ("", "RMS", "mean", "median", "95 %", "largest"), rows),
        f"{found.points:,} points compared; {100 * found.completeness:.1f} % of the true ones have a point",
        f"{found.false_points:,} points where the truth has none",
    ]
    _say(lines, finite(dataclasses.asdict(found)), notes)


def opened(
    cloud: Path, calibration: Path | None, unit: "Unit | None"
) -> tuple["PointCloud", "Scanner | None", list[str]]:
    """A cloud in metres, the scanner of its calibration, and notes; paths are checked first."""
    check_paths({"CLOUD": cloud, "--calibration": calibration})
    scanner, notes = calibrated(calibration)
    points, said = in_metres(cloud, unit)
    return points, scanner, [*notes, *said]


def calibrated(path: Path | None) -> tuple["Scanner | None", list[str]]:
    """The scanner of a calibration, and notes for its users."""
    if path is None:
        return None, []

    return jaxscan.load_scanner(path), calibration_files.calibration_notes(path)


def in_metres(path: Path, unit: "Unit | None") -> tuple["PointCloud", list[str]]:
    """A cloud in metres, and what was guessed."""
    from jaxscan.files import clouds

    cloud, notes = clouds.in_metres(clouds.read_cloud(path), unit)
    return cloud, _of_file(path, cloud, notes)


def upright(path: Path, unit: "Unit | None", up: "Up | None") -> tuple["PointCloud", list[str]]:
    """A cloud in metres with z up, and what was guessed."""
    from jaxscan.files import clouds

    stored = clouds.read_cloud(path)
    cloud, notes = clouds.in_metres(stored, unit)
    cloud, more = clouds.with_z_up(stored, cloud, up)
    return cloud, _of_file(path, cloud, [*notes, *more])


def _of_file(path: Path, cloud: "PointCloud", notes: Iterable[str]) -> list[str]:
    return [f"{path}: {note}" for note in (*notes, *_sigma_notes(cloud))]


def _sigma_notes(cloud: "PointCloud") -> list[str]:
    """A note where the points have no uncertainty of their own."""
    lost = [name for name in ("sigma_random", "sigma_systematic") if name in cloud.lacks]
    if "sigma_random" in lost:
        return [
            f"the cloud has no sigmas: {1e3 * measurement.SIGMA_FLOOR_M:g} mm of noise a point is assumed, more where "
            "a plane shows it, and what all points share is not known; a sigma of a result is a lower limit."
        ]
    if lost:
        return ["the cloud has no systematic sigmas: what all points share is not known, and in no sigma of a result."]
    return []


def finite(result: dict[str, Any]) -> dict[str, Any]:
    """The result, if all its numbers are finite.

    Raises:
        MeasurementError: With the name of the first that is not.
    """
    for name, value in result.items():
        if isinstance(value, dict):
            finite(value)
        elif isinstance(value, float | np.ndarray) and not np.isfinite(value).all():
            raise MeasurementError(
                f"{name} is not a finite number: the points of this cloud do not determine it; compare their unit and "
                "range with those of the place, and remove points far away."
            )
    return result


def _say(lines: Iterable[Any], result: dict[str, Any], notes: list[str]) -> None:
    """Print notes and lines or tables, and write the result as JSON."""
    out = console(notes)
    for line in lines:
        out.print(line)
    emit_json(result | {"notes": notes})


def _error_row(name: str, error: "ErrorStatistics") -> tuple[str, ...]:
    values = (error.rms, error.mean, error.median_abs, error.p95_abs, error.max_abs)
    return (name, *(f"{1e3 * value:.2f}" for value in values))


def points(
    cloud: CloudPath,
    /,
    *,
    a: Point,
    b: Point,
    within_mm: float = 50.0,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
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
    """
    coordinates("--a", a)
    coordinates("--b", b)
    positive("--within-mm", within_mm)
    measured, scanner, notes = opened(cloud, calibration, unit)
    found = jaxscan.measure_points(measured, np.array(a), np.array(b), within_m=within_mm / 1e3, scanner=scanner)
    start, end = (" ".join(f"{x:.4f}" for x in end) for end in (found.a_m, found.b_m))
    line = f"{found.value_m:.4f} m, sigma {1e3 * found.sigma_m:.2f} mm, from {start} to {end}"
    _say([line], finite(dataclasses.asdict(found)), notes)


def sphere(
    cloud: CloudPath,
    /,
    *,
    near: Point,
    radius_mm: float,
    held: bool = False,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
) -> None:
    """Centre and radius of a sphere: `jaxscan measure sphere room.ply --near 1 0.2 0.1 --radius-mm 70`.

    Args:
        cloud: The cloud.
        near: About where its centre is, x y z in metres, to within 0.09 m.
        radius_mm: About its radius; it is found, too.
        held: Keep the radius as it is given, and find the centre only.
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
    """
    coordinates("--near", near)
    positive("--radius-mm", radius_mm)
    coordinates("--radius-mm", (radius_mm,))
    points, scanner, notes = opened(cloud, calibration, unit)
    found = jaxscan.measure_sphere(points, np.array(near), radius_m=radius_mm / 1e3, held=held, scanner=scanner)
    centre = " ".join(f"{x:.4f}" for x in found.centre_m)
    sigmas = " ".join(f"{1e3 * x:.2f}" for x in found.centre_sigma_m)
    of_radius = "held" if held else f"sigma {1e3 * found.radius_sigma_m:.2f} mm"
    lines = [
        f"centre {centre} m, sigmas {sigmas} mm",
        f"radius {found.radius_m:.4f} m, {of_radius}; RMS {1e3 * found.rms_m:.2f} mm of {found.points} points",
    ]
    _say(lines, finite(dataclasses.asdict(found)) | {"held": held}, notes)


def deviations(
    cloud: CloudPath,
    /,
    *,
    at: Point,
    radius_mm: float = 500.0,
    cell_mm: float = 50.0,
    output: Annotated[Path | None, Arg(short="-o")] = None,
    unit: CloudUnit = None,
) -> None:
    """Deviations from a plane: `jaxscan measure deviations room.ply --at 1.9 0.2 0.1 -o map.png`.

    The plane is that of most points around; deviations are in square cells, towards the scanner positive, each with one
    standard deviation. In the JSON, cells without points are null.

    Args:
        cloud: The cloud.
        at: A point of the plane, x y z in metres.
        radius_mm: The points within this distance of it are looked at.
        cell_mm: Size of a cell.
        output: Picture to write (PNG): deviations in millimetres, and their sigmas beside them.
    """
    coordinates("--at", at)
    positive("--radius-mm", radius_mm)
    positive("--cell-mm", cell_mm)
    coordinates("--radius-mm", (radius_mm,))
    check_paths({"CLOUD": cloud}, {"--output": output})
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.errors import OutputError

    if output is not None:
        if output.suffix.lower() != ".png":
            raise OutputError(f'{output}: cannot write "{output.suffix}", known is .png.')
        disk.check_writable(output, error=OutputError)
    points, notes = in_metres(cloud, unit)
    found = jaxscan.measure_deviations(points, np.array(at), radius_m=radius_mm / 1e3, cell_m=cell_mm / 1e3)
    numbers = finite({name: getattr(found, name) for name in ("rms_m", "least_m", "most_m")})
    typical = float(np.median(found.sigma_m[found.seen]))
    significant = float(np.mean(np.abs(found.deviation_m[found.seen]) > 3.0 * found.sigma_m[found.seen]))
    lines = [
        f"RMS {1e3 * found.rms_m:.2f} mm, from {1e3 * found.least_m:.2f} to {1e3 * found.most_m:.2f} mm in "
        f"{int(found.seen.sum())} cells of {cell_mm:g} mm, towards the scanner positive",
        f"sigma of a cell {1e3 * typical:.2f} mm; {100 * significant:.1f} % deviate by more than 3 sigma",
    ]
    if output is not None:
        from jaxscan.report import deviation_picture

        disk.write_atomically(output, deviation_picture(found), error=OutputError)
        lines.append(f"written: {output}")
    cells = {name: np.where(found.seen, getattr(found, name), None) for name in ("deviation_m", "sigma_m")}
    places = {name: getattr(found, name) for name in ("points", "cell_m", "origin_m", "across", "up", "normal")}
    _say(lines, numbers | {"share_beyond_3_sigma": significant} | places | cells, notes)
