"""Faults of a table in words: found, expected, remedy."""

import numpy as np


POWER, RATIO = 0.02, 5e-3
"""A factor is a power of two, or a ratio of small numbers, where it is so near to one [1]."""
FULL_STEPS = {
    1.8: "one full step of a motor with 200 steps per turn on the axis",
    0.9: "one full step of a motor with 400 steps per turn on the axis",
    0.2: "one full step of a motor with 200 steps per turn behind a gear of 9",
    0.1125: "one full step of a motor with 200 steps per turn behind a gear of 16",
    0.1: "one full step of a motor with 200 steps per turn behind a gear of 18",
}
"""Usual full steps of a table [deg]."""
STEP_TOLERANCE = 0.05
"""Part of a full step by which a lost one may differ from it, beside its sigmas."""
STEP_SIGMAS = 2.5


def usual_ratio(factor: float) -> tuple[int, int] | None:
    """The ratio of small numbers, or of usual numbers of steps, that is nearest to a factor; None if none is near."""
    powers = [(2**k, 1) for k in range(1, 7)] + [(1, 2**k) for k in range(1, 7)]
    gears = [(a, b) for a in range(1, 13) for b in range(1, 13) if np.gcd(a, b) == 1 and a != b]
    for pairs, tolerance in ((powers, POWER), (gears, RATIO)):
        nearest = min(pairs, key=lambda pair: abs(factor * pair[1] / pair[0] - 1.0))
        if abs(factor * nearest[1] / nearest[0] - 1.0) < tolerance:
            return nearest
    return None


def say_factor(name: str, factor: float) -> str:
    """The sentence for a wrong number of steps per turn."""
    pair = usual_ratio(factor)
    if pair is None:
        return (
            f"{name}: the table turned about {factor:.3f} times as far as its journal says, expected 1; look for a "
            "belt that slips or a wrong gear ratio, set the steps per turn, and capture again"
        )
    up, down = pair
    configured = 3200 if 3200 * down % up == 0 else 3200 * up
    true = configured * down // up
    return (
        f"{name}: the table turned {up / down:.3f} times as far as its journal says, expected 1; for instance {true} "
        f"microsteps per turn where the configuration says {configured}: set microsteps_per_turn of the table to "
        f"{down / up:g} times its value"
    )


def say_jump(name: str, records: tuple[int, int], degrees: float, sigma_deg: float) -> str:
    """The sentence for a lost step between two records; `degrees` is negative where the table lags behind."""
    way, size = ("behind" if degrees < 0 else "ahead"), abs(degrees)
    near = [step for step in FULL_STEPS if abs(size - step) < max(STEP_TOLERANCE * step, STEP_SIGMAS * sigma_deg)]
    likely = min(near, key=lambda step: abs(size - step), default=None)
    cause = ""
    if likely is not None:
        cause = f": {likely:g} degrees are {FULL_STEPS[likely]}, which was {'lost' if degrees < 0 else 'made twice'}"
    return (
        f"{name}: between records {records[0]} and {records[1]} the table comes to stand {size:.4g} +- {sigma_deg:.2g} "
        f"degrees {way}, expected none{cause}; look for an obstacle, a loose pulley, too little current or too "
        "fast a ramp"
    )
