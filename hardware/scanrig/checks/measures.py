"""Measures on a pair: how much of a ridge contrast explains, differences beside the laser, leak, clipping."""

import numpy as np
from jaxtyping import Float, Int

from scanrig.checks.frame_pair import CLIPPED, STACK, FramePair, median_of
from scanrig.checks.ridges import Relief, Ridges


_BLACK_DN = 32.0
_FEATURELESS_DN = 3.0
"""Under a lens cap a frame is darker than the first, and its large features are flatter than the second."""
_NOISE_CUT = 6.0
"""Residuals are clipped at this many standard deviations when the unrest is computed."""
_BESIDE = 14
"""Contrast may explain a ridge within this many samples on either side."""
_EXPLAINS_MOST = 1.5
"""Largest change by motion as a multiple of the contrast; thin moving objects exceed 1."""
_MOSTLY = 0.4
"""Least part of the ridges that contrast must not explain: for a laser it is nearly all, for motion a fifth."""
_MARGIN = 3.0
"""Ratio of the largest relative change of a contrast to its 90 % quantile."""
_ALIKE = 4.0
"""Number of neighbouring lines that see the same texture."""


def solid_part(ridges: Ridges, field: np.ndarray, frame: np.ndarray, explains: float) -> float:
    """Part of the lines whose ridge contrast of the other frame cannot explain; 0 if that is a minority of the ridges.

    Motion and flicker change a frame by a fraction of its contrast. A ridge that is higher than this fraction of the
    contrast of the other frame beside it is additional light.
    """
    rows = np.flatnonzero(ridges.clear)
    if len(rows) == 0:
        return 0.0
    at = ridges.at[rows]
    beside = np.clip(at[:, None] + np.arange(-_BESIDE, _BESIDE + 1), 0, field.shape[1] - 1)
    contrast = np.ptp(_smooth(frame[rows[:, None], beside]), 1)
    solid = float((peak_heights(field, rows, at) > explains * contrast).mean())
    return solid * len(rows) / len(ridges.at) if solid > _MOSTLY else 0.0


def explained_part(difference: np.ndarray, off: np.ndarray, relief: Relief) -> float:
    """Fraction of a frame's contrast by which it may have changed: near 0 if nothing moved, 1 if everything moved.

    Estimated from blocks with contrast, without those that may contain the stripe: along a door frame these could be a
    sixth of all.
    """
    few = slice(None, None, max(1, len(off) // 32))
    change, light = _smooth(difference[few]), _smooth(off[few])
    noise = 1.4826 * median_of(np.abs(change).ravel()) + 0.1
    blocks = change.shape[1] // 16
    change, light = (a[:, : 16 * blocks].reshape(len(a), blocks, 16) for a in (change, light))
    contrast = np.ptp(light, 2)
    structured = contrast > 8.0 * noise
    for found in relief:
        own = np.abs(np.arange(blocks) - found.at[few, None] // 16) <= 1
        structured &= ~(own & found.seen[few, None])
    if np.count_nonzero(structured) < 50:
        return 1.0
    part = np.maximum(np.abs(change[structured]).max(1) - 3.0 * noise, 0.0) / contrast[structured]
    return float(min(_MARGIN * np.quantile(part, 0.9) + 0.1, _EXPLAINS_MOST))


def _smooth(field: np.ndarray) -> np.ndarray:
    return (field[:, :-2] + field[:, 1:-1] + field[:, 2:]) * np.float32(1.0 / 3.0)


def unrest_of(difference: Float[np.ndarray, "lines samples"], off: Float[np.ndarray, "lines samples"]) -> float:
    """Root mean square of the negative differences, over that of the noise; a laser makes only positive ones.

    The noise is estimated from second differences along the lines, as the median over blocks of similar level, so that
    smooth light and edges do not contribute.
    """
    few = slice(None, None, max(1, len(off) // 32))
    residual, level = difference[few], off[few]
    block = 16
    blocks = residual.shape[1] // block
    if blocks == 0:
        return 0.0
    second = residual[:, :-4] - 2.0 * residual[:, 2:-2] + residual[:, 4:]
    second = np.pad(second, ((0, 0), (0, 4)))[:, : blocks * block].reshape(len(level), blocks, block)[..., :-4]
    variance = (second * second).mean(2).ravel() / 6.0
    light = level[:, : blocks * block].reshape(len(level), blocks, block).mean(2).ravel()
    order = np.argsort(light)
    # The median of 12 correlated squares is below their mean.
    table = [
        (median_of(light[part]), median_of(variance[part]) / 0.89) for part in np.array_split(order, 8) if len(part)
    ]
    floor = 2.0 / 12.0 / 4.0
    # Noise of dark samples is cut off at zero.
    darker = (residual < 0) & (level > 2.0)
    residual, level = residual[darker], level[darker]
    if residual.size <= 50:
        return 0.0
    noise = np.maximum(np.interp(level, *np.array(table).T), floor)
    return float(np.sqrt(np.minimum(residual * residual / noise, _NOISE_CUT**2).mean()))


def peak_heights(
    difference: Float[np.ndarray, "lines samples"], rows: Int[np.ndarray, " n"], at: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Highest sample near a ridge of some lines minus the median beside it [DN]."""
    lines, last = rows[:, None], difference.shape[1] - 1
    near = difference[lines, np.clip(at[:, None] + np.arange(-4, 5), 0, last)]
    beside = difference[lines, np.clip(at[:, None] + np.array([-32, -28, -24, -20, 20, 24, 28, 32]), 0, last)]
    return near.max(1) - np.median(beside, 1)


def leak_of(off: Float[np.ndarray, " n"], difference: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Part of the stripe's light that is in the laser-off frame: median over the rows, and its standard deviation."""
    good = difference > 0
    if np.count_nonzero(good) < 3:
        return 0.0, 1.0
    ratio = off[good] / difference[good]
    middle = median_of(ratio)
    scatter = 1.4826 * median_of(np.abs(ratio - middle))
    leak = middle / (1.0 + middle) if middle > 0 else middle
    return leak, 1.2533 * scatter / float(np.sqrt(len(ratio) / _ALIKE))


def saturated_part(pair: FramePair, rows: np.ndarray, at: np.ndarray) -> float:
    """Part of the rows whose stripe is clipped at its peak, at `at` [samples]."""
    if len(rows) == 0:
        return 0.0
    lines = rows[:, None, None] * pair.step + np.arange(min(pair.step, STACK))[None, :, None]
    samples = np.clip(at[:, None, None] + np.arange(-2, 3)[None, None, :], 0, pair.lit.shape[1] - 1)
    return float((pair.lit[lines, samples] >= CLIPPED).any((1, 2)).mean())


def is_covered(frame: Float[np.ndarray, "lines samples"]) -> bool:
    """Whether a frame is dark and has no large features, judged by blocks of 16 by 16 samples."""
    lines, samples = (size // 16 for size in frame.shape)
    blocks = frame[: lines * 16, : samples * 16].reshape(lines, 16, samples, 16).mean((1, 3))
    return bool(frame.mean() < _BLACK_DN and np.ptp(blocks) < _FEATURELESS_DN)
