"""`jaxscan import`: makes a capture of images or videos that another program took."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from jaxscan import stripes as stripe_search
from jaxscan.cli.help import Arg
from jaxscan.cli.options import Carries, ImageUp, LaserColour, PixelFormat, StripeAxis, check_paths
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import Terminal, console, emit_json
from jaxscan.errors import OptionError
from jaxscan.files import importing
from jaxscan.geometry.motion_kinds import MOTIONS, PoseFormat, PoseUnit


if TYPE_CHECKING:
    from jaxscan.files.importing import ImportedHeader, ImportPlan


Patterns = tuple[str, ...]


def import_(
    folder: Annotated[Path, Arg("FOLDER")],
    /,
    *,
    output: Annotated[Path | None, Arg(short="-o")] = None,
    show: bool = False,
    on: Patterns = (),
    off: Patterns = (),
    boards: Patterns = (),
    board: str | None = None,
    step_deg: float | None = None,
    angles: Path | None = None,
    step_mm: float | None = None,
    positions: Path | None = None,
    poses: Path | None = None,
    pose_format: PoseFormat | None = None,
    pose_unit: PoseUnit = "m",
    carries: Carries | None = None,
    lasers: tuple[str, ...] = (),
    laser_colour: LaserColour = "auto",
    stripe_axis: StripeAxis = "rows",
    exposures_ms: tuple[float, ...] = (),
    response: str = "linear",
    shutter: Literal["global", "rolling"] | None = None,
    up: ImageUp = "-v",
    pixel_format: PixelFormat | None = None,
    bits: Literal[10, 12, 14, 16] | None = None,
    every: int = 1,
) -> None:
    """Make a capture of another program's images: `jaxscan import FOLDER -o captures/room --step-deg 0.9`.

    Without patterns the roles of the images are recognised by the words in their names, or by the layout of FabScanPi.
    A calibration: `jaxscan import FOLDER -o captures/boards --board "chessboard 11x6 13mm"`. With
    patterns: `jaxscan import FOLDER -o captures/room --on 'l_*.png' --off 'b_*.png' --step-deg 0.9`. Two lasers:
    `--on 'left_*.png' 'right_*.png'`. A video: `--on laser.avi`. The images are copied, packed without loss.

    Args:
        folder: Folder of images or videos, with the folders in it; links are not followed.
        output: Folder of the new capture.
        show: Only show which images would be paired, and write nothing.
        on: Names of the laser-on images, a pattern in quotes; several for several lasers or exposures. Of a video,
            all frames.
        off: Names of the laser-off images; one image may serve all steps.
        boards: Names of images of a board without laser.
        board: Board that the images show, for a calibration: "chessboard 11x6 13mm" (inner corners, square),
            "charuco 12x9 30mm 22mm DICT_5X5_250" (squares, square, marker; with `legacy` behind where OpenCV before 4.6
            printed it), "circles 4x11 20mm 16mm" (circles in a row and rows, distance of rows, diameter; with
            `symmetric` behind where no row is shifted) or "aprilgrid 6x6 24mm 7.2mm" (tags, tag, gap).
        step_deg: Angle of the table between two images. With --board, the board stood still meanwhile.
        angles: Text file with the table's angle of each image in degrees, a line each, perhaps after the image's name,
            and for boards perhaps with the number of the placement.
        step_mm: With `--carries linear`: way of the stage between two images.
        positions: With `--carries linear`: text file like that of --angles, in millimetres.
        poses: With `--carries poses`: text file with the hand's pose of each image, in the frame of the robot's base or
            of the tracker, a line each, perhaps after the image's name. With --board, the board stood still meanwhile.
        pose_format: Numbers of a line of --poses: `tum` (time x y z qx qy qz qw; the time may be missing), `wxyz`
            (x y z qw qx qy qz), `matrix` (12 or 16, row after row); or x y z and `rotvec` (a rotation vector in
            radians), `rpy` (degrees about the fixed axes x, then y, then z; `rpy-rad` in radians) or `abc` (degrees
            about z, then the new y, then the new x). Without, 8 numbers are `tum`, and 12 or 16 `matrix`.
        pose_unit: Unit of the lengths in --poses.
        carries: `scanner` or `object`: the load of the table; `linear` for a stage; `poses` for a hand whose poses are
            given; `nothing` if nothing moves.
        lasers: Names of the lasers, one for each pattern of --on.
        laser_colour: Channel of colour images that shows the laser; `auto` learns it from
            laser-off images, and takes red without any.
        stripe_axis: `rows` for a laser line that crosses the image rows, `columns` for one that lies along them.
        exposures_ms: Exposures of a bracket, one for each pattern of --on and of --off.
        response: `linear`, `srgb`, "gamma 2.2" or another exponent, or `learn` from the exposures.
        shutter: `rolling` if rows are exposed one after another.
        up: Direction of the image that is up.
        pixel_format: Bayer pattern of raw images; grey and colour are seen.
        bits: Bits of the camera in images of 16 bits; without, they are found from the images.
        every: Of a video, take every so many frames.
    """
    # The folder as a whole is read, and nothing in it is ever written.
    check_paths({"FOLDER": folder}, {"--output": output})
    if output is None and not show:
        raise OptionError("-o: is needed: the folder of the new capture; --show only shows what would be imported.")
    if output is not None:
        # Here, so that `--help` does not load it.
        from jaxscan.files.recording import check_new_folder

        check_new_folder(output)
    unit = "rad" if carries is None else MOTIONS[carries].unit
    _fits("--carries", "linear", unit == "m", {"--step-mm": step_mm, "--positions": positions})
    _fits(
        "--carries",
        "scanner or object",
        unit == "rad",
        {"--step-deg": step_deg, "--angles": angles},
    )
    given = {"--poses": poses, "--pose-format": pose_format, "--pose-unit": None if pose_unit == "m" else pose_unit}
    _fits("--carries", "poses", unit == "pose", given)
    request = importing.ImportRequest(
        on=on,
        off=off,
        boards=boards,
        board=None if board is None else importing.parse_board(board),
        carries=carries,
        step=step_mm if unit == "m" else step_deg,
        places=poses if unit == "pose" else positions if unit == "m" else angles,
        pose_format=pose_format,
        pose_unit=pose_unit,
        exposures_ms=_checked(exposures_ms),
        lasers=lasers,
        every=every,
    )
    if boards and board is None:
        raise OptionError('--board: is needed with --boards, such as --board "chessboard 11x6 13mm".')
    settings = importing.ImageSettings(pixel_format, response, shutter, up, laser_colour, stripe_axis, bits)
    plan = importing.make_plan(folder, request)
    found = importing.describe_images(plan, settings)
    out = console()
    _show(out, plan, found, laser_colour)
    result = _result(plan, found)
    if output is None or show:
        out.print("nothing is written: --show" if show else "nothing is written")
    else:
        with progress_bar("Importing") as progress:
            capture = importing.write_import(plan, found, output, progress)
        out.notes(capture.notes)
        out.print(f"written: {output} ({len(capture)} records, {found.header.kind})")
        result["capture"] = str(output)
    emit_json(result)


def _fits(option: str, values: str, fits: bool, given: dict[str, Any]) -> None:
    """Refuse options that belong to other values of an option."""
    for name, value in given.items():
        if value is not None and not fits:
            raise OptionError(f"{name}: is for {option} {values}.")


def _checked(exposures_ms: tuple[float, ...]) -> tuple[float, ...]:
    if any(not 0 < one <= 1e9 for one in exposures_ms) or len(set(exposures_ms)) < len(exposures_ms):
        raise OptionError(f"--exposures-ms: found {exposures_ms}, expected different numbers above 0.")
    return exposures_ms


def _show(out: Terminal, plan: "ImportPlan", found: "ImportedHeader", laser_colour: LaserColour) -> None:
    """Print which images were found, and how they are understood."""
    roles = [(row.role, len(row.files), str(row.files[0]), str(row.files[-1])) for row in plan.rows]
    wide = max(len(role) for role, *_ in roles)
    for role, count, first, last in roles:
        out.print(f"  {role:{wide}}  {count:6d}  {first}{f' ... {last}' if count > 1 else ''}")
    for at, name in ((0, "first"), (-1, "last")):
        record = plan.records[at]
        images = [" ".join(map(str, images)) for images in (record.on, record.off) if images]
        unit = "mm" if MOTIONS[plan.request.carries or "scanner"].unit == "m" else "degrees"
        where = "" if record.place.value is None else f", {record.place.value:g} {unit}"
        out.print(f"  {name} record: {' with '.join(images)}{where}")
    for sentence in plan.said:
        out.print(f"  {sentence}")
    camera = found.header.camera
    lossy = {"jpeg": ", JPEG", "video": ", video"}.get(str(camera.compression), "")
    out.print(f"  {camera.width} x {camera.height} px, {camera.pixel_format}{lossy}, response {camera.response}")
    if (depth := found.kind.depth) is not None:
        levels = "" if camera.bits is None else f"{len(stripe_search.level_exposures(camera.bits))} levels of "
        out.print(f"  images of 16 bits hold {depth.said}; kept in {levels}8 bits")
    red = (
        laser_colour == "auto"
        and camera.pixel_format != "mono8"
        and not any(one.on and one.off for one in plan.records)
    )
    if red and plan.lasers:
        out.print(
            "  the laser counts as red: no laser-on image has a laser-off one to learn from; otherwise --laser-colour"
        )
    if found.learned is not None:
        out.print(
            f"  response learned: {found.learned.response}, misfit {found.learned.misfit:.2g} codes; linear would "
            f"misfit by {found.learned.linear_misfit:.2g}"
        )


def _result(plan: "ImportPlan", found: "ImportedHeader") -> dict[str, Any]:
    rows = [
        {"role": row.role, "count": len(row.files), "first": str(row.files[0]), "last": str(row.files[-1])}
        for row in plan.rows
    ]
    camera = found.header.camera.model_dump(exclude_none=True)
    return {
        "folder": str(plan.folder),
        "kind": found.header.kind,
        "records": len(plan.records),
        "images": rows,
        "understood": list(plan.said),
        "camera": camera,
    }
