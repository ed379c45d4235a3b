"""`jaxscan convert`: a cloud to another format, a calibration for other programs, a capture to another storage."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from jaxscan import api
from jaxscan.cli.options import CLOUD_SUFFIXES, CloudColours, CloudColumns, CloudUnit, CloudUp, coordinates
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import calibration_at, capture_at, check_paths, file_at
from jaxscan.cli.progress import progress_bar
from jaxscan.errors import OptionError
from jaxscan.files.calibration import CameraFormat, calibration_notes, check_camera_path, export_camera
from jaxscan.files.clouds import METRE, Reading, check_cloud_path, in_metres, parse_columns, shifted, with_z_up
from jaxscan.files.recording import STORAGES, Storage, check_new_folder, repack_capture


TARGET = (
    f"File to write; the suffix chooses the format: {CLOUD_SUFFIXES} for a cloud, .yaml (OpenCV) or .cameramodel "
    "(mrcal) for a calibration. For a capture, the new folder."
)


def convert(
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="INPUT")],
    target: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUTPUT", help=TARGET)],
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
    json: JsonTarget = None,
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
        json: Write the result as JSON too.
    """
    writes = [*file_at("OUTPUT", target), *file_at("--json", json)]
    check_paths(file_at("INPUT", source), writes)
    given = {"--columns": columns, "--colours": colours, "--unit": unit, "--up": up, "--epsg": epsg, "--offset": offset}
    if source.is_dir() or source.suffix.lower() == ".json":
        for option in (option for option, value in given.items() if value is not None):
            raise OptionError(f"{option}: is for clouds, and {source} is none.")
    if source.is_dir():
        check_paths(capture_at("INPUT", source), writes)
        _convert_capture(source, target, format, storage, json)
        return
    if storage is not None:
        raise OptionError(f"--storage: is for captures, and {source} is not the folder of one.")
    if source.suffix.lower() == ".json":
        check_paths(calibration_at("INPUT", source), writes)
        _convert_calibration(source, target, format, json)
        return
    if format is not None:
        raise OptionError(f"--format: is for calibrations (.json), and {source} is none; a cloud's suffix decides.")
    check_cloud_path(target)
    check_json(json)
    if offset is not None:
        coordinates("--offset", offset)
    stored = api.read_cloud(source, _reading(columns, colours))
    cloud, notes = in_metres(stored, unit)
    if up is not None:
        cloud, _ = with_z_up(stored, cloud, up)
    elif not stored.about.upright:
        notes.append("the file does not say what is up; z is, in what is written (--up).")
    if offset is not None:
        cloud = shifted(cloud, offset)
    code = epsg
    if code is None and stored.about.epsg is not None:
        # The code of a map in feet is not that of the same map in metres.
        if stored.about.metres in (None, METRE) and unit in (None, "m"):
            code = stored.about.epsg
        else:
            notes.append(f"EPSG:{stored.about.epsg} is of the coordinates before they became metres; it is left out.")
    api.save_cloud(cloud, target, calibration_digest=stored.about.calibration, epsg=code)
    points = int(np.asarray(cloud.valid).sum())
    out = console(json)
    for note in notes:
        out.print(f"note: {note}")
    out.print(f"written: {target} ({points:,} points)")
    emit_json(json, "convert", {"source": str(source), "cloud": str(target), "points": points, "notes": notes})


def _reading(columns: str | None, colours: str | None) -> Reading:
    try:
        listed = None if columns is None else parse_columns(columns)
    except ValueError as problem:
        raise OptionError(f"--columns: {problem}.") from problem
    return Reading(listed, None if colours is None else 0.0 if colours == "none" else float(colours))


def _convert_calibration(source: Path, target: Path, camera_format: CameraFormat | None, json: JsonTarget) -> None:
    chosen = check_camera_path(target, camera_format)
    check_json(json)
    export_camera(api.load_calibration(source), target, chosen)
    out, notes = console(json), calibration_notes(source)
    for note in notes:
        out.print(f"note: {note}")
    out.print(f"written: {target} (camera for {chosen})")
    result = {"source": str(source), "camera": str(target), "camera_format": chosen, "notes": notes}
    emit_json(json, "convert", result)


def _convert_capture(
    source: Path, target: Path, camera_format: CameraFormat | None, storage: Storage | None, json: JsonTarget
) -> None:
    if camera_format is not None:
        raise OptionError(f"--format: is for calibrations (.json), and {source} is a folder.")
    if storage is None:
        raise OptionError(f"--storage: is needed to convert the capture {source}: {', '.join(STORAGES)}.")
    check_new_folder(target)
    check_json(json)
    with progress_bar("Converting") as progress:
        capture = repack_capture(source, target, storage=storage, progress=progress)
    console(json).print(f"written: {target} ({len(capture)} records, {storage})")
    emit_json(
        json,
        "convert",
        {"source": str(source), "capture": str(target), "storage": storage, "records": len(capture)},
    )
