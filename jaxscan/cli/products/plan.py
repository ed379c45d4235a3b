"""`jaxscan plan`: a room as a floor plan or a section, with its lengths, areas and volume."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.measure import calibrated, notes_first, upright
from jaxscan.cli.options import CloudPath, CloudUnit, CloudUp, OptionalCalibrationPath, coordinates, positive
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import calibration_at, check_paths, file_at
from jaxscan.cli.process.terminal import table


if TYPE_CHECKING:
    from jaxscan.drawing import Survey
    from jaxscan.measurement import Estimate


def plan(
    cloud: CloudPath,
    /,
    *,
    output: Annotated[
        Path, tyro.conf.arg(aliases=["-o"], help="Drawing to write; the suffix chooses the format (.dxf .svg .pdf).")
    ],
    height: tuple[float, ...] = (1.0,),
    section: Annotated[tuple[float, float, float, float] | None, tyro.conf.arg(metavar="AX AY BX BY")] = None,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
    json: JsonTarget = None,
) -> None:
    """Draw a room: `jaxscan plan room.ply -c calibration.json -o plan.dxf`.

    Prints the length of every wall, what is in the walls, areas and the volume, each with one standard deviation.

    Args:
        cloud: Cloud of a room, scanned from inside.
        output: Drawing to write.
        height: Heights above the floor [m] at which the plan is cut; lengths and openings are those at the first.
        section: Draws a vertical section instead, through two points of the plan [m].
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
        json: Write the result as JSON too.
    """
    from jaxscan.api import check_drawing_path

    for one in height:
        positive("--height", one)
        coordinates("--height", (one,))
    coordinates("--section", section or ())
    check_paths(
        [*file_at("CLOUD", cloud), *calibration_at("--calibration", calibration)],
        [*file_at("--output", output), *file_at("--json", json)],
    )
    check_drawing_path(output)
    check_json(json)
    scanner, notes = calibrated(calibration)
    points, said = upright(cloud, unit, up)
    notes += said
    survey = jaxscan.survey_room(points, scanner=scanner)
    if section is None:
        drawing = jaxscan.draw_plan(survey, heights_m=height)
    else:
        drawing = jaxscan.draw_section(survey, section[:2], section[2:])
    jaxscan.save_drawing(drawing, output)
    out = notes_first(notes, json)
    result = _numbers(survey, height[0])
    rows = [
        (each["name"], _length(each["length"]), _area(each["area"]), "" if each["seen"] else "not seen")
        for each in result["walls"]
    ]
    out.print(table(f"Walls, {height[0]:g} m above the floor", ("", "m", "m²", ""), rows))
    for each in result["openings"]:
        wide, high = (_length(each[name]) or "not known how" for name in ("width", "height"))
        out.print(f"{each['wall']}: {each['kind']} {wide} wide, {high} high")
    for name, unit in (("height", "m"), ("floor_area", "m²"), ("volume", "m³")):
        found = result[name]
        if found is not None:
            out.print(f"{name.replace('_', ' ')}: {_length(found) if unit == 'm' else _area(found)} {unit}")
    for remark in drawing.remarks:
        out.print(f"note: {remark}")
    out.print("± is one standard deviation" + ("" if scanner else "; --calibration adds the calibration's part") + ".")
    out.print(f"written: {output}")
    emit_json(json, "plan", result | {"drawing": str(output), "notes": [*notes, *drawing.remarks]})


def _numbers(survey: "Survey", height: float) -> dict[str, Any]:
    room = survey.outline
    lengths, corners = room.lengths(height), room.corners(height)
    walls = [
        {
            "name": side.name,
            "seen": side.seen,
            "start_m": corners[number][i].at,
            "length": _entry(lengths[number][i]),
            "area": _entry(room.wall_area(number, i)),
        }
        for number, loop in enumerate(room.loops)
        for i, side in enumerate(loop)
    ]
    openings = [
        {"wall": one.side, "kind": one.kind, "depth_m": one.depth_m}
        | {name: _entry(getattr(one, name)) for name in ("left", "right", "bottom", "top", "width", "height")}
        for loop in survey.openings
        for wall in loop
        for one in wall
    ]
    frame = {"rotation": room.frame.rotation, "translation_m": room.frame.translation}
    whole = {name: _entry(getattr(room, name)()) for name in ("height", "floor_area", "volume")}
    return {"cut_m": height, "plan_from_cloud": frame, "walls": walls, "openings": openings} | whole


def _entry(found: "Estimate | None") -> dict[str, float] | None:
    return None if found is None or not found.known else dataclasses.asdict(found)


def _length(entry: dict[str, float] | None) -> str:
    return "" if entry is None else f"{entry['value']:.4f} ±{entry['sigma']:.4f}"


def _area(entry: dict[str, float] | None) -> str:
    return "" if entry is None else f"{entry['value']:.3f} ±{entry['sigma']:.3f}"
