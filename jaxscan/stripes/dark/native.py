"""The native loops of the prediction, loaded when they are needed."""

import numpy as np
from jaxtyping import Float, Int16


CODES = 1024
"""Values of which medians are taken are whole numbers from 0 to below this."""


def running_median(
    codes: Int16[np.ndarray, "frames lines samples"], half: int
) -> Int16[np.ndarray, "frames lines samples"]:
    """Median along each line of the samples within `half` on both sides; of fewer at its ends.

    Args:
        codes: Values from 0 to `CODES` - 1.
        half: Samples on either side.
    """
    # Here, because it loads numba: whoever predicts nothing does not wait for that.
    from jaxscan.stripes.dark.native_loops import median_of_lines

    out = np.empty_like(codes)
    for frame, result in zip(codes, out, strict=True):
        median_of_lines(np.ascontiguousarray(frame), half, result)
    return out


def warped(
    planes: Float[np.ndarray, "planes lines samples"], where: Float[np.ndarray, "a b 2"], pitch: int
) -> Float[np.ndarray, "planes lines samples"]:
    """Planes read at other places, bilinear; beyond them their border.

    Args:
        planes: float32.
        where: Line and sample that are read, at every `pitch`-th line and sample; bilinear in between.
        pitch: Distance of the given places.
    """
    from jaxscan.stripes.dark.native_loops import warp

    out = np.empty_like(planes)
    warp(np.ascontiguousarray(planes), where, out, pitch)
    return out
