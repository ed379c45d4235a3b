"""`jaxscan design`: a rig for a wanted accuracy."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxscan.cli.design.quantities import DEGREES, METRES, MICROMETRES, PIXELS, image_size, quantity
from jaxscan.cli.design.words import numbers, show

# Loads a name when it is first used, so that `--help` does not load JAX.
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.errors import OptionError, OutputError


if TYPE_CHECKING:
    from jaxscan.design import RigWish


def design(
    *,
    range: Annotated[str, tyro.conf.arg(metavar="LENGTH")],
    sigma: Annotated[str, tyro.conf.arg(metavar="LENGTH")],
    camera: Annotated[str | None, tyro.conf.arg(metavar="SIZE")] = None,
    pixel: Annotated[str, tyro.conf.arg(metavar="LENGTH")] = "3.45um",
    lens: Annotated[str | None, tyro.conf.arg(metavar="LENGTH")] = None,
    baseline: Annotated[str | None, tyro.conf.arg(metavar="LENGTH")] = None,
    longest_baseline: Annotated[str, tyro.conf.arg(metavar="LENGTH")] = "0.6m",
    field: Annotated[str, tyro.conf.arg(metavar="ANGLE")] = "40deg",
    stripe_noise: Annotated[str | None, tyro.conf.arg(metavar="PIXELS")] = None,
    calibration_noise: Annotated[str | None, tyro.conf.arg(metavar="PIXELS")] = None,
    step: Annotated[str, tyro.conf.arg(metavar="ANGLE")] = "0.2deg",
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    save_rig: Path | None = None,
    json: JsonTarget = None,
) -> None:
    """Choose camera, lens, baseline and laser for an accuracy: `jaxscan design --range 4 --sigma 1mm`.

    Takes the fewest pixels, then the widest lens, then the shortest baseline that reach it. Lengths have units (4m,
    25cm, 1mm, 3.45um); a number alone is in metres.

    Args:
        range: Depth at which the accuracy is wanted.
        sigma: Wanted standard deviation of a single point's depth there.
        camera: Pixels across and along the stripe, if the camera is given; turned on its side, 1080x1440.
        pixel: Side of a pixel of that camera.
        lens: Focal length, if the lens is given.
        baseline: Distance from camera to laser, if it is given.
        longest_baseline: Longest baseline that may be built.
        field: Smallest field of view along the stripe.
        stripe_noise: Standard deviation of a stripe's centre; without, 0.1px, as measured on walls of 40 to 80 DN
            (experiments/results/unkind.md).
        calibration_noise: Allowance for the calibration; without, 0.05px, as measured there.
        step: Step of the table, for the time of a scan.
        output: Picture to write (.png): sigma against depth, and the alternatives.
        save_rig: Configuration to write, with which `jaxscan simulate` renders this rig.
        json: Write the result as JSON too.
    """
    step_deg = quantity("--step", step, DEGREES, (0.0125, 90.0))
    if output is not None and output.suffix.lower() != ".png":
        raise OutputError(f'{output}: cannot write "{output.suffix}", known is .png.')
    if save_rig is not None and save_rig.suffix.lower() != ".toml":
        raise OutputError(f'{save_rig}: cannot write "{save_rig.suffix}", known is .toml.')
    check_paths([], [*file_at("--output", output), *file_at("--save-rig", save_rig), *file_at("--json", json)])
    options = {
        "range": quantity("--range", range, METRES, (0.05, 100.0)),
        "sigma": quantity("--sigma", sigma, METRES, (1e-7, 1.0)),
        "longest": quantity("--longest-baseline", longest_baseline, METRES, (0.005, 10.0)),
        "field": quantity("--field", field, DEGREES, (1.0, 110.0)),
    }
    wish = _given(_wish(options, camera, pixel), lens, baseline)
    if stripe_noise is not None:
        wish = dataclasses.replace(wish, stripe_px=quantity("--stripe-noise", stripe_noise, PIXELS, (1e-4, 10.0)))
    if calibration_noise is not None:
        allowed = quantity("--calibration-noise", calibration_noise, PIXELS, (0.0, 10.0))
        wish = dataclasses.replace(wish, calibration_px=allowed)
    from jaxscan.files.disk import check_writable, write_atomically

    for path in (output, save_rig):
        if path is not None:
            check_writable(path)
    check_json(json)
    from jaxscan.design import design_rig

    choice = design_rig(wish)
    out = console(json)
    result = numbers(choice, step_deg, _scan_seconds(step_deg))
    show(out, choice, result)
    if output is not None:
        from jaxscan.report.pictures import design_picture

        write_atomically(output, design_picture(choice))
        out.print(f"written: {output}")
    if save_rig is not None:
        from jaxscan.api import save_designed_rig

        save_designed_rig(choice.design, save_rig, step_deg=step_deg)
        out.print(f"written: {save_rig}; `jaxscan simulate {save_rig} -o captures/design` renders it")
    emit_json(json, "design", result)


def _wish(options: dict[str, float], camera: str | None, pixel: str) -> "RigWish":
    from jaxscan.design import RigWish, Sensor

    wish = RigWish(
        range_m=options["range"],
        sigma_m=options["sigma"],
        longest_baseline_m=options["longest"],
        field_deg=options["field"],
    )
    side = quantity("--pixel", pixel, MICROMETRES, (0.5, 50.0))
    if camera is None:
        return wish
    width, height = image_size("--camera", camera, (8, 65535))
    return dataclasses.replace(wish, sensors=(Sensor(width, height, side * 1e-6),))


def _given(wish: "RigWish", lens: str | None, baseline: str | None) -> "RigWish":
    if lens is not None:
        wish = dataclasses.replace(wish, lenses_mm=(1e3 * quantity("--lens", lens, METRES, (1e-3, 0.5)),))
    if baseline is not None:
        length = quantity("--baseline", baseline, METRES, (0.005, 10.0))
        if length > wish.longest_baseline_m:
            raise OptionError(
                f"--baseline: found {length:g} m, expected at most --longest-baseline, {wish.longest_baseline_m:g} m."
            )
        wish = dataclasses.replace(wish, baselines_m=(length,))
    return wish


def _scan_seconds(step_deg: float) -> float:
    """Duration of a sweep as `jaxscan scan` plans it, with its usual times, a gear of 9 to 1, and any camera."""
    from scanrig.config import RigConfig
    from scanrig.session.plan import estimate, plan_sweep

    steps = max(1, round(360.0 / step_deg))
    camera = {"kind": "aravis", "width": 1280, "height": 1024}
    rig = RigConfig.model_validate({"turntable": {"gear": (9, 1)}, "sweep": {"steps": steps}, "camera": camera})
    targets, _ = plan_sweep(rig)
    return estimate(rig, [target.position for target in targets]).seconds
