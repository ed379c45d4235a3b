"""`jaxscan measure`: a cloud to numbers."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from jaxscan import api
from jaxscan.cli.options import CloudPath, finite, positive
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json, table
from jaxscan.measurement import Dimension, ErrorStatistics


Point = tuple[float, float, float]
Calibration = Annotated[Path | None, tyro.conf.arg(aliases=["-c"])]


def measure() -> None:
    """Measure a cloud: room, distance, plane or compare (`jaxscan measure room --help`)."""


def room(cloud: CloudPath, /, *, calibration: Calibration = None, json: JsonTarget = None) -> None:
    """Wall to wall: `jaxscan measure room room.ply -c calibration.json`.

    Args:
        cloud: Cloud of a room, scanned from within.
        calibration: The scanner it was made with; then sigma includes the calibration's part.
        json: Write the result as JSON too.
    """
    check_json(json)
    scanner = None if calibration is None else api.load_scanner(calibration)
    box = api.measure_room(api.load_cloud(cloud), scanner=scanner)
    sides = {name: side for name in ("length", "width", "height") if (side := getattr(box, name)) is not None}
    columns = ("", "m", "sigma mm", "wall RMS mm", "points", "not parallel by")
    console(json).print(table("Room", columns, [_room_row(name, side) for name, side in sides.items()]))
    if scanner is None:
        console(json).print("sigma is that of the points alone; give --calibration for the whole.")
    emit_json(json, "measure-room", {name: _dimension(side) for name, side in sides.items()})


def distance(
    cloud: CloudPath,
    /,
    *,
    a: Point,
    b: Point,
    radius_mm: float = 20.0,
    calibration: Calibration = None,
    json: JsonTarget = None,
) -> None:
    """Between two picked points: `jaxscan measure distance room.ply --a 1 0.2 0.1 --b 1 -0.8 0.1`.

    Args:
        cloud: The cloud.
        a: First point, x y z in metres.
        b: Second point, x y z in metres.
        radius_mm: Points this near to a picked point are averaged.
        calibration: The scanner it was made with; then sigma includes the calibration's part.
        json: Write the result as JSON too.
    """
    finite("--a", a)
    finite("--b", b)
    positive("--radius-mm", radius_mm)
    check_json(json)
    scanner = None if calibration is None else api.load_scanner(calibration)
    found = api.measure_distance(
        api.load_cloud(cloud), np.array(a), np.array(b), radius_m=radius_mm / 1e3, scanner=scanner
    )
    out = console(json)
    out.print(
        f"{found.value_m:.4f} m, sigma {1e3 * found.sigma_m:.2f} mm, "
        f"from {found.points[0]} and {found.points[1]} points"
    )
    if found.plane_to_plane_m is not None and found.plane_to_plane_sigma_m is not None:
        sigma_mm = 1e3 * found.plane_to_plane_sigma_m
        out.print(f"between their planes: {found.plane_to_plane_m:.4f} m, sigma {sigma_mm:.2f} mm")
    emit_json(json, "measure-distance", _plain(dataclasses.asdict(found)))


def plane(cloud: CloudPath, /, *, at: Point, radius_mm: float = 200.0, json: JsonTarget = None) -> None:
    """Flatness round a point: `jaxscan measure plane room.ply --at 1.9 0.2 0.1`.

    Args:
        cloud: The cloud.
        at: A point of the plane, x y z in metres.
        radius_mm: Points this near to it are taken.
        json: Write the result as JSON too.
    """
    finite("--at", at)
    positive("--radius-mm", radius_mm)
    check_json(json)
    found = api.measure_plane(api.load_cloud(cloud), np.array(at), radius_m=radius_mm / 1e3)
    console(json).print(
        f"RMS {1e3 * found.rms_m:.2f} mm, 95 % of {found.points} points within {1e3 * found.range95_m:.2f} mm, "
        f"normal {np.array2string(found.normal, precision=4)}"
    )
    emit_json(json, "measure-plane", _plain(dataclasses.asdict(found)))


def compare(cloud: CloudPath, truth: CloudPath, /, *, calibration: Calibration = None, json: JsonTarget = None) -> None:
    """Against a true or better cloud: `jaxscan measure compare room.ply truth.npz`.

    Args:
        cloud: The cloud.
        truth: The cloud to compare with; on the same grid, cell is compared with cell.
        calibration: The scanner it was made with, for errors along the ray.
        json: Write the result as JSON too.
    """
    check_json(json)
    scanner = None if calibration is None else api.load_scanner(calibration)
    found = api.compare_clouds(api.load_cloud(cloud), api.load_cloud(truth), scanner=scanner)
    rows = [_error_row("distance", found.error_m)]
    if found.along_ray_m is not None:
        rows.append(_error_row("along the ray", found.along_ray_m))
    out = console(json)
    out.print(table("Error, mm", ("", "RMS", "mean", "median", "95 %", "largest"), rows))
    out.print(f"{found.points} points compared; {100 * found.completeness:.1f} % of the true ones have a point")
    out.print(f"{found.false_points} points where the truth has none")
    emit_json(json, "measure-compare", _plain(dataclasses.asdict(found)))


def _room_row(name: str, side: Dimension) -> tuple[str, ...]:
    return (
        name,
        f"{side.value_m:.4f}",
        f"{1e3 * side.sigma_m:.2f}",
        f"{1e3 * side.rms_m:.2f}",
        f"{side.points}",
        f"{side.angle_deg:.3f}°",
    )


def _error_row(name: str, error: ErrorStatistics) -> tuple[str, ...]:
    values = (error.rms, error.mean, error.median_abs, error.p95_abs, error.max_abs)
    return (name, *(f"{1e3 * value:.2f}" for value in values))


def _dimension(side: Dimension) -> dict[str, Any]:
    return _plain(dataclasses.asdict(side))


def _plain(value: Any) -> Any:
    """Ready for JSON: arrays as lists."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
