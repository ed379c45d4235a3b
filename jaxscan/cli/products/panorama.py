"""`jaxscan panorama`: the laser-off images of a sweep as one picture, or as posed photographs."""

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from jaxscan import api
from jaxscan.cli.options import CalibrationPath, CapturePath, at_least
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import calibration_at, capture_at, check_paths, file_at
from jaxscan.cli.progress import progress_bar
from jaxscan.errors import OptionError
from jaxscan.files.calibration import calibration_notes
from jaxscan.files.clouds import check_cloud_path


SMALLEST, LARGEST = 16, 65_500


TARGET = "Picture to write; the suffix chooses: .jpg or .png, or .e57 for the cloud and its picture in one file."


def panorama(
    capture: CapturePath,
    /,
    *,
    calibration: CalibrationPath,
    output: Annotated[
        Path | None,
        tyro.conf.arg(aliases=["-o"], help="Picture to write; the suffix chooses: .jpg, .png, or .e57 with the cloud."),
    ] = None,
    cloud: Path | None = None,
    projection: Literal["equirectangular", "cylinder"] = "equirectangular",
    width: int | None = None,
    transforms: Path | None = None,
    undistort: bool = False,
    photographs: bool = False,
    json: JsonTarget = None,
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
        json: Write the result as JSON too.
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
    check_paths(
        reads=[
            *capture_at("CAPTURE", capture),
            *calibration_at("--calibration", calibration),
            *file_at("--cloud", cloud),
        ],
        writes=[
            *(place for path in pictures for place in file_at("--output", path)),
            *file_at("--transforms", transforms),
            *file_at("--json", json),
        ],
    )
    if output is not None and scan:
        check_cloud_path(output)
    elif output is not None:
        api.check_panorama_path(output, with_cloud=with_cloud)
    check_json(json)
    sweep, scanner = api.open_capture(capture), api.load_scanner(calibration)
    out = console(json)
    notes = [*calibration_notes(calibration), *sweep.notes, *api.photograph_notes(sweep, scanner, "pictures")]
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
    emit_json(json, "panorama", result)
