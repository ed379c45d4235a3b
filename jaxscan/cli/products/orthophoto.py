"""`jaxscan orthophoto`: the walls of a room, seen straight on."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.measure import calibrated, notes_first, upright
from jaxscan.cli.options import CloudPath, CloudUnit, CloudUp, OptionalCalibrationPath, positive
from jaxscan.cli.output import JsonTarget, check_json, emit_json
from jaxscan.cli.paths import Place, calibration_at, check_paths, file_at


def orthophoto(
    cloud: CloudPath,
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    pixel_mm: float = 5.0,
    calibration: OptionalCalibrationPath = None,
    unit: CloudUnit = None,
    up: CloudUp = None,
    json: JsonTarget = None,
) -> None:
    """Draw the walls of a room straight on: `jaxscan orthophoto room.ply -o walls`.

    Writes a picture of every wall, W1.png and so on, named as in the plan, with a scale below it.

    Args:
        cloud: Cloud of a room, scanned from inside.
        output: Folder to write to; it is made where it is missing.
        pixel_mm: Size of a pixel on the wall.
        calibration: Calibration that the cloud was made with.
        json: Write the result as JSON too.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.errors import OutputError
    from jaxscan.files.disk import reported, whole_folder, write_atomically
    from jaxscan.report import with_scale
    from jaxscan.vision import encode_png

    positive("--pixel-mm", pixel_mm)
    reads = [*file_at("CLOUD", cloud), *calibration_at("--calibration", calibration)]
    check_paths(reads, file_at("--json", json))
    check_json(json)
    if output.exists() and not output.is_dir():
        raise OutputError(f"{output}: is a file; choose a folder with -o.")
    scanner, notes = calibrated(calibration)
    loaded, said = upright(cloud, unit, up)
    notes += said
    survey = jaxscan.survey_room(loaded, scanner=scanner)
    notes += [f"{remark}." for remark in survey.outline.remarks]
    pictures = jaxscan.draw_orthophotos(survey, np.asarray(loaded.rgb), pixel_m=pixel_mm / 1e3)
    files = [output / f"{picture.side}.png" for picture in pictures]
    check_paths(reads, [*(Place("the picture", file) for file in files), *file_at("--json", json)])
    with reported(f"{output}: cannot be written", error=OutputError), whole_folder(output) as part:
        for picture, file in zip(pictures, files, strict=True):
            words = f"{picture.side}, {pixel_mm:g} mm per pixel"
            content = encode_png(with_scale(picture.rgb, picture.pixel_m, words))
            write_atomically(part / file.name, content, error=OutputError, durable=False)
    out = notes_first(notes, json)
    for picture, file in zip(pictures, files, strict=True):
        out.print(f"written: {file}, {100 * picture.seen.mean():.0f} % seen")
    walls = [
        {"wall": picture.side, "file": str(file), "rows": picture.rgb.shape[0], "columns": picture.rgb.shape[1]}
        | {"seen": float(picture.seen.mean())}
        for picture, file in zip(pictures, files, strict=True)
    ]
    emit_json(json, "orthophoto", {"pixel_m": pixel_mm / 1e3, "walls": walls, "notes": notes})
