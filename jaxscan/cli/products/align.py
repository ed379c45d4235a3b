"""`jaxscan align`: a cloud in the frame of targets, or of its room."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.measure import in_metres, notes_first, upright
from jaxscan.cli.options import CloudOutputPath, CloudPath, CloudUnit, CloudUp
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.cli.process.terminal import Terminal, table
from jaxscan.errors import OptionError


if TYPE_CHECKING:
    from jaxscan.reconstruction import PointCloud


def align(
    cloud: CloudPath,
    /,
    *,
    output: CloudOutputPath,
    targets: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    room: bool = False,
    unit: CloudUnit = None,
    up: CloudUp = None,
    json: JsonTarget = None,
) -> None:
    """Put a cloud in a frame: `jaxscan align room.ply -o levelled.ply --room`, or `--targets targets.toml`.

    Lengths stay as they are: the cloud is turned and shifted.

    Args:
        cloud: The cloud (.ply or .npz).
        output: Cloud to write.
        targets: TOML file with three or more [[target]], each with name, scanner = [x, y, z] and site = [x, y, z] in
            metres.
        room: Floor to z = 0, the longer wall along x, the origin in a corner.
        json: Write the result as JSON too, with the 4 x 4 transform from the cloud in metres, and for --room with z up.
    """
    from jaxscan.files.clouds import check_cloud_path

    if room == (targets is not None):
        found = "both --room and" if room else "neither --room nor"
        raise OptionError(f"found {found} --targets, expected one of them.")
    check_paths(
        [*file_at("CLOUD", cloud), *file_at("--targets", targets)],
        [*file_at("--output", output), *file_at("--json", json)],
    )
    if targets is not None and up is not None:
        raise OptionError("--up: found with --targets, which say by themselves what is up.")
    check_cloud_path(output)
    check_json(json)
    points, notes = in_metres(cloud, unit) if targets is not None else upright(cloud, unit, up)
    out = notes_first(notes, json)
    transform, result = _to_room(points, out) if targets is None else _to_targets(targets, out)
    jaxscan.save_cloud(jaxscan.align_cloud(points, transform), output)
    out.print(f"written: {output}")
    emit_json(
        json,
        "align",
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
