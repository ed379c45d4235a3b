"""`jaxscan plan`, `orthophoto`, `panorama`: a room as a plan or a section, its walls, and all around."""

import dataclasses
import datetime
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np

import jaxscan
from jaxscan import api, vision
from jaxscan import report as reports
from jaxscan.cli.help import Arg
from jaxscan.cli.measure import calibrated, upright
from jaxscan.cli.options import (
    CalibrationPath,
    CapturePath,
    CloudPath,
    CloudUnit,
    CloudUp,
    OptionalCalibrationPath,
    at_least,
    check_paths,
    coordinates,
    positive,
)
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import console, emit_json, table
from jaxscan.errors import OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import clouds as cloud_files
from jaxscan.files import disk


if TYPE_CHECKING:
    from jaxscan.drawing import Survey
    from jaxscan.files.clouds import Unit, Up
    from jaxscan.measurement import Estimate
    from jaxscan.reconstruction import PointCloud


MADE_BY = f"jaxscan {jaxscan.__version__}"


def plan(
    cloud: CloudPath,
    /,
    *,
    output: Annotated[
        Path, Arg(short="-o", text="Drawing to write; the suffix chooses: .dxf .svg .pdf .png, or .ifc.")
    ],
    height: tuple[float, ...] = (1.0,),
    section: Annotated[tuple[str, ...], Arg("PLACE")] = (),
    scale: int | None = None,
    sheet: Literal["a4", "a3", "a2", "a1", "a0"] = "a4",
    name: str = "",
    project: str = "",
    north: float | None = None,
    dpi: float = 200.0,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
) -> None:
    """Draw a room: `jaxscan plan room.ply -c calibration.json -o plan.dxf`.

    Prints the length of every wall, what is in the walls, areas and the volume, each with one standard deviation.

    Args:
        cloud: Cloud of a room, scanned from inside.
        output: Drawing to write.
        height: Heights above the floor [m] at which the plan is cut; lengths and openings are those at the first.
        section: Draws a vertical section instead: parallel to a wall of the plan, so many metres before it (W1+1.2); or
            through two points of the plan [m], whose origin and axes are drawn in it.
        scale: Scale of the sheet, 50 for 1 : 50; the largest standard scale that fits if not given.
        sheet: Size of the paper.
        name: Name of the room, for the drawing and its title block.
        project: Name of the project, for the title block.
        north: North on the sheet, in degrees clockwise from up; a scan does not know it.
        dpi: Dots per inch of a .png.
        calibration: Calibration that the cloud was made with; sigma then includes the calibration's part.
    """
    from jaxscan.drawing import Sheet, section_before

    for one in height:
        positive("--height", one)
        coordinates("--height", (one,))
    cut = _section(section)
    at_least(1, "--scale", scale)
    if north is not None and not -360.0 <= north <= 360.0:
        raise OptionError(f"--north: found {north:g}, expected degrees, -360 to 360.")
    is_model = output.suffix.lower() == ".ifc"
    if is_model and cut is not None:
        raise OptionError("--section: an .ifc holds the whole room; write the section as .dxf, .svg, .pdf or .png.")
    check_paths({"CLOUD": cloud, "--calibration": calibration}, {"--output": output})
    (api.check_ifc_path if is_model else api.check_drawing_path)(output)
    survey, _, notes = _surveyed(cloud, calibration, unit, up)
    ends = section_before(survey, *cut) if isinstance(cut, _Before) else cut
    paper = Sheet(sheet, scale, None, project, name, str(datetime.date.today()), MADE_BY, north)
    remarks = [f"{remark}." for remark in survey.outline.remarks]
    written, result = f"written: {output}", _numbers(survey, height[0])
    lines = _walls(result, height[0])
    if is_model:
        jaxscan.save_ifc(survey, output, sheet=paper)
    else:
        if ends is None:
            drawing = jaxscan.draw_plan(survey, heights_m=height, sheet=paper)
        else:
            drawing = jaxscan.draw_section(survey, *ends, sheet=paper)
            before = f", {cut.metres:g} m before {cut.wall}" if isinstance(cut, _Before) else ""
            sides = [f"  {'width' if line.offset_m else 'height'} {line.words}" for line in drawing.dimensions]
            lines = [f"{drawing.title}{before}", *sides]
            result["section_m"] = [list(end) for end in ends]
        jaxscan.save_drawing(drawing, output, dpi=dpi)
        remarks = list(drawing.remarks)
        written += f", 1 : {drawing.sheet.scale} on {sheet.upper()}"
    out = console(notes)
    for line in lines:
        out.print(line)
    out.print(f"frame of the plan: {survey.frame_words()}")
    for what, of in (("height", "m"), ("floor_area", "m²"), ("volume", "m³")):
        if result[what] is not None:
            out.print(f"{what.replace('_', ' ')}: {_words(result[what], of)}")
    for remark in remarks:
        out.print(f"note: {remark}")
    out.print(
        "± is one standard deviation" + ("" if calibration else "; --calibration adds the calibration's part") + "."
    )
    out.print(written)
    emit_json(result | {"drawing": str(output), "notes": [*notes, *remarks]})


def _surveyed(
    cloud: Path, calibration: Path | None, unit: "Unit | None", up: "Up | None"
) -> tuple["Survey", "PointCloud", list[str]]:
    """What a drawing of a room shows, the cloud, and what was guessed about it."""
    scanner, notes = calibrated(calibration)
    points, said = upright(cloud, unit, up)
    return jaxscan.survey_room(points, scanner=scanner), points, [*notes, *said]


class _Before(NamedTuple):
    """A section parallel to a wall, so many metres before it."""

    wall: str
    metres: float


def _section(words: tuple[str, ...]) -> _Before | tuple[tuple[float, float], tuple[float, float]] | None:
    """What `--section` asks for: a wall and a distance in one word, or two points [m]; None for a plan."""
    if not words:
        return None
    if len(words) == 1 and re.fullmatch(r"\w{1,40}\+\d{1,4}(\.\d{0,6})?", words[0]):
        wall, _, metres = words[0].partition("+")
        return _Before(wall, float(metres))
    try:
        ax, ay, bx, by = (float(word) for word in words)
    except ValueError as problem:
        found = " ".join(words)[:60]
        raise OptionError(
            f"--section: found {found}, expected a wall and metres, as W1+1.2, or two points AX AY BX BY."
        ) from problem
    coordinates("--section", (ax, ay, bx, by))
    return (ax, ay), (bx, by)


def _walls(result: dict[str, Any], height: float) -> list[Any]:
    """Walls and openings as a person reads them."""
    open_sides = not all(each["seen"] for each in result["walls"])
    rows = [
        (each["name"], _words(each["length"], "m"), _words(each["area"], "m²"))
        + ("" if each["seen"] else "not seen",) * open_sides
        for each in result["walls"]
    ]
    lines: list[Any] = [
        table(f"Walls, {height:g} m above the floor", ("", "length", "area", "")[: 3 + open_sides], rows)
    ]
    for each in result["openings"]:
        wide, high = (_words(each[name], "m") or "not known how" for name in ("width", "height"))
        lines.append(f"{each['wall']}: {each['kind']} {wide} wide, {high} high")
    return lines


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


def _words(entry: dict[str, float] | None, unit: str) -> str:
    """A length, an area or a volume in words; "" if it is not known."""
    digits = 4 if unit == "m" else 3
    return "" if entry is None else f"{entry['value']:.{digits}f} ±{entry['sigma']:.{digits}f} {unit}"


def orthophoto(
    cloud: CloudPath,
    /,
    *,
    output: Annotated[Path, Arg(short="-o")],
    pixel_mm: float = 5.0,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
) -> None:
    """Draw the walls of a room straight on: `jaxscan orthophoto room.ply -o walls`.

    Writes a picture of every wall, W1.png and so on, named as in the plan, with a scale below it.

    Args:
        cloud: Cloud of a room, scanned from inside.
        output: Folder to write to; it is made where it is missing.
        pixel_mm: Size of a pixel on the wall.
        calibration: Calibration that the cloud was made with.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.errors import OutputError

    positive("--pixel-mm", pixel_mm)
    reads = {"CLOUD": cloud, "--calibration": calibration}
    check_paths(reads)
    if output.exists() and not output.is_dir():
        raise OutputError(f"{output}: is a file; choose a folder with -o.")
    survey, loaded, notes = _surveyed(cloud, calibration, unit, up)
    notes += [f"{remark}." for remark in survey.outline.remarks]
    pictures = jaxscan.draw_orthophotos(survey, np.asarray(loaded.rgb), pixel_m=pixel_mm / 1e3)
    files = [output / f"{picture.side}.png" for picture in pictures]
    check_paths(reads, {"the picture": files})
    with disk.reported(f"{output}: cannot be written", error=OutputError), disk.whole_folder(output) as part:
        for picture, file in zip(pictures, files, strict=True):
            words = f"{picture.side}, {pixel_mm:g} mm per pixel"
            content = vision.encode_png(reports.with_scale(picture.rgb, picture.pixel_m, words))
            disk.write_atomically(part / file.name, content, error=OutputError, durable=False)
    out = console(notes)
    for picture, file in zip(pictures, files, strict=True):
        out.print(f"written: {file}, {100 * picture.seen.mean():.0f} % seen")
    walls = [
        {"wall": picture.side, "file": str(file), "rows": picture.rgb.shape[0], "columns": picture.rgb.shape[1]}
        | {"seen": float(picture.seen.mean())}
        for picture, file in zip(pictures, files, strict=True)
    ]
    emit_json({"pixel_m": pixel_mm / 1e3, "walls": walls, "notes": notes})


SMALLEST, LARGEST = 16, 65_500


TARGET = "Picture to write; the suffix chooses: .jpg or .png, or .e57 for the cloud and its picture in one file."


def panorama(
    capture: CapturePath,
    /,
    *,
    calibration: CalibrationPath,
    output: Annotated[
        Path | None,
        Arg(short="-o", text="Picture to write; the suffix chooses: .jpg, .png, or .e57 with the cloud."),
    ] = None,
    cloud: Path | None = None,
    projection: Literal["equirectangular", "cylinder"] = "equirectangular",
    width: int | None = None,
    transforms: Path | None = None,
    undistort: bool = False,
    photographs: bool = False,
) -> None:
    """Draw the room all around: `jaxscan panorama captures/room -c calibration.json -o room.jpg`.

    Args:
        capture: Folder of the captured sweep.
        calibration: Calibration file.
        cloud: Cloud of this sweep (.ply or .npz): its distances remove the parallax, and `<stem>.depth.png` (16 bit,
            millimetres) and `<stem>.normals.png` are written beside the picture. In an .e57 it is the scan.
        projection: `equirectangular` for viewers of panoramas, `cylinder` for paper.
        width: Width of the whole turn [px]; the camera's own resolution if not given.
        transforms: Folder for the photographs with their poses in `transforms.json`, for programs such as nerfstudio.
        undistort: Write those photographs without the distortion of the lens.
        photographs: Put the single photographs into the .e57 too, without distortion and with their poses.
    """
    if output is None and transforms is None:
        raise OptionError("--output: is missing, and --transforms too; at least one of the two is needed.")
    at_least(SMALLEST, "--width", width)
    if width is not None and width > LARGEST:
        raise OptionError(f"--width: found {width}, expected {LARGEST} or less.")
    scan = output is not None and output.suffix.lower() == ".e57"
    if scan and (cloud is None or projection != "equirectangular"):
        raise OptionError("--output: an .e57 holds a cloud with its equirectangular panorama; name the cloud: --cloud.")
    if photographs and not scan:
        raise OptionError("--photographs: go into an .e57 only; name one with -o, or take --transforms.")
    with_cloud = cloud is not None and not scan
    pictures = [] if output is None else api.panorama_paths(output, with_cloud=with_cloud)
    reads = {"CAPTURE": capture, "--calibration": calibration, "--cloud": cloud}
    check_paths(reads, {"--output": pictures, "--transforms": transforms})
    if output is not None and scan:
        cloud_files.check_cloud_path(output)
    elif output is not None:
        api.check_panorama_path(output, with_cloud=with_cloud)
    sweep, scanner = api.open_capture(capture), api.load_scanner(calibration)
    out = console()
    notes = [
        *calibration_files.calibration_notes(calibration),
        *sweep.notes,
        *api.photograph_notes(sweep, scanner, "pictures"),
    ]
    for note in notes:
        out.print(f"note: {note}")
    result: dict[str, Any] = {"notes": notes}
    if output is not None:
        stored = None if cloud is None else api.read_cloud(cloud)
        with progress_bar("Blending photographs") as progress:
            drawn = api.draw_panorama(
                sweep,
                scanner,
                cloud=None if stored is None else stored.cloud,
                projection=projection,
                width=width,
                progress=progress,
            )
        if scan and stored is not None:
            single = api.open_photographs(sweep, scanner) if photographs else None
            files = [api.save_scan(stored, drawn, output, photographs=single, started_s=api.began(sweep))]
        else:
            files = api.save_panorama(drawn, output)
        written = [str(path) for path in files]
        out.print(f"written: {', '.join(written)} ({drawn.frame.width} x {drawn.frame.height} px)")
        result |= {"pictures": written, "width_px": drawn.frame.width, "height_px": drawn.frame.height}
    if transforms is not None:
        with progress_bar("Writing photographs") as progress:
            count = api.export_photographs(sweep, scanner, transforms, undistorted=undistort, progress=progress)
        out.print(f"written: {transforms / 'transforms.json'} ({count} photographs)")
        result |= {"transforms": str(transforms / "transforms.json"), "photographs": count}
    emit_json(result)
