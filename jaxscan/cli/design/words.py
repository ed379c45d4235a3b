"""What `jaxscan design` says."""

import math
from typing import TYPE_CHECKING, Any

from jaxscan.cli.process.terminal import Terminal, table


if TYPE_CHECKING:
    from jaxscan.design import RigChoice, RigDesign


_SHARES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""Depths of the table, as shares of the wanted range."""
_SHOWN = 12
"""Alternatives that are printed; JSON and picture have all."""


def numbers(choice: "RigChoice", step_deg: float, seconds: float) -> dict[str, Any]:
    """The result as JSON tells it; sigmas contain the allowance for the calibration, but for `stripe_mm`."""
    from jaxscan.design import spread_at

    wish, chosen = choice.wish, choice.design
    near, far = chosen.view_m
    depths = [share * wish.range_m for share in _SHARES if near <= share * wish.range_m <= far]
    stripe, both = (spread_at(chosen, depths, noise) for noise in (wish.stripe_px, wish.noise_px))
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


def show(out: Terminal, choice: "RigChoice", result: dict[str, Any]) -> None:
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


def _entry(choice: "RigChoice", design: "RigDesign", sigma_m: float) -> dict[str, Any]:
    from jaxscan.design import wide_enough

    return {
        "width": design.sensor.width,
        "height": design.sensor.height,
        "lens_mm": design.lens_mm,
        "baseline_m": design.baseline_m,
        "field_along_deg": design.fields_deg[1],
        "sigma_mm": 1e3 * sigma_m,
        "wide_enough": wide_enough(design, choice.wish),
        "reaches": choice.reaches(design, sigma_m),
    }
