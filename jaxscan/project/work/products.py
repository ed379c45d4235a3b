"""Products made of a cloud."""

import json
from typing import Any

import numpy as np

from jaxscan import api
from jaxscan.drawing import draw_plan, survey_room
from jaxscan.errors import MeasurementError
from jaxscan.files.disk import write_atomically
from jaxscan.measurement import RoomBox, measure_room
from jaxscan.project.work.desk import Desk


MEASURES_FORMAT = "jaxscan-measures/1"
SIDES = ("length", "width", "height")


def measure(desk: Desk) -> None:
    """The lengths of the room, and how good its points are, as JSON; two versions or epochs are compared by them."""
    cloud, scanner = api.load_cloud(desk.file("cloud")), api.load_scanner(desk.file("calibration"))
    valid = np.asarray(cloud.valid)
    found: dict[str, Any] = {"format": MEASURES_FORMAT, "points": int(valid.sum())}
    for name in ("sigma_random", "sigma_systematic"):
        found[f"median_{name}_m"] = float(np.median(np.asarray(getattr(cloud, name))[valid]))
    try:
        found["lengths"] = _lengths(measure_room(cloud, scanner=scanner))
    except MeasurementError as problem:
        # A sweep of something other than a room has no lengths of a room.
        found["lengths"] = {}
        desk.notes.append(str(problem))
    text = json.dumps(found, indent=2, allow_nan=False) + "\n"
    write_atomically(desk.target(), text.encode())


def _lengths(box: RoomBox) -> dict[str, Any]:
    sides = {name: side for name in SIDES if (side := getattr(box, name)) is not None}
    return {
        name: {
            "value_m": side.value_m,
            "sigma_m": side.sigma_m,
            "sigma_random_m": side.sigma_random_m,
            "sigma_systematic_m": side.sigma_systematic_m,
        }
        for name, side in sides.items()
    }


def make_mesh(desk: Desk) -> None:
    """The mesh of a cloud, in its colours."""
    mesh = api.mesh_cloud(api.load_cloud(desk.file("cloud")), scanner=api.load_scanner(desk.file("calibration")))
    api.save_mesh(mesh, desk.target())


def draw_room(desk: Desk) -> None:
    """The plan of a room, a metre above its floor."""
    cloud, scanner = api.load_cloud(desk.file("cloud")), api.load_scanner(desk.file("calibration"))
    drawing = draw_plan(survey_room(cloud, scanner=scanner))
    for number in range(len(desk.step.outputs)):
        api.save_drawing(drawing, desk.target(number))


def draw_panorama(desk: Desk) -> None:
    """The panorama of a sweep, with depths and normals."""
    sweep, scanner = desk.capture().every(desk.setting("every")), api.load_scanner(desk.file("calibration"))
    cloud = api.load_cloud(desk.file("cloud"))
    drawn = api.draw_panorama(sweep, scanner, cloud=cloud, progress=desk.progress)
    api.save_panorama(drawn, desk.target())


def write_report(desk: Desk) -> None:
    """The report of a cloud."""
    # Imported here, because it loads matplotlib.
    from jaxscan.api.reports import report_files

    report_files(desk.file("cloud"), desk.file("calibration"), desk.target())
