"""The choice of a rig: the fewest pixels, then the widest lens, then the shortest baseline that reach the wish."""

import math
from collections.abc import Callable
from typing import NamedTuple

from jaxscan.design.rig import RigDesign, RigWish, Sensor, depth_sigma
from jaxscan.errors import OptionError


class RigChoice(NamedTuple):
    """A rig that reaches the wish, and what else was tried with its sensor."""

    wish: RigWish
    design: RigDesign
    sigma_m: float
    """Standard deviation of a single point's depth at the wanted range, with the allowance [m]."""
    alternatives: tuple[tuple[RigDesign, float], ...]
    """Every lens with every baseline of the chosen sensor, and its sigma [m]; those whose field is too narrow too."""

    def reaches(self, design: RigDesign, sigma_m: float) -> bool:
        """Whether a design is as accurate and sees as much as was wished."""
        return sigma_m <= self.wish.sigma_m and wide_enough(design, self.wish)


def design_rig(wish: RigWish) -> RigChoice:
    """Choose camera, lens, baseline and laser for a wanted accuracy.

    The sheet crosses the optical axis at the wanted range, so that its points are seen in the middle of the image.

    Args:
        wish: The wanted accuracy and the bounds.

    Returns:
        The first design that reaches the wish, and its alternatives.

    Raises:
        OptionError: If there is none; it says what would be possible.
    """
    tried = [(sensor, _with_sensor(sensor, wish)) for sensor in wish.sensors]
    for _, found in tried:
        for design, sigma in found:
            if sigma <= wish.sigma_m and wide_enough(design, wish):
                return RigChoice(wish, design, sigma, tuple(found))
    every = [one for _, found in tried for one in found]
    seen = [one for one in every if wide_enough(one[0], wish)]
    raise OptionError(_impossible(wish, seen) if seen else _unseen(wish, every))


def wide_enough(design: RigDesign, wish: RigWish) -> bool:
    """Whether the field along the stripe is as wide as was wished, and a usual laser fills it."""
    return design.fields_deg[1] >= wish.field_deg and design.fan_deg is not None


def _with_sensor(sensor: Sensor, wish: RigWish) -> list[tuple[RigDesign, float]]:
    """Every lens, widest first, with every baseline, shortest first, and its sigma at the wanted range [m]."""
    # A sheet that crosses the axis at more than 45 degrees lights little of what the camera sees.
    longest = min(wish.longest_baseline_m, wish.range_m)
    baselines = [one for one in sorted(wish.baselines_m) if one <= longest]
    designs = [RigDesign(sensor, lens, one, wish.range_m) for lens in sorted(wish.lenses_mm) for one in baselines]
    return [(design, depth_sigma(design, wish.range_m, wish.noise_px)) for design in designs]


def _impossible(wish: RigWish, seen: list[tuple[RigDesign, float]]) -> str:
    asked = f"{1e3 * wish.sigma_m:.3g} mm at {wish.range_m:g} m"
    bounds = f"baselines up to {wish.longest_baseline_m:g} m and a field of {wish.field_deg:g}° along the stripe"
    design, best = min(seen, key=lambda one: one[1])
    # Sigma grows with the square of the distance.
    nearer = wish.range_m * math.sqrt(wish.sigma_m / best)
    camera = f"{design.sensor.width} x {design.sensor.height} px, {design.lens_mm:g} mm, {design.baseline_m:g} m"
    instead = f", or {1e3 * wish.sigma_m:.3g} mm at {_down(nearer)} m" if nearer > design.baseline_m else ""
    return (
        f"{asked}: no rig with {bounds} reaches it; possible are {_up(1e3 * best)} mm at {wish.range_m:g} m ({camera})"
        f"{instead}; {_advice(wish)}."
    )


def _advice(wish: RigWish) -> str:
    """What might still be changed."""
    given = [len(each) == 1 for each in (wish.sensors, wish.lenses_mm, wish.baselines_m)]
    named = [name for name, is_given in zip(("--camera", "--lens", "--baseline"), given, strict=True) if is_given]
    free = [] if given[2] else ["raise --longest-baseline"]
    free += [] if given[1] else ["lower --field"]
    return "or " + ", or ".join([*free, *(f"leave {name} to the command" for name in named)])


def _unseen(wish: RigWish, every: list[tuple[RigDesign, float]]) -> str:
    if not every:
        shortest = min(wish.baselines_m)
        return f"no baseline is short enough: found {shortest:g} m, expected at most the range, {wish.range_m:g} m."
    fields = [design.fields_deg[1] for design, _ in every if design.fan_deg is not None]
    possible = f"at most {math.floor(max(fields))}°" if fields else "none that the fan of a usual laser fills"
    return (
        f"a field of {wish.field_deg:g}° along the stripe: the lenses have {possible}; lower --field, or take another "
        "lens, or a camera with more pixels along the stripe."
    )


def _up(value: float) -> str:
    """Two digits, rounded up, so that this value is reachable."""
    return _two_digits(value, math.ceil)


def _down(value: float) -> str:
    return _two_digits(value, math.floor)


def _two_digits(value: float, whole: Callable[[float], int]) -> str:
    scale = 10.0 ** (1 - math.floor(math.log10(value)))
    return f"{whole(value * scale) / scale:.6g}"
