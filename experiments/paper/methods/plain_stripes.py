"""Two plain stripe finders: centre of gravity and highest pixel. The paper does not say how it found its stripe."""

import numpy as np


THRESHOLD = 25
"""Difference above which a pixel counts as the stripe's light [DN]: above the noise of all but the brightest pixels."""
REACH = 8
"""Pixels to both sides of the highest one that a centre of gravity may use."""


def highest(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The whole pixel of each row at which the difference of the frames is highest.

    Args:
        on: Laser-on frames, uint8 [rows, columns] or [records, rows, columns].
        off: Laser-off frames of the same shape.

    Returns:
        u: Column, float64 [(records,) rows]; zero where not valid. The first of equals.
        valid: Whether it is above the threshold, bool of the same shape.
    """
    _, at, valid = _strongest(on, off)
    return np.where(valid, at, 0).astype(np.float64), valid


def gravity(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The centre of gravity of the difference, over the pixels round the highest one that are above the threshold.

    Args:
        on: Laser-on frames, uint8 [rows, columns] or [records, rows, columns].
        off: Laser-off frames of the same shape.

    Returns:
        u: Column, float64 [(records,) rows]; zero where not valid.
        valid: Whether the highest pixel is above the threshold, bool of the same shape.
    """
    light, at, valid = _strongest(on, off)
    steps = np.arange(-REACH, REACH + 1)
    columns = at[..., None] + steps
    inside = (columns >= 0) & (columns < light.shape[-1])
    near = np.take_along_axis(light, np.clip(columns, 0, light.shape[-1] - 1), -1).astype(np.float64)
    over = inside & (near > THRESHOLD)
    # A pixel counts if all between it and the highest one do.
    right = np.logical_and.accumulate(over[..., REACH:], -1)
    left = np.logical_and.accumulate(over[..., REACH::-1], -1)[..., ::-1]
    weight = np.where(np.concatenate([left[..., :-1], right], -1), near, 0.0)
    total = weight.sum(-1)
    shift = (weight * steps).sum(-1) / np.where(total > 0, total, 1.0)
    return np.where(valid, at + shift, 0.0), valid


def _strongest(on: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Difference of the frames [DN], column of the highest pixel of each row, and whether it is above the threshold."""
    if on.shape != off.shape or on.dtype != np.uint8 or off.dtype != np.uint8 or on.ndim not in (2, 3):
        raise ValueError(
            f"Frames must be uint8 [(records,) rows, columns] of one shape, got {on.dtype} {on.shape} and "
            f"{off.dtype} {off.shape}."
        )
    light = on.astype(np.int16)
    light -= off
    at = light.argmax(-1)
    top = np.take_along_axis(light, at[..., None], -1)[..., 0]
    return light, at, top > THRESHOLD


EXTRACTORS = {"gravity": gravity, "highest": highest}
"""Both by name."""
METHODS = {"gravity": "paper's method, centre of gravity", "highest": "paper's method, highest pixel"}
"""The paper's method with either of them, in the words of tables and pictures."""
