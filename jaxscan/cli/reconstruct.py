"""`jaxscan reconstruct`: makes a coloured cloud from a captured sweep."""

import shlex
import time
from typing import Literal

import numpy as np

from jaxscan import api
from jaxscan import stripes as stripe_search
from jaxscan.cli.options import (
    MAX_RANGE_M,
    MIN_RANGE_M,
    CalibrationPath,
    CapturePath,
    Choice,
    CloudOutputPath,
    Smooth,
    at_least,
    check_paths,
    range_limits,
)
from jaxscan.cli.progress import progress_bar
from jaxscan.cli.terminal import console, emit_json
from jaxscan.errors import OptionError
from jaxscan.files import calibration as calibration_files
from jaxscan.files import capture as capture_files
from jaxscan.files import clouds as cloud_files


def reconstruct(
    capture: CapturePath,
    /,
    *,
    calibration: CalibrationPath,
    output: CloudOutputPath,
    every: int = 1,
    estimator: str = "gaussian",
    choice: Choice = "path",
    min_range: float = MIN_RANGE_M,
    max_range: float = MAX_RANGE_M,
    check_steps: bool = False,
    smooth: Smooth = "edge",
    colour: Literal["photographs", "stripe"] = "photographs",
    cache: bool = True,
    compare: bool = True,
) -> None:
    """Reconstruct a sweep: `jaxscan reconstruct captures/room -c calibration.json -o room.ply`.

    Args:
        capture: Folder of the captured sweep.
        calibration: Calibration file, as `jaxscan calibrate` writes it or written by hand.
        every: Use every n-th record only.
        estimator: Method that finds the centre of a stripe on a line: `gaussian` fits a Gaussian;
            `centre_of_gravity` takes the centre of gravity of the light, for one candidate per line.
        choice: Candidate of a line that becomes the stripe; `path` takes the best path over all lines.
        min_range: Smallest distance from the camera [m].
        max_range: Largest distance from the camera [m]; a limit that fits the room excludes many reflections.
        check_steps: Compare every centre with the neighbouring steps; most reflections do not continue there.
        smooth: Whether a point uses its neighbours along the stripe: `edge` uses them where the surface is continuous
            and none across an edge; `off` takes every row by itself.
        colour: Where the colour of a point is from: `photographs` blends all laser-off images that show it; `stripe`
            takes that of its own record alone.
        cache: Keep the stripes beside the capture, and use them again next time.
        compare: Compare the images with the sha256 in the journal; without, raw frames are read faster.
    """
    at_least(1, "--every", every)
    range_limits("--min-range", min_range, "--max-range", max_range)
    if check_steps and choice == "all":
        raise OptionError("--check-steps: found with --choice all, expected with a choice of one candidate per line.")
    stripes = api.StripeSettings(estimator=estimator, choice=choice)
    try:
        stripe_search.estimator_of(stripes)
    except ValueError as problem:
        raise OptionError(f"--estimator: {problem}") from problem
    settings = api.ReconstructSettings(
        stripes=stripes, min_range_m=min_range, max_range_m=max_range, check_steps=check_steps, smooth=smooth
    )
    check_paths(
        {"CAPTURE": capture, "--calibration": calibration},
        {"--output": output},
        kept={"the stripes": capture / capture_files.CACHE_NAME if cache else None},
    )
    cloud_files.check_cloud_path(output)
    sweep = api.open_capture(capture, compare=compare).every(every)
    scanner = api.load_scanner(calibration)
    out = console()
    coloured = colour == "photographs" and api.has_photographs(sweep)
    chosen = api.photograph_notes(sweep, scanner, "points") if coloured else []
    before = [*calibration_files.calibration_notes(calibration), *sweep.notes, *chosen]
    out.notes(before)
    start = time.perf_counter()
    with progress_bar("Reconstructing") as progress:
        progress.doing("finding stripes, compiling first where needed")
        done = api.reconstruct_capture(sweep, scanner, settings=settings, progress=progress, cache=cache)
    cloud = done.cloud
    if coloured:
        with progress_bar("Colouring from photographs") as progress:
            cloud = api.colour_cloud(cloud, sweep, scanner, progress=progress)
    seconds = time.perf_counter() - start
    out.notes(done.notes)
    if done.noise:
        out.print(f"noise: {done.noise}")
    if done.kept:
        out.print("stripes from the cache" if done.from_cache else "stripes kept for next time")
    api.save_cloud(cloud, output, calibration_digest=calibration_files.calibration_digest(calibration))
    valid = np.asarray(cloud.valid)
    points = int(valid.sum())
    random, systematic = (
        float(np.median(np.asarray(sigma)[valid])) for sigma in (cloud.sigma_random, cloud.sigma_systematic)
    )
    out.print(
        f"{points:,} points from {len(sweep)} records in {seconds:.1f} s "
        f"({1e3 * seconds / len(sweep):.1f} ms a pair, {points / seconds:,.0f} points a second)"
    )
    out.print(f"median sigma along the ray: {1e3 * random:.2f} mm random, {1e3 * systematic:.2f} mm systematic")
    out.print(f"written: {output}")
    out.print(f"next: {shlex.join(['jaxscan', 'view', str(output), '-c', str(calibration)])}")
    emit_json(
        {
            "cloud": str(output),
            "records": len(sweep),
            "points": points,
            "seconds_s": seconds,
            "median_sigma_random_m": random,
            "median_sigma_systematic_m": systematic,
            "colour": "photographs" if coloured else "stripe",
            "stripes_from_cache": done.from_cache,
            "stripes_kept": done.kept,
            "notes": [*before, *done.notes],
            "noise": done.noise,
        },
    )
