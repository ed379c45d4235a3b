"""`jaxscan info`: what a file or folder is."""

import datetime
import tomllib
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from jaxscan import api
from jaxscan import project as projects
from jaxscan import report as reports
from jaxscan.cli.help import Arg
from jaxscan.cli.options import CLOUD_SUFFIXES, check_paths
from jaxscan.cli.project import counted, in_words
from jaxscan.cli.terminal import console, emit_json
from jaxscan.errors import CloudError, ConfigError, OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import disk
from jaxscan.files.products import PRODUCTS, describe_product
from jaxscan.geometry.motion_kinds import MOTIONS


Facts = dict[str, Any]
"""Facts of a file by their names; None is left out."""


def info(file: Annotated[Path, Arg("FILE")], /) -> None:
    """Say what a file is: `jaxscan info room.ply`.

    A cloud, a calibration, a capture, a project or a configuration: its size and age, its frame and unit, what it was
    made of, and how good it is. A mesh, a drawing or a report: how large it is.

    Args:
        file: The file, or the folder of a capture.
    """
    check_paths({"FILE": file})
    if file.is_dir():
        facts = _of_capture(file)
    elif file.suffix.lower() == ".json":
        facts = _of_calibration(file)
    elif file.suffix.lower() == ".toml":
        facts = _of_toml(file)
    elif (product := describe_product(file, error=CloudError)) is not None:
        facts = product
    elif file.suffix.lower() in CLOUD_SUFFIXES.split():
        facts = _of_cloud(file)
    else:
        raise OptionError(
            f"{file}: expected a cloud ({CLOUD_SUFFIXES}), a mesh, drawing or report ({PRODUCTS}), a calibration "
            "(.json), a project or configuration (.toml), or the folder of a capture."
        )
    files = [one for one in file.rglob("*") if one.is_file()] if file.is_dir() else [file]
    status = [one.stat() for one in files]
    facts |= {"bytes": sum(one.st_size for one in status), "changed": _day(max(one.st_mtime for one in status))}
    out = console()
    for name, value in facts.items():
        if value is not None and name != "notes":
            out.print(_line(name, value))
    out.notes(facts.get("notes", ()))
    emit_json({"file": str(file), **facts})


def _of_cloud(path: Path) -> Facts:
    stored = api.read_cloud(path)
    cloud, about = stored.cloud, stored.about
    valid = np.asarray(cloud.valid)
    xyz = np.asarray(cloud.xyz)[valid]
    known = [name for name in ("sigma_random", "sigma_systematic") if name not in cloud.lacks and len(xyz)]
    scales = about.metres
    unit = "metre" if about.in_metres else "not said" if scales is None else f"{scales[0]:g} m"
    return {
        "kind": "cloud",
        "points": len(xyz),
        "grid": list(valid.shape),
        "unit": unit,
        "frame": f"EPSG:{about.epsg}" if about.epsg is not None else "room" if cloud.stations else "scanner",
        "up": "z" if about.upright else "not said",
        "stations": 1 if cloud.stations is None else len(cloud.stations.pose),
        "from": xyz.min(0).tolist() if len(xyz) else None,
        "to": xyz.max(0).tolist() if len(xyz) else None,
        **{f"median_{name}_m": float(np.median(np.asarray(getattr(cloud, name))[valid])) for name in known},
        "calibration": about.calibration or None,
        "notes": list(stored.words),
    }


def _of_calibration(path: Path) -> Facts:
    calibration = api.load_calibration(path)
    camera, scanner = calibration.camera, calibration.scanner
    first = reports.words.headline(calibration)
    return {
        "kind": "calibration",
        "verdict": f"{first.headline}. {first.explanation}",
        "date": reports.calibration_date(calibration, path) or None,
        "camera": f"{camera.model}, {camera.width} x {camera.height} px",
        "lasers": None if scanner is None else list(scanner.laser_names),
        "motion": None if scanner is None else scanner.turntable.carries,
        "digest": calibration_files.calibration_digest(path),
        "notes": calibration_files.calibration_notes(path),
    }


def _of_capture(path: Path) -> Facts:
    capture = api.open_capture(path)
    began = api.began(capture)
    angles = [record.angle for record in capture.records if record.angle is not None]
    width, height = capture.image_size
    return {
        "kind": f"capture ({capture.header.kind})",
        "records": len(capture),
        "began": None if began is None else _day(began),
        "camera": f"{width} x {height} px, {capture.pixel_format}",
        "lasers": [line.name for line in capture.lasers],
        "motion": capture.carries,
        "turned_deg": None
        if not angles or MOTIONS[capture.carries or "scanner"].unit != "rad"
        else float(np.degrees(np.ptp(angles))),
        "board": None if capture.board is None else capture.board.describe(),
        "digest": capture.digest(),
        "notes": list(capture.notes),
    }


def _of_toml(path: Path) -> Facts:
    try:
        tables = tomllib.loads(disk.read_bounded(path, disk.MEGABYTE, error=ConfigError).decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise ConfigError(f"{path}: is no TOML: {problem}.") from problem
    if "project" not in tables:
        return {"kind": "configuration", "tables": list(tables)}
    with projects.opened(projects.load_project(path)) as found:
        project, counts = found.project, counted(found.states)
    return {
        "kind": "project",
        "captures": [capture.name for capture in project.captures],
        "steps": in_words(counts),
        "output": str(project.output),
        "notes": list(project.notes),
    }


def _day(seconds: float) -> str:
    return f"{datetime.datetime.fromtimestamp(seconds, datetime.UTC):%Y-%m-%d %H:%M} UTC"


def _line(name: str, value: Any) -> str:
    if name == "bytes":
        return f"size: {value / 1e6:.1f} MB" if value >= 1e5 else f"size: {value / 1e3:.1f} kB"
    if name in ("from", "to"):
        return f"{name}: {' '.join(f'{number:.3f}' for number in value)} m"
    if name == "sheet_mm":
        return f"sheet: {value[0]} x {value[1]} mm"
    what, _, unit = name.rpartition("_")
    label = name.replace("_", " ")
    if unit == "m":
        return f"{what.replace('_', ' ')}: {1e3 * value:.2f} mm"
    if unit == "deg":
        return f"{what}: {value:.1f}°"
    if isinstance(value, list):
        return f"{label}: {', '.join(map(str, value)) or 'none'}"
    return f"{label}: {value:,}" if isinstance(value, int) else f"{label}: {value}"
