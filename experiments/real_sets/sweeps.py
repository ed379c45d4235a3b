"""The sweep of the desk scanner: its axis from the markers, its camera and sheet from another capture."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from experiments.real_sets.figures import table_figures
from experiments.real_sets.ours import Version
from experiments.real_sets.pictures import Pictures
from experiments.real_sets.plain.boards import Lens
from experiments.real_sets.plain.method import TableFrame, table_of
from experiments.real_sets.plain.stripes import Plane
from experiments.real_sets.plain.table import Table


def table_from(folder: Path, lens: Lens) -> Table:
    """The turntable by the markers on it, seen through a lens."""
    return table_of(Pictures(folder), lens)


def write_rig(path: Path, size: tuple[int, int], lens: Lens, sheet: Plane, table: Table) -> None:
    """A calibration as a user writes it by hand: lens, sheet and axis."""
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    values = dict(zip(names, [float(x) for x in np.ravel(lens.distortion)], strict=False))
    matrix = lens.matrix
    pixels = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    tables = {
        "format": "jaxscan-calibration/1",
        "camera": {
            "model": "pinhole",
            "width": size[0],
            "height": size[1],
            **{name: float(value) for name, value in pixels.items()},
            "distortion": values,
        },
        "lasers": [{"normal": sheet.normal.tolist(), "distance_m": float(sheet.distance)}],
        "turntable": {
            "carries": "object",
            "direction": table.direction.tolist(),
            "point_m": table.point.tolist(),
        },
    }
    path.write_text(json.dumps(tables, indent=1))


def reconstruct(version: Version, capture: Path, rig: Path, table: Table, inner: float) -> dict[str, Any]:
    """One run of `jaxscan reconstruct`, and the figures of its cloud."""
    cloud = rig.with_name(f"{rig.stem}_{capture.name}.ply")
    cloud.unlink(missing_ok=True)
    arguments = ("reconstruct", str(capture), "-c", str(rig), "-o", str(cloud), "--no-cache", "--max-range", "2")
    code, out, problem, seconds = version.verb(*arguments)
    said = [line.replace(str(capture), capture.name) for line in out.splitlines() if line.startswith("note: ")]
    ended = problem.strip().splitlines()
    found: dict[str, Any] = {
        "exit_code": code,
        "seconds": seconds,
        "said": said,
        "error": ended[-1].replace(str(capture), capture.name) if ended else "",
    }
    if not cloud.exists():
        return found
    frame = TableFrame(table)
    return found | table_figures(read_points(cloud), frame.height, frame.normal, inner)


def read_points(path: Path) -> np.ndarray:
    """Points [n, 3] of a binary PLY file of jaxscan; m."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    kinds = {
        "float": "<f4",
        "double": "<f8",
        "uchar": "u1",
        "int": "<i4",
        "uint": "<u4",
        "ushort": "<u2",
        "short": "<i2",
    }
    fields, count, in_vertex = [], 0, False
    for line in data[:end].decode().splitlines():
        words = line.split()
        if words[0] == "element":
            in_vertex = words[1] == "vertex"
            count = int(words[2]) if in_vertex else count
        elif words[0] == "property" and in_vertex:
            fields.append((words[2], kinds[words[1]]))
    points = np.frombuffer(data, np.dtype(fields), count, end)
    return np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float64)
