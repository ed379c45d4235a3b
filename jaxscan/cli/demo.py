"""`jaxscan demo`: simulates a rig, calibrates, scans and measures, and compares the results with the truth."""

import importlib.resources
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import numpy as np

from jaxscan import api, geometry, simulation, vision
from jaxscan import report as reports
from jaxscan.cli.help import Arg
from jaxscan.cli.options import check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import Terminal, console, emit_json, table
from jaxscan.errors import CaptureError, MeasurementError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import disk


if TYPE_CHECKING:
    from jaxscan.geometry import Array, Scanner
    from jaxscan.simulation import SimulationConfig


COLUMNS = ("", "measured m", "truth m", "error mm", "predicted sigma mm")
FILES = ("calibration.json", "room.ply", "room.png")
PATCH_M = 0.1


def demo(*, output: Annotated[Path, Arg(short="-o")] = Path("demo")) -> None:
    """Calibrate, scan, reconstruct and measure a simulated room: `jaxscan demo`.

    Writes calibration.json, room.ply, room.png, and the rendered images and their truth in `captures`. The truth is
    read only for the comparison at the end.

    Args:
        output: Folder to write to.
    """
    captures = output / "captures"
    reads = {"the capture": (captures / "boards", captures / "sweep")}
    reads["the truth"] = (captures / "truth.json", captures / "truth.npz")
    check_paths(reads, {"the file": [output / name for name in FILES]})
    _check_folder(output)
    out = console()
    started = time.perf_counter()
    seconds: dict[str, float] = {}
    with importlib.resources.as_file(importlib.resources.files("jaxscan.data") / "demo.toml") as path:
        config = api.load_simulation(path)

    made = _captures(config, captures, out, seconds)
    lap = time.perf_counter()
    boards, sweep = api.open_capture(made.boards), api.open_capture(made.sweep)
    with progress_bar("Calibrating from board images") as progress:
        calibration = api.calibrate(boards, progress=progress)
    seconds["calibrate"] = time.perf_counter() - lap
    out.print(f"calibrated from {len(boards)} board pairs in {seconds['calibrate']:.1f} s")
    api.save_calibration(calibration, output / "calibration.json")
    scanner = api.load_scanner(output / "calibration.json")

    lap = time.perf_counter()
    with progress_bar("Reconstructing") as progress:
        cloud = api.reconstruct(sweep, scanner, progress=progress)
    seconds["reconstruct"] = time.perf_counter() - lap
    lap = time.perf_counter()
    with progress_bar("Colouring from photographs") as progress:
        cloud = api.colour_cloud(cloud, sweep, scanner, progress=progress)
    seconds["colour"] = time.perf_counter() - lap
    points = int(np.asarray(cloud.valid).sum())
    out.print(
        f"reconstructed {points:,} points from {len(sweep)} pairs in {seconds['reconstruct']:.1f} s "
        f"({points / seconds['reconstruct']:,.0f} points a second, compiling included), "
        f"and coloured them from laser-off images in {seconds['colour']:.1f} s"
    )
    api.save_cloud(
        cloud, output / "room.ply", calibration_digest=calibration_files.calibration_digest(output / "calibration.json")
    )

    lap = time.perf_counter()
    true_cloud = api.load_cloud(made.true_cloud)
    box = api.measure_room(cloud, scanner=scanner)
    comparison = api.compare_clouds(cloud, true_cloud, scanner=scanner)
    # The demo's room is longer than it is wide.
    size = {} if config.room is None else dict(zip(("width", "length", "height"), config.room.size_m, strict=True))
    room = [_entry(name, side.value_m, size[name], side.sigma_m) for name, side in box.sides.items() if name in size]
    lengths = _length_rows(cloud, true_cloud, _true_lengths(made.truth), scanner)
    parameters = _calibration_rows(scanner, simulation.true_scanner(config))
    seconds["measure"] = time.perf_counter() - lap
    disk.write_atomically(
        output / "room.png", vision.encode_png(reports.room_picture(cloud, box).rgb), error=CaptureError
    )
    seconds["all"] = time.perf_counter() - started

    out.print(table("Room, wall to wall", COLUMNS, [_row(entry) for entry in room]))
    out.print(table("Distances between two patches of 10 cm", COLUMNS, [_row(entry) for entry in lengths]))
    out.print(table("Calibration", ("parameter", "found", "truth", "error", "predicted sigma"), parameters))
    if comparison.along_ray_m is not None:
        out.print(f"median error of a point along its ray {1e3 * comparison.along_ray_m.median_abs:.2f} mm")
    out.print(
        f"{100 * comparison.completeness:.1f} % of the lit cells have a point; "
        f"{comparison.false_points:,} points where the truth has none"
    )
    out.print(f"{seconds['all']:.0f} s in all; written: {', '.join(str(output / n) for n in FILES)}")
    look = ["jaxscan", "view", str(output / "room.ply"), "-c", str(output / "calibration.json")]
    out.print(f"next: {shlex.join(look)}")
    emit_json({"room": room, "distances": lengths, "points": points, "seconds_s": seconds})


def _check_folder(output: Path) -> None:
    """Refuse a folder with files that are not of an earlier demo."""
    if output.exists() and not output.is_dir():
        raise CaptureError(f"{output}: is a file; choose another folder with -o.")
    if output.exists() and any(output.iterdir()) and not (output / "captures" / "truth.json").is_file():
        raise CaptureError(f"{output}: holds files that are not of a demo; choose another folder with -o.")


def _read_truth(path: Path) -> dict[str, Any]:
    text = disk.read_bounded(path, disk.MEGABYTE, error=CaptureError)
    truth = disk.parse_json(text, name=str(path), error=CaptureError)
    if not isinstance(truth, dict):
        raise CaptureError(f"{path}: found no table, expected the truth of a demo; choose another folder with -o.")
    return truth


def _true_lengths(path: Path) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Name and end points [m] of the lengths to measure."""
    truth = _read_truth(path)
    try:
        lengths = [
            (str(one["name"]), np.array(one["from_m"], np.float64), np.array(one["to_m"], np.float64))
            for one in truth["room"]["distances"]
        ]
        if all(end.shape == (3,) and np.isfinite(end).all() for _, *ends in lengths for end in ends):
            return lengths
    except (KeyError, TypeError, ValueError):
        pass
    raise CaptureError(f"{path}: its distances are not as a demo writes them: a name and two points each.")


def _captures(
    config: "SimulationConfig", folder: Path, out: Terminal, seconds: dict[str, float]
) -> "api.SimulatedCaptures":
    if folder.exists():
        if _read_truth(folder / "truth.json").get("configuration") != api.simulation_digest(config):
            raise CaptureError(
                f"{folder}: holds captures of another configuration; delete it or choose another folder with -o."
            )
        out.print(f"captures of an earlier run: {folder}")
        return api.SimulatedCaptures.of(folder)
    lap = time.perf_counter()
    with progress_bar("Rendering boards and a sweep of a simulated rig") as progress:
        made = api.simulate(config, folder, progress=progress)
    seconds["render"] = time.perf_counter() - lap
    out.print(
        f"rendered {made.board_pairs} board pairs and {made.sweep_pairs} sweep pairs of "
        f"{config.camera.width} x {config.camera.height} in {seconds['render']:.1f} s"
    )
    return made


def _length_rows(
    cloud: "api.PointCloud",
    true_cloud: "api.PointCloud",
    true_lengths: Sequence[tuple[str, np.ndarray, np.ndarray]],
    scanner: "Scanner",
) -> list[dict[str, Any]]:
    """Lengths between the same two patches in the cloud and in the true cloud."""
    rows = []
    for name, a, b in true_lengths:
        try:
            found = api.measure_distance(cloud, a, b, radius_m=PATCH_M, scanner=scanner)
            true = api.measure_distance(true_cloud, a, b, radius_m=PATCH_M)
        except MeasurementError:
            continue  # Behind furniture, or outside the field of view.
        rows.append(_entry(name, found.value_m, true.value_m, found.sigma_m))
    return rows


def _calibration_rows(found: "Scanner", true: "Scanner") -> list[tuple[str, ...]]:
    """Found and true parameters, with the predicted standard deviation."""
    sigma = dict(zip(found.parameter_names(), np.sqrt(np.diag(np.asarray(found.covariance))), strict=True))
    name = found.laser_names[0]
    rows = []
    for label in ("fx", "fy", "cx", "cy"):
        rows.append(_number(f"{label}, px", getattr(found.camera, label), getattr(true.camera, label), sigma[label]))
    sheets = found.laser(0), true.laser(0)
    distances = [1e3 * float(sheet.distance) for sheet in sheets]
    rows.append(_number("laser distance, mm", distances[0], distances[1], 1e3 * sigma[f"laser.{name}.d"]))
    tilt = np.hypot(sigma[f"laser.{name}.n1"], sigma[f"laser.{name}.n2"])
    rows.append(_angle("laser normal, mrad", sheets[0].normal, sheets[1].normal, tilt))
    # The demo's rig has a table.
    axes = cast(geometry.Turntable, found.turntable), cast(geometry.Turntable, true.turntable)
    tilt = np.hypot(sigma["axis.d1"], sigma["axis.d2"])
    rows.append(_angle("axis direction, mrad", axes[0].direction, axes[1].direction, tilt))
    offset = 1e3 * float(np.linalg.norm(axes[0].point - axes[1].point))
    spread = 1e3 * np.hypot(sigma["axis.p1"], sigma["axis.p2"])
    rows.append(("axis position, mm", "", "", f"{offset:.3f}", f"{spread:.3f}"))
    rows.append(_number("gain", axes[0].gain, axes[1].gain, sigma["gain"], digits=6))
    return rows


def _number(label: str, found: Any, true: Any, sigma: float, *, digits: int = 3) -> tuple[str, ...]:
    found, true = float(found), float(true)
    return (label, *(f"{value:.{digits}f}" for value in (found, true, found - true, sigma)))


def _angle(label: str, found: "Array", true: "Array", sigma: float) -> tuple[str, ...]:
    between = np.arctan2(np.linalg.norm(np.cross(found, true)), np.dot(found, true))
    return (label, "", "", f"{1e3 * between:.3f}", f"{1e3 * sigma:.3f}")


def _entry(name: str, measured_m: float, truth_m: float, sigma_m: float) -> dict[str, Any]:
    return {
        "name": name,
        "measured_m": float(measured_m),
        "truth_m": float(truth_m),
        "error_m": float(measured_m - truth_m),
        "predicted_sigma_m": float(sigma_m),
    }


def _row(entry: dict[str, Any]) -> tuple[str, ...]:
    return (
        entry["name"],
        f"{entry['measured_m']:.4f}",
        f"{entry['truth_m']:.4f}",
        f"{1e3 * entry['error_m']:+.2f}",
        f"{1e3 * entry['predicted_sigma_m']:.2f}",
    )
