"""Stations that belong together: registered, reconstructed with the calibration of them all, and merged one by one."""

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan import api
from jaxscan.calibration import Calibration
from jaxscan.drawing import draw_plan, survey_room
from jaxscan.errors import CalibrationError, CaptureError, CloudError, GivenError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.clouds import save_stations
from jaxscan.files.disk import MEGABYTE, parse_json, read_bounded, write_atomically
from jaxscan.files.known_room import load_known_room
from jaxscan.files.remote import is_remote
from jaxscan.project.work.desk import Desk
from jaxscan.project.work.sweeps import coloured, reconstruct_settings
from jaxscan.project.work.tiles import Tiles
from jaxscan.recalibration import Recalibration
from jaxscan.reconstruction import PointCloud, join_clouds, stack_placed


STATIONS_FORMAT = "jaxscan-stations/1"
TILES_FORMAT = "jaxscan-tiles/1"
PLAN_POINTS = 20_000_000
"""Points that the plan of a group is drawn from; of more, only every n-th profile."""
VAGUE_M = 0.02
"""A station's place that is known no better is told [m]."""
_MOST_BYTES = 64 * MEGABYTE


def register_stations(desk: Desk) -> None:
    """The places of all stations and a calibration that fits them all, in one least squares.

    Where the sweeps gain nothing over the calibration they were given, that one is kept; the places are good anyhow.

    Raises:
        CalibrationError: If it did not converge.
    """
    names, result = desk.setting("captures"), _recalibrated(desk)
    adjusted = result.adjusted
    if not adjusted.converged:
        raise CalibrationError(f"{desk.step.key}: the places of the stations were not found: {result.refused}")
    desk.notes.extend(result.notes)
    _save(desk, result.calibration, result.refused)
    for number, name in enumerate(names):
        worst = float(np.sqrt(np.linalg.eigvalsh(adjusted.station_covariance[number][:3, :3])[-1]))
        if worst > VAGUE_M:
            desk.notes.append(f"The sweeps tell the place of {name} to {1e3 * worst:.0f} mm only, in some direction.")
    stations = [
        {
            "capture": name,
            "pose": adjusted.stations[number].tolist(),
            "covariance": adjusted.station_covariance[number].tolist(),
            "corrections_rad": np.asarray(adjusted.corrections[number]).tolist(),
        }
        for number, name in enumerate(names)
    ]
    write_atomically(desk.target(1), json.dumps({"format": STATIONS_FORMAT, "stations": stations}).encode())


def refine_rig(desk: Desk) -> None:
    """The calibration of a rig with what the sweeps of one room tell of it.

    It is as it was where they tell nothing, or cannot be used: then the other rooms still refine it.

    Raises:
        CaptureError: If storage cannot be read, which may be otherwise tomorrow.
        GivenError: If a known length or place contradicts the sweeps.
    """
    calibration, refused = None, None
    try:
        result = _recalibrated(desk)
        calibration, refused = result.calibration, result.refused
        desk.notes.extend(result.notes)
    except GivenError:
        # A person can put it right; the stored calibration would hide it.
        raise
    except (CalibrationError, CaptureError) as problem:
        if isinstance(problem, CaptureError) and any(map(is_remote, desk.step.sources.values())):
            raise
        refused = str(problem)
    _save(desk, calibration, refused)


def _recalibrated(desk: Desk) -> Recalibration:
    pairs = list(zip(desk.setting("captures"), desk.setting("every"), strict=True))
    captures = [desk.capture(f"capture {name}").every(every) for name, every in pairs]
    given = load_known_room(desk.file("known")) if "known" in desk.step.sources else None
    settings = api.RecalibrationSettings(stations=len(captures) > 1)
    return api.recalibrate(captures, desk.file("calibration"), given=given, settings=settings, progress=desk.progress)


def _save(desk: Desk, calibration: Calibration | None, refused: str | None) -> None:
    """Write a new calibration; where there is none, that which was given, and a note why."""
    if calibration is None:
        desk.notes.append(f"The calibration is as it was: {refused}")
        stored = read_bounded(desk.file("calibration"), _MOST_BYTES, error=CalibrationError)
        write_atomically(desk.target(0), stored)
    else:
        api.save_calibration(calibration, desk.target(0))


def place_station(desk: Desk) -> None:
    """The cloud of one station, in the frame of the group."""
    calibration, stations = desk.file("calibration"), desk.file("stations")
    text = read_bounded(stations, _MOST_BYTES, error=CloudError)
    station = parse_json(text, name=str(stations), error=CloudError)["stations"][desk.setting("number")]
    sweep, scanner = desk.capture().every(desk.setting("every")), api.load_scanner(calibration)
    angles = (sweep.angles + np.array(station["corrections_rad"])).tolist()
    records = tuple(replace(record, angle=angle) for record, angle in zip(sweep.records, angles, strict=True))
    settings = reconstruct_settings(desk)
    turned = replace(sweep, records=records) if np.any(station["corrections_rad"]) else sweep
    done = api.reconstruct_capture(turned, scanner, settings=settings, progress=desk.progress)
    desk.notes.extend(done.notes)
    cloud = coloured(desk, done.cloud, sweep, scanner)
    placed = join_clouds([cloud], [np.array(station["pose"])], [np.array(station["covariance"])])
    api.save_cloud(placed, desk.target(), calibration_digest=calibration_digest(calibration))


def merge_e57(desk: Desk) -> None:
    """One E57 with a scan and its pose for each station."""
    digest = calibration_digest(desk.file("calibration"))
    roles = [role for role in desk.step.products if role.startswith("cloud ")]
    loads = [partial(api.load_cloud, desk.file(role)) for role in roles]
    save_stations(loads, desk.target(), calibration_digest=digest)


def merge_tiles(desk: Desk) -> None:
    """Square tiles with the points of all stations, and a list of them."""
    folder = str(Path(desk.step.outputs[0]).with_suffix(""))
    digest = calibration_digest(desk.file("calibration"))
    listed: list[dict[str, Any]] = []
    with Tiles(desk.folder / "spooled", desk.setting("tile_m")) as tiles:
        for cloud in _clouds(desk):
            tiles.add(cloud)
        places = Counter[tuple[int, int]]()
        for place, cloud in tiles.clouds():
            places[place] += 1
            more = "" if places[place] == 1 else f"_{places[place]}"
            name = f"{folder}/{place[0]}_{place[1]}{more}.ply"
            api.save_cloud(cloud, desk.beside(name), calibration_digest=digest)
            corner = [float(axis * desk.setting("tile_m")) for axis in place]
            points = int(np.asarray(cloud.valid).sum())
            listed.append({"file": f"{Path(folder).name}/{Path(name).name}", "corner_m": corner, "points": points})
    desk.owned.append(folder)
    about = {"format": TILES_FORMAT, "tile_m": desk.setting("tile_m"), "tiles": listed}
    write_atomically(desk.target(), (json.dumps(about, indent=2) + "\n").encode())


def merge_plan(desk: Desk) -> None:
    """One plan from the points of all stations."""
    points = sum(int(np.asarray(cloud.valid).sum()) for cloud in _clouds(desk))
    every = max(1, -(-points // PLAN_POINTS))
    # Thinned one by one, so that the whole is never in memory.
    placed = stack_placed([stack_placed([cloud], every=every) for cloud in _clouds(desk)])
    drawing = draw_plan(survey_room(placed, scanner=api.load_scanner(desk.file("calibration"))))
    api.save_drawing(drawing, desk.target())


def _clouds(desk: Desk) -> Iterator[PointCloud]:
    """The clouds of the stations, one after the other."""
    for role in desk.step.products:
        if role.startswith("cloud "):
            yield api.load_cloud(desk.file(role))
