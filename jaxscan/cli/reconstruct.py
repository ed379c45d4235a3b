"""`jaxscan reconstruct`: a captured sweep to a coloured cloud."""

import time

import numpy as np

from jaxscan import api
from jaxscan.cli.options import CalibrationPath, CapturePath, OutputPath, at_least
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.progress import progress_bar
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.clouds import check_cloud_path


def reconstruct(
    capture: CapturePath,
    /,
    *,
    calibration: CalibrationPath,
    output: OutputPath,
    every: int = 1,
    json: JsonTarget = None,
) -> None:
    """Reconstruct a sweep: `jaxscan reconstruct captures/room -c calibration.json -o room.ply`.

    Args:
        capture: Folder of the captured sweep.
        calibration: Calibration of the scanner, as `jaxscan calibrate` writes it.
        output: Cloud to write; the suffix chooses the format (.ply .e57 .laz .las .pcd .xyz .ptx .npz).
        every: Use every n-th record only.
        json: Write the result as JSON too.
    """
    at_least(1, "--every", every)
    check_cloud_path(output)
    check_json(json)
    sweep = api.open_capture(capture).every(every)
    scanner = api.load_scanner(calibration)
    out = console(json)
    for note in sweep.notes:
        out.print(f"note: {note}")
    start = time.perf_counter()
    with progress_bar("Reconstructing") as progress:
        cloud = api.reconstruct(sweep, scanner, progress=progress)
    seconds = time.perf_counter() - start
    api.save_cloud(cloud, output, calibration_digest=calibration_digest(calibration))
    valid = np.asarray(cloud.valid)
    points = int(valid.sum())
    median_mm = [
        1e3 * float(np.median(np.asarray(sigma)[valid])) for sigma in (cloud.sigma_random, cloud.sigma_systematic)
    ]
    out.print(
        f"{points} points from {len(sweep)} records in {seconds:.1f} s "
        f"({1e3 * seconds / len(sweep):.1f} ms a pair, {points / seconds:.0f} points a second)"
    )
    out.print(f"median sigma along the ray: {median_mm[0]:.2f} mm random, {median_mm[1]:.2f} mm systematic")
    out.print(f"written: {output}")
    emit_json(
        json,
        "reconstruct",
        {
            "cloud": str(output),
            "records": len(sweep),
            "points": points,
            "seconds_s": seconds,
            "median_sigma_random_m": median_mm[0] / 1e3,
            "median_sigma_systematic_m": median_mm[1] / 1e3,
            "notes": list(sweep.notes),
        },
    )
