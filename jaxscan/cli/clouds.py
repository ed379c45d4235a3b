"""`jaxscan convert`, `align`, `clean`, `register`: clouds in other formats and frames, smaller, and joined."""

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

import jaxscan
from jaxscan import api, measurement, reconstruction
from jaxscan.api.stages import Stage, Stages
from jaxscan.cli.help import Arg
from jaxscan.cli.measure import in_metres, upright
from jaxscan.cli.options import (
    CLOUD_SUFFIXES,
    CameraFormat,
    CloudColours,
    CloudColumns,
    CloudOutputPath,
    CloudPath,
    CloudUnit,
    CloudUp,
    OptionalCalibrationPath,
    Storage,
    at_least,
    check_paths,
    coordinates,
    positive,
)
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import Terminal, console, emit_json, table
from jaxscan.errors import CloudError, OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import clouds as cloud_files


if TYPE_CHECKING:
    from jaxscan.files.clouds import Reading
    from jaxscan.reconstruction import PointCloud


TARGET = (
    f"File to write; the suffix chooses the format: {CLOUD_SUFFIXES} for a cloud, .yaml (OpenCV) or .cameramodel "
    "(mrcal) for a calibration. For a capture, the new folder."
)


def convert(
    source: Annotated[Path, Arg("INPUT")],
    target: Annotated[Path, Arg("OUTPUT", text=TARGET)],
    /,
    *,
    format: CameraFormat | None = None,
    storage: Storage | None = None,
    columns: CloudColumns = None,
    colours: CloudColours = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
    epsg: int | None = None,
    offset: tuple[float, float, float] | None = None,
) -> None:
    """Convert a cloud, a calibration or a capture: `jaxscan convert room.ply room.e57`.

    Also `jaxscan convert calibration.json camera.yaml` and `jaxscan convert captures/room pictures --storage png`.

    Args:
        source: Cloud, calibration (.json) or capture (a folder) to read.
        format: Format of a calibration, if the suffix does not choose it: `ros` writes a camera_info .yaml,
            `kalibr` a camchain .yaml.
        storage: Storage of a capture: `zstd`, as new captures have it; `png`, for other programs, which is read ten
            times as slowly; or `npy`, raw frames of twice the size.
        epsg: EPSG code of the projected reference system that the cloud's coordinates are in, after `--offset`;
            stored in LAS, LAZ, E57, PLY, PCD and NPZ.
        offset: Metres x y z that are added to the cloud's coordinates, such as the place of the scanner on the map.
    """
    # `Path.is_dir` raises where a name is too long.
    is_capture = os.path.isdir(source)
    is_calibration = not is_capture and source.suffix.lower() == ".json"
    check_paths({"INPUT": source}, {"OUTPUT": target})
    given = {"--columns": columns, "--colours": colours, "--unit": unit, "--up": up, "--epsg": epsg, "--offset": offset}
    if is_capture or is_calibration:
        for option in (option for option, value in given.items() if value is not None):
            raise OptionError(f"{option}: is for clouds, and {source} is none.")
    if is_capture:
        _convert_capture(source, target, format, storage)
        return
    if storage is not None:
        raise OptionError(f"--storage: is for captures, and {source} is not the folder of one.")
    if is_calibration:
        _convert_calibration(source, target, format)
        return
    if format is not None:
        raise OptionError(f"--format: is for calibrations (.json), and {source} is none; a cloud's suffix decides.")
    cloud_files.check_cloud_path(target)
    if offset is not None:
        coordinates("--offset", offset)
    stored = api.read_cloud(source, _reading(columns, colours))
    cloud, notes = cloud_files.in_metres(stored, unit)
    if up is not None:
        cloud, _ = cloud_files.with_z_up(stored, cloud, up)
    elif not stored.about.upright:
        notes.append("the file does not say what is up; z is, in what is written (--up).")
    if offset is not None:
        cloud = cloud_files.shifted(cloud, offset)
    code = epsg
    if code is None and stored.about.epsg is not None:
        # The code of a map in feet is not that of the same map in metres.
        if stored.about.metres in (None, cloud_files.METRE) and unit in (None, "m"):
            code = stored.about.epsg
        else:
            notes.append(f"EPSG:{stored.about.epsg} is of the coordinates before they became metres; it is left out.")
    api.save_cloud(cloud, target, calibration_digest=stored.about.calibration, epsg=code)
    points = int(np.asarray(cloud.valid).sum())
    out = console(notes)
    out.print(f"written: {target} ({points:,} points)")
    emit_json({"source": str(source), "cloud": str(target), "points": points, "notes": notes})


def _reading(columns: str | None, colours: str | None) -> "Reading":
    try:
        listed = None if columns is None else cloud_files.parse_columns(columns)
    except ValueError as problem:
        raise OptionError(f"--columns: {problem}.") from problem
    return cloud_files.Reading(listed, None if colours is None else 0.0 if colours == "none" else float(colours))


def _convert_calibration(source: Path, target: Path, camera_format: CameraFormat | None) -> None:
    chosen = calibration_files.check_camera_path(target, camera_format)
    calibration_files.export_camera(api.load_calibration(source), target, chosen)
    out, notes = console(), calibration_files.calibration_notes(source)
    out.notes(notes)
    out.print(f"written: {target} (camera for {chosen})")
    result = {"source": str(source), "camera": str(target), "camera_format": chosen, "notes": notes}
    emit_json(result)


def _convert_capture(source: Path, target: Path, camera_format: CameraFormat | None, storage: Storage | None) -> None:
    if camera_format is not None:
        raise OptionError(f"--format: is for calibrations (.json), and {source} is a folder.")
    # Here, so that `--help` does not load it.
    from jaxscan.files import recording

    if storage is None:
        raise OptionError(f"--storage: is needed to convert the capture {source}: {', '.join(recording.STORAGES)}.")
    recording.check_new_folder(target)
    with progress_bar("Converting") as progress:
        capture = recording.repack_capture(source, target, storage=storage, progress=progress)
    console().print(f"written: {target} ({len(capture)} records, {storage})")
    emit_json(
        {"source": str(source), "capture": str(target), "storage": storage, "records": len(capture)},
    )


def align(
    cloud: CloudPath,
    /,
    *,
    output: CloudOutputPath,
    targets: Annotated[Path | None, Arg("FILE")] = None,
    room: bool = False,
    unit: CloudUnit = None,
    up: CloudUp = None,
) -> None:
    """Put a cloud in a frame: `jaxscan align room.ply -o levelled.ply --room`, or `--targets targets.toml`.

    Lengths stay as they are: the cloud is turned and shifted. The JSON holds the 4 x 4 transform from the cloud in
    metres, with z up for --room.

    Args:
        cloud: The cloud (.ply or .npz).
        output: Cloud to write.
        targets: TOML file with three or more [[target]], each with name, scanner = [x, y, z] and site = [x, y, z] in
            metres.
        room: Floor to z = 0, the longer wall along x, the origin in a corner.
    """

    if room == (targets is not None):
        found = "both --room and" if room else "neither --room nor"
        raise OptionError(f"found {found} --targets, expected one of them.")
    check_paths({"CLOUD": cloud, "--targets": targets}, {"--output": output})
    if targets is not None and up is not None:
        raise OptionError("--up: found with --targets, which say by themselves what is up.")
    cloud_files.check_cloud_path(output)
    points, notes = in_metres(cloud, unit) if targets is not None else upright(cloud, unit, up)
    out = console(notes)
    transform, result = _to_room(points, out) if targets is None else _to_targets(targets, out)
    jaxscan.save_cloud(jaxscan.align_cloud(points, transform), output)
    out.print(f"written: {output}")
    emit_json(
        {"source": str(cloud), "cloud": str(output), "transform_m": transform.tolist(), **result} | {"notes": notes},
    )


def _to_targets(path: Path, out: Terminal) -> tuple[np.ndarray, dict[str, Any]]:
    from jaxscan.files.targets import load_targets

    names, scanner, site = load_targets(path)
    found = jaxscan.align_targets(scanner, site, names=names)
    rows = [
        (name, *(f"{1e3 * part:+.1f}" for part in residual), f"{1e3 * np.linalg.norm(residual):.1f}")
        for name, residual in zip(names, found.residuals_m, strict=True)
    ]
    out.print(table("Targets: known less placed, mm", ("", "x", "y", "z", "distance"), rows))
    place = float(found.sigma_at(found.centre_m))
    far = float(np.mean([found.sigma_at(found.centre_m + 5.0 * axis) for axis in np.eye(3)]))
    out.print(
        f"sigma of a target's coordinate {1e3 * found.sigma_m:.1f} mm, from {found.freedom} residuals to spare; the "
        f"frame is placed to {1e3 * place:.1f} mm amid the targets and to {1e3 * far:.1f} mm 5 m from there"
    )
    longer = 1e2 * (found.scale - 1)
    out.print(f"distances between targets are {longer:+.3f} % longer on the site; lengths stay as scanned")
    return found.transform, {
        "targets": {name: residual.tolist() for name, residual in zip(names, found.residuals_m, strict=True)},
        "sigma_m": found.sigma_m,
        "residuals_to_spare": found.freedom,
        "sigma_amid_targets_m": place,
        "sigma_5_m_away_m": far,
        "distances_site_to_scanner": found.scale,
    }


def _to_room(points: "PointCloud", out: Terminal) -> tuple[np.ndarray, dict[str, Any]]:
    found = jaxscan.align_room(points)
    names = ("cross wall, x = 0", "longer wall, y = 0", "floor, z = 0")
    values = zip(names, found.sigma_m, found.wall_rms_m, strict=True)
    rows = [(name, f"{1e3 * sigma:.2f}", f"{1e3 * rms:.2f}") for name, sigma, rms in values]
    out.print(table("Room", ("", "sigma of the origin, mm", "RMS mm"), rows))
    out.print(
        f"the walls meet at {found.corner_deg:.2f}°, of which the longer is along x; the scanner leaned by "
        f"{found.tilt_deg:.2f}°. sigma covers the noise of the points only."
    )
    return found.transform, {
        "sigma_origin_m": found.sigma_m.tolist(),
        "rms_m": found.wall_rms_m.tolist(),
        "corner_deg": found.corner_deg,
        "tilt_deg": found.tilt_deg,
    }


def clean(
    cloud: CloudPath,
    /,
    *,
    output: CloudOutputPath,
    box: Annotated[tuple[float, float, float, float, float, float] | None, Arg("X Y Z X Y Z")] = None,
    thin_mm: float | None = None,
    isolated_mm: float | None = None,
    neighbours: int = 3,
    unit: CloudUnit = None,
) -> None:
    """Leave out points of a cloud: `jaxscan clean room.ply -o small.ply --isolated-mm 30 --thin-mm 10`.

    In this order: what is outside of a box, what stands alone, and all but one point in each small cube. The points
    that stay are as they were, in their places of the grid.

    Args:
        cloud: The cloud.
        output: Cloud to write.
        box: Keep what is between two corners, x y z and x y z in metres.
        thin_mm: Keep one point in each cube of this side, that with the smallest sigma.
        isolated_mm: Leave out points that have fewer than --neighbours others within this distance.
        neighbours: Neighbours that a point needs.
    """
    if box is None and thin_mm is None and isolated_mm is None:
        raise OptionError("found none of --box, --thin-mm and --isolated-mm, expected one of them or more.")
    for option, value in (("--thin-mm", thin_mm), ("--isolated-mm", isolated_mm)):
        if value is not None:
            positive(option, value)
    at_least(1, "--neighbours", neighbours)
    coordinates("--box", box or ())
    if box is not None and not all(low < high for low, high in zip(box[:3], box[3:], strict=True)):
        raise OptionError("--box: found a corner that is not below the other, expected the lower one first.")
    check_paths({"CLOUD": cloud}, {"--output": output})
    cloud_files.check_cloud_path(output)
    stored = api.read_cloud(cloud)
    points, notes = in_metres(cloud, unit)
    left: dict[str, int] = {}

    def keep(name: str, mask: np.ndarray) -> None:
        nonlocal points
        left[name] = int(np.count_nonzero(points.valid)) - int(np.count_nonzero(mask))
        points = dataclasses.replace(points, valid=mask)

    if box is not None:
        keep("outside of the box", measurement.in_box(points, np.array(box[:3]), np.array(box[3:])))
    if isolated_mm is not None:
        keep("isolated", measurement.with_neighbours(points, isolated_mm / 1e3, neighbours))
    if thin_mm is not None:
        keep("in cubes with a better one", measurement.thinned(points, thin_mm / 1e3))
    kept = int(np.count_nonzero(points.valid))
    if kept == 0:
        raise CloudError(f"{cloud}: no point is left: {_listed(left)}; ask for less.")
    epsg = stored.about.epsg if stored.about.in_metres else None
    api.save_cloud(points, output, calibration_digest=stored.about.calibration, epsg=epsg)
    out = console(notes)
    out.print(f"left out: {_listed(left)}")
    out.print(f"written: {output} ({kept:,} points)")
    emit_json({"source": str(cloud), "cloud": str(output), "points": kept, "left_out": left} | {"notes": notes})


def _listed(left: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in left.items())


def register(
    sources: Annotated[tuple[Path, ...], Arg("STATION")],
    /,
    *,
    output: CloudOutputPath,
    calibration: OptionalCalibrationPath = None,
) -> None:
    """Join stations to one cloud: `jaxscan register captures/a captures/b -c calibration.json -o room.e57`.

    Sweeps of one room from several places are registered by their walls, in one least squares with the calibration;
    the first is in the middle of the frame. Clouds that are in one frame already, as `jaxscan align --targets` or this
    verb made them, are put together as they are. E57 and PTX hold a scan for each station.

    Args:
        sources: Two or more sweeps (folders), or two or more clouds of one frame.
        output: Cloud to write.
        calibration: Of sweeps: the calibration of the rig that took them.
    """
    sweeps = [path for path in sources if path.is_dir()]
    if len(sources) < 2 or 0 < len(sweeps) < len(sources):
        found = f"{len(sweeps)} folders and {len(sources) - len(sweeps)} clouds"
        raise OptionError(f"found {found}, expected two or more sweeps (folders), or two or more clouds.")
    if bool(sweeps) != (calibration is not None):
        expected = "one for sweeps" if sweeps else "none for clouds, which are made already"
        raise OptionError(f"--calibration: found {'none' if sweeps else calibration}, expected {expected}.")
    kept = [path / capture_files.CACHE_NAME for path in sweeps]
    check_paths({"STATION": sources, "-c": calibration}, {"--output": output}, kept={"the stripes": kept})
    cloud_files.check_cloud_path(output)
    out = console()
    if calibration is not None:
        stations = _register_sweeps(sweeps, calibration, output, out)
    else:
        stations = _stack_clouds(sources, output)
    for path, station in zip(sources, stations, strict=False):
        where = " ".join(f"{value:.3f}" for value in station["at_m"])
        sigma = "" if station["sigma_m"] is None else f", ±{1e3 * station['sigma_m']:.2f} mm"
        out.print(f"{path}: stands at {where} m{sigma}")
    out.print(f"written: {output} ({len(stations)} stations)")
    emit_json({"cloud": str(output), "stations": stations})


def _register_sweeps(sweeps: list[Path], calibration: Path, output: Path, out: Terminal) -> list[dict[str, Any]]:
    captures = [api.open_capture(path) for path in sweeps]
    digest = calibration_files.calibration_digest(calibration)
    with progress_bar("Registering") as progress:
        # Their clouds take a sixth of the time.
        records = float(sum(map(len, captures)))
        stages = Stages(progress, (Stage(0.0, 5.0 * records), Stage(records)))
        adjusted, notes = api.register(captures, calibration, progress=stages.part(0))
        api.save_recalibrated_cloud(captures, adjusted, adjusted.scanner, output, calibration_digest=digest)
    out.notes([*calibration_files.calibration_notes(calibration), *notes])
    return [_station(*one) for one in zip(adjusted.stations, adjusted.station_covariance, strict=True)]


def _stack_clouds(paths: tuple[Path, ...], output: Path) -> list[dict[str, Any]]:
    stored = [api.read_cloud(path) for path in paths]
    for path, one in zip(paths, stored, strict=True):
        if one.cloud.stations is None or not one.about.in_metres:
            raise CloudError(
                f"{path}: does not say where its scanner stood, expected clouds of one frame; give the sweeps "
                "(folders) with -c, or put each cloud in the frame first: jaxscan align --targets."
            )
    digests = {one.about.calibration for one in stored}
    together = reconstruction.stack_placed([one.cloud for one in stored])
    api.save_cloud(together, output, calibration_digest=digests.pop() if len(digests) == 1 else "")
    stations = together.stations
    # Every cloud has stations: one without was refused above.
    each = () if stations is None else zip(stations.pose, stations.covariance, strict=True)
    return [_station(*one) for one in each]


def _station(pose: np.ndarray, covariance: np.ndarray) -> dict[str, Any]:
    """Position of a station, and the largest standard deviation of its coordinates; None where that is unknown."""
    variance = float(np.linalg.eigvalsh(np.asarray(covariance)[:3, :3])[-1])
    at = [float(value) for value in np.asarray(pose)[:3, 3]]
    return {"pose": np.asarray(pose).tolist(), "at_m": at, "sigma_m": variance**0.5 if variance > 0 else None}
