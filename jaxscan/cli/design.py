"""`jaxscan design`: a rig for a wanted accuracy."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Annotated, Any

from jaxscan import api
from jaxscan import design as rigs
from jaxscan.cli.help import Arg
from jaxscan.cli.options import check_paths
from jaxscan.cli.terminal import Terminal, console, emit_json, table
from jaxscan.errors import OptionError, OutputError
from jaxscan.files import disk


def design(
    *,
    range: Annotated[str, Arg("LENGTH")],
    sigma: Annotated[str, Arg("LENGTH")],
    camera: Annotated[str | None, Arg("SIZE")] = None,
    pixel: Annotated[str, Arg("LENGTH")] = "3.45um",
    lens: Annotated[str | None, Arg("LENGTH")] = None,
    baseline: Annotated[str | None, Arg("LENGTH")] = None,
    longest_baseline: Annotated[str, Arg("LENGTH")] = "0.6m",
    field: Annotated[str, Arg("ANGLE")] = "40deg",
    stripe_noise: Annotated[str | None, Arg("PIXELS")] = None,
    calibration_noise: Annotated[str | None, Arg("PIXELS")] = None,
    step: Annotated[str, Arg("ANGLE")] = "0.2deg",
    output: Annotated[Path | None, Arg(short="-o")] = None,
    save_rig: Path | None = None,
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
    """
    step_deg = quantity("--step", step, DEGREES, (0.0125, 90.0))
    if output is not None and output.suffix.lower() != ".png":
        raise OutputError(f'{output}: cannot write "{output.suffix}", known is .png.')
    if save_rig is not None and save_rig.suffix.lower() != ".toml":
        raise OutputError(f'{save_rig}: cannot write "{save_rig.suffix}", known is .toml.')
    check_paths({}, {"--output": output, "--save-rig": save_rig})
    wish = rigs.RigWish(
        range_m=quantity("--range", range, METRES, (0.05, 100.0)),
        sigma_m=quantity("--sigma", sigma, METRES, (1e-7, 1.0)),
        longest_baseline_m=quantity("--longest-baseline", longest_baseline, METRES, (0.005, 10.0)),
        field_deg=quantity("--field", field, DEGREES, (1.0, 110.0)),
    )
    given: dict[str, Any] = {}
    side = quantity("--pixel", pixel, MICROMETRES, (0.5, 50.0))
    if camera is not None:
        given["sensors"] = (rigs.Sensor(*image_size("--camera", camera), side * 1e-6),)
    if lens is not None:
        given["lenses_mm"] = (1e3 * quantity("--lens", lens, METRES, (1e-3, 0.5)),)
    if baseline is not None:
        given["baselines_m"] = (quantity("--baseline", baseline, METRES, (0.005, 10.0)),)
        if given["baselines_m"][0] > wish.longest_baseline_m:
            raise OptionError(
                f"--baseline: found {given['baselines_m'][0]:g} m, expected at most --longest-baseline, "
                f"{wish.longest_baseline_m:g} m."
            )
    if stripe_noise is not None:
        given["stripe_px"] = quantity("--stripe-noise", stripe_noise, PIXELS, (1e-4, 10.0))
    if calibration_noise is not None:
        given["calibration_px"] = quantity("--calibration-noise", calibration_noise, PIXELS, (0.0, 10.0))
    wish = dataclasses.replace(wish, **given)
    for path in (output, save_rig):
        if path is not None:
            disk.check_writable(path)
    choice = rigs.design_rig(wish)
    out = console()
    result = numbers(choice, step_deg, _scan_seconds(step_deg))
    show(out, choice, result)
    if output is not None:
        from jaxscan.report.pictures import design_picture

        disk.write_atomically(output, design_picture(choice))
        out.print(f"written: {output}")
    if save_rig is not None:
        api.save_designed_rig(choice.design, save_rig, step_deg=step_deg)
        out.print(f"written: {save_rig}; `jaxscan simulate {save_rig} -o captures/design` renders it")
    emit_json(result)


def _scan_seconds(step_deg: float) -> float:
    """Duration of a sweep as `jaxscan scan` plans it, with its usual times, a gear of 9 to 1, and any camera."""
    from scanrig.config import RigConfig
    from scanrig.session.plan import estimate, plan_sweep

    steps = max(1, round(360.0 / step_deg))
    camera = {"kind": "aravis", "width": 1280, "height": 1024}
    rig = RigConfig.model_validate({"turntable": {"gear": (9, 1)}, "sweep": {"steps": steps}, "camera": camera})
    targets, _ = plan_sweep(rig)
    return estimate(rig, [target.position for target in targets]).seconds


_SHARES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""Depths of the table, as shares of the wanted range."""
_SHOWN = 12
"""Alternatives that are printed; JSON and picture have all."""


def numbers(choice: "rigs.RigChoice", step_deg: float, seconds: float) -> dict[str, Any]:
    """The result as JSON output; sigmas other than `stripe_mm` contain the allowance for the calibration."""
    wish, chosen = choice.wish, choice.design
    near, far = chosen.view_m
    depths = [share * wish.range_m for share in _SHARES if near <= share * wish.range_m <= far]
    stripe, both = (rigs.spread_at(chosen, depths, noise) for noise in (wish.stripe_px, wish.noise_px))
    rows = [
        {"depth_m": depths[k], "stripe_mm": 1e3 * float(stripe.depth[k])}
        | {f"{name}_mm": 1e3 * float(getattr(both, name)[k]) for name in ("depth", "across", "along")}
        for k in range(len(depths))
    ]
    return {
        "wish": {"range_m": wish.range_m, "sigma_mm": 1e3 * wish.sigma_m, "field_deg": wish.field_deg}
        | {"stripe_px": wish.stripe_px, "calibration_px": wish.calibration_px},
        "chosen": _entry(choice, chosen, choice.sigma_m)
        | {
            "focal_px": chosen.focal_px,
            "pixel_um": 1e6 * chosen.sensor.pixel_m,
            "field_across_deg": chosen.fields_deg[0],
            "laser_angle_deg": chosen.laser_angle_deg,
            "crossing_m": chosen.crossing_m,
            "fan_deg": chosen.fan_deg,
            "widest_line_mm": 1e3 * chosen.widest_line_m(wish.range_m),
            "near_m": near,
            "far_m": far if math.isfinite(far) else None,
            "points_per_degree": chosen.points_per_degree(),
        },
        "sigma": rows,
        "scan": {"step_deg": step_deg, "steps": max(1, round(360.0 / step_deg)), "seconds_s": seconds},
        "alternatives": [_entry(choice, *one) for one in choice.alternatives],
    }


def show(out: Terminal, choice: "rigs.RigChoice", result: dict[str, Any]) -> None:
    """Print the rig, its accuracy by distance, and the alternatives nearest to it."""
    wish, rig, scan = result["wish"], result["chosen"], result["scan"]
    out.print(
        f"camera: {rig['width']} x {rig['height']} px of {rig['pixel_um']:g} um; lens {rig['lens_mm']:g} mm "
        f"({rig['focal_px']:.0f} px), field of view {rig['field_across_deg']:.0f}° x {rig['field_along_deg']:.0f}°"
    )
    out.print(
        f"laser: {1e3 * rig['baseline_m']:.0f} mm beside the camera, turned towards its axis by "
        f"{rig['laser_angle_deg']:.2f}° (crosses it at {rig['crossing_m']:g} m); fan {rig['fan_deg']:g}°, line "
        f"thin, at most {rig['widest_line_mm']:.0f} mm wide there"
    )
    far = "without limit" if rig["far_m"] is None else f"to {rig['far_m']:.2f} m"
    out.print(f"the stripe is in the image from {rig['near_m']:.2f} m {far}")
    out.print(
        f"{rig['points_per_degree']:.0f} points per degree along the stripe; {scan['steps']} steps of "
        f"{scan['step_deg']:g}° take about {math.ceil(scan['seconds_s'] / 60)} min"
    )
    columns = ("depth, m", "depth, mm", "of it stripe", "across, mm", "along, mm")
    rows = [
        (f"{row['depth_m']:.2f}", *(f"{row[key]:.3f}" for key in ("depth_mm", "stripe_mm", "across_mm", "along_mm")))
        for row in result["sigma"]
    ]
    out.print(table("Standard deviation of a single point", columns, rows))
    out.print(
        f"for stripes found to {wish['stripe_px']:g} px, and an allowance of {wish['calibration_px']:g} px for the "
        "calibration; planes and lengths, made of many points, are limited by the allowance alone"
    )
    nearest = sorted(
        (one for one in result["alternatives"] if one["wide_enough"]),
        key=lambda one: abs(math.log(one["sigma_mm"] / rig["sigma_mm"])),
    )[:_SHOWN]
    ordered = sorted(nearest, key=lambda one: (one["lens_mm"], one["baseline_m"]))
    columns = ("lens, mm", "field along", "baseline, m", f"sigma at {wish['range_m']:g} m, mm", "")
    rows = [
        (f"{one['lens_mm']:g}", f"{one['field_along_deg']:.0f}°", f"{one['baseline_m']:g}", f"{one['sigma_mm']:.3f}")
        + ("reaches it" if one["reaches"] else "does not",)
        for one in ordered
    ]
    out.print(table(f"Alternatives with this camera; wished are {wish['sigma_mm']:g} mm", columns, rows))


def _entry(choice: "rigs.RigChoice", design: "rigs.RigDesign", sigma_m: float) -> dict[str, Any]:
    return {
        "width": design.sensor.width,
        "height": design.sensor.height,
        "lens_mm": design.lens_mm,
        "baseline_m": design.baseline_m,
        "field_along_deg": design.fields_deg[1],
        "sigma_mm": 1e3 * sigma_m,
        "wide_enough": rigs.wide_enough(design, choice.wish),
        "reaches": choice.reaches(design, sigma_m),
    }


METRES = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6}
"""Units of lengths; a number alone is in metres."""
MICROMETRES = {"um": 1.0, "µm": 1.0, "μm": 1.0}
PIXELS = {"": 1.0, "px": 1.0}
DEGREES = {"": 1.0, "deg": 1.0, "°": 1.0}
MOST_PIXELS = 100_000_000
_NUMBER = re.compile(r"([0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})\s?([a-zA-Zµμ°]*)")
_SIZE = re.compile(r"([0-9]{1,5})\s?[x×]\s?([0-9]{1,5})")


def quantity(option: str, text: str, units: dict[str, float], limits: tuple[float, float]) -> float:
    """A number with its unit.

    Args:
        option: Name of the option, for messages.
        text: What was typed.
        units: Accepted units and their sizes; "" for a number alone.
        limits: Smallest and largest value, in the unit of size 1.

    Raises:
        OptionError: If it is no number, has another unit, or lies outside the limits.
    """
    found = _NUMBER.fullmatch(text.strip())
    known = ", ".join(unit for unit in units if unit)
    if found is None or found[2] not in units:
        raise OptionError(f"{option}: found {text[:40]!r}, expected a number above 0 with one of the units {known}.")
    value = float(found[1]) * units[found[2]]
    low, high = limits
    if not low <= value <= high:
        base = next(unit for unit, size in units.items() if unit and size == 1.0)
        raise OptionError(f"{option}: found {text[:40]!r}, expected {low:g} {base} to {high:g} {base}.")
    return value


def image_size(option: str, text: str) -> tuple[int, int]:
    """Width and height in pixels.

    Raises:
        OptionError: If it is not WIDTHxHEIGHT within 8 to 65535 px and 100 megapixels.
    """
    found = _SIZE.fullmatch(text.strip())
    width, height = (int(found[1]), int(found[2])) if found else (0, 0)
    if not (8 <= width <= 65535 and 8 <= height <= 65535):
        raise OptionError(f"{option}: found {text[:40]!r}, expected WIDTHxHEIGHT of 8 to 65535 px, as 2448x2048.")
    if width * height > MOST_PIXELS:
        raise OptionError(f"{option}: found {text[:40]!r}, expected at most {MOST_PIXELS // 10**6} megapixels.")
    return width, height
