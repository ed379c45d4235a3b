"""`jaxscan measure deviations`: the map of a surface's deviations from its plane."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.measure import Point, finite, in_metres, notes_first
from jaxscan.cli.options import CloudPath, CloudUnit, coordinates, positive
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import check_paths, file_at


def deviations(
    cloud: CloudPath,
    /,
    *,
    at: Point,
    radius_mm: float = 500.0,
    cell_mm: float = 50.0,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    unit: CloudUnit = None,
    json: JsonTarget = None,
) -> None:
    """Deviations from a plane: `jaxscan measure deviations room.ply --at 1.9 0.2 0.1 -o map.png`.

    The plane is that of most points around; deviations are in square cells, towards the scanner positive, each with one
    standard deviation.

    Args:
        cloud: The cloud.
        at: A point of the plane, x y z in metres.
        radius_mm: The points within this distance of it are looked at.
        cell_mm: Size of a cell.
        output: Picture to write (PNG): deviations in millimetres, and their sigmas beside them.
        json: Write the result as JSON too; cells without points are null.
    """
    coordinates("--at", at)
    positive("--radius-mm", radius_mm)
    positive("--cell-mm", cell_mm)
    coordinates("--radius-mm", (radius_mm,))
    check_paths(file_at("CLOUD", cloud), [*file_at("--output", output), *file_at("--json", json)])
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.errors import OutputError
    from jaxscan.files.disk import check_writable, write_atomically

    if output is not None:
        if output.suffix.lower() != ".png":
            raise OutputError(f'{output}: cannot write "{output.suffix}", known is .png.')
        check_writable(output, error=OutputError)
    check_json(json)
    points, notes = in_metres(cloud, unit)
    found = jaxscan.measure_deviations(points, np.array(at), radius_m=radius_mm / 1e3, cell_m=cell_mm / 1e3)
    numbers = finite({name: getattr(found, name) for name in ("rms_m", "least_m", "most_m")})
    out = notes_first(notes, json)
    typical = float(np.median(found.sigma_m[found.seen]))
    significant = float(np.mean(np.abs(found.deviation_m[found.seen]) > 3.0 * found.sigma_m[found.seen]))
    out.print(
        f"RMS {1e3 * found.rms_m:.2f} mm, from {1e3 * found.least_m:.2f} to {1e3 * found.most_m:.2f} mm in "
        f"{int(found.seen.sum())} cells of {cell_mm:g} mm, towards the scanner positive"
    )
    out.print(f"sigma of a cell {1e3 * typical:.2f} mm; {100 * significant:.1f} % deviate by more than 3 sigma")
    if output is not None:
        from jaxscan.report import deviation_picture

        write_atomically(output, deviation_picture(found), error=OutputError)
        out.print(f"written: {output}")
    cells = {name: np.where(found.seen, getattr(found, name), None) for name in ("deviation_m", "sigma_m")}
    places = {name: getattr(found, name) for name in ("points", "cell_m", "origin_m", "across", "up", "normal")}
    emit_json(
        json, "measure-deviations", numbers | {"share_beyond_3_sigma": significant, "notes": notes} | places | cells
    )
