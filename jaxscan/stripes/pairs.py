"""Whether the two frames of a pair show the same room, one with the laser and one without.

A laser that glows on, or a shutter that is late, leaves a part of the stripe in the laser-off frame.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import Array
from jaxscan.stripes.engine import sample_pair
from jaxscan.stripes.frames import (
    FrameFormat,
    LaserLine,
    decode_table,
    estimate_noise,
    lamp_ratio,
    laser_plane,
    laser_sites,
)
from jaxscan.stripes.stripes import Stripes


NO_INFORMATION = 1e3
"""Standard deviation of a ratio about which the frames say nothing [1]."""
_MONO = FrameFormat()
_HALF_WINDOW = 12
"""Samples on either side of a stripe in which its trace is looked for."""
_LEAST = 1e-3
"""Part of a column's information that the others must leave to it, or it is not determined [1]."""
_CUT, _STEPS = 3.0, 4
"""Residual from which a line counts less in its frame, in the frame's standard deviations; steps of this mean."""


class PairQuality(NamedTuple):
    """Laser light in the laser-off frame, and motion, of each pair of frames."""

    leak: Float[np.ndarray, " frames"]
    """Amplitude of the stripe in the laser-off frame over that in the difference [1]."""
    leak_sigma: Float[np.ndarray, " frames"]
    """Standard deviation of `leak` [1]; `NO_INFORMATION` where it is not known."""
    unrest: Float[np.ndarray, " frames"]
    """Difference between the frames beside the laser, over the root mean square of the noise [1]."""


def judge_pairs(
    on: Array, off: Array, stripes: Stripes, *, frames: FrameFormat = _MONO, line: LaserLine
) -> PairQuality:
    """Look at some pairs of frames for laser light in the laser-off frame and for motion between the two.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape.
        stripes: Their stripes, one profile of each.
    """
    pixel_format, response = frames.pixel_format, frames.response
    noise = estimate_noise(on, off, pixel_format=pixel_format, response=response, line=line)
    sites = laser_sites(pixel_format, line)
    lit, dark = (np.asarray(laser_plane(np.asarray(a), pixel_format=pixel_format, line=line)) for a in (on, off))
    lines, samples = dark.shape[1:]
    image_lines = sites.first_line + sites.line_step * np.arange(lines)
    offsets = np.asarray(sites.offsets)[np.arange(lines) % len(sites.offsets)]
    u, width, amplitude, valid = (
        np.asarray(field)[:, image_lines] for field in (stripes.u, stripes.width, stripes.amplitude, stripes.valid)
    )
    # In samples of the laser's plane.
    centre = (u - offsets) / sites.pitch
    middle = np.round(centre).astype(np.int64)
    x = np.arange(-_HALF_WINDOW, _HALF_WINDOW + 1)
    index = middle[..., None] + x
    used = (index >= 0) & (index < samples) & valid[..., None]
    level = decode_table(response)[0][np.take_along_axis(dark, np.clip(index, 0, samples - 1), 2)]
    weight = np.where(used, 1.0 / noise.variance(level), 0.0)
    each = leak(level, weight, centre - middle, np.where(valid, width / sites.pitch, 1.0), amplitude)
    unrest = lamp_ratio(*sample_pair(lit, dark), noise.read_dn, noise.electrons_per_dn).unrest
    return PairQuality(*frame_leak(*each, valid), np.asarray(unrest))


def leak(
    level: Float[np.ndarray, "*lines samples"],
    weight: Float[np.ndarray, "*lines samples"],
    u: Float[np.ndarray, "*lines"],
    width: Float[np.ndarray, "*lines"],
    amplitude: Float[np.ndarray, "*lines"],
) -> tuple[Float[np.ndarray, "*lines"], Float[np.ndarray, "*lines"]]:
    r"""Amplitude of the stripe in the laser-off frame over the stripe's, line by line, and its standard deviation [1].

    Least squares of $\mathrm{dark}(x) = b_0 + b_1 x + r A h(x)$ with $h$ the Gaussian that was fitted to the
    difference. The light that leaks is missing in the difference: of the laser's light $r / (1 + r)$ is in the
    laser-off frame.

    Args:
        level: Laser-off frame in the window of the fit [DN].
        weight: Information of each sample [1/DN^2]; 0 where it does not count.
        u: Fitted centre, from the middle sample [samples].
        width: Fitted standard deviation [samples].
        amplitude: Fitted amplitude [DN].
    """
    u, width, amplitude = (np.asarray(field, np.float64)[..., None] for field in (u, width, amplitude))
    x = np.broadcast_to(np.arange(level.shape[-1]) - 0.5 * (level.shape[-1] - 1), level.shape)
    # A pixel's aperture widens the stripe that is seen.
    seen = np.sqrt(width**2 + 1 / 12)
    stripe = amplitude * width / seen * np.exp(-0.5 * ((x - u) / seen) ** 2)
    columns = np.stack([np.ones(level.shape), x, stripe], -1)
    weighted = np.swapaxes(columns * weight[..., None], -1, -2)
    normal = weighted @ columns
    size = np.diagonal(normal, axis1=-2, axis2=-1)
    known = np.all(size > 0, -1)
    scaled = np.where(known[..., None, None], normal, np.eye(3))
    scale = 1.0 / np.sqrt(np.where(known[..., None], size, 1.0))
    scaled = scaled * scale[..., :, None] * scale[..., None, :] + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(scaled)
    known &= np.all(np.diagonal(inverse, axis1=-2, axis2=-1) < 1.0 / _LEAST, -1)
    pull = scale * (weighted @ (level - level.mean(-1, keepdims=True))[..., None])[..., 0]
    ratio = scale[..., 2] * np.sum(inverse[..., 2, :] * pull, -1)
    sigma = scale[..., 2] * np.sqrt(inverse[..., 2, 2])
    return np.where(known, ratio, 0.0), np.where(known, sigma, NO_INFORMATION)


def frame_leak(
    ratio: Float[np.ndarray, "*frames n"], sigma: Float[np.ndarray, "*frames n"], valid: Bool[np.ndarray, "*frames n"]
) -> tuple[Float[np.ndarray, "*frames"], Float[np.ndarray, "*frames"]]:
    """The mean of a leak over the lines of a frame, some of which texture may have spoilt; and its standard deviation.

    Lines are weighted by their information; those that lie further from the mean than 3 standard
    deviations, as the frame itself shows them, count less the further they lie. The standard deviation is by the
    scatter of the lines where that is larger than their noise.
    """
    information = np.where(valid & (sigma < NO_INFORMATION), 1.0 / sigma**2, 0.0)
    known = np.sum(information, -1) > 0
    count = np.maximum(np.count_nonzero(information, -1), 1)
    weight, scale = information, np.ones(known.shape)
    for step in range(_STEPS + 1):
        total = np.where(known, np.sum(weight, -1), 1.0)
        mean = np.sum(weight * ratio, -1) / total
        if step < _STEPS:
            residual = np.abs(ratio - mean[..., None]) * np.sqrt(information)
            # The scatter without the lines that the last step found far away.
            near = np.minimum(residual, _CUT * scale[..., None])
            scale = np.maximum(np.sqrt(np.sum(near**2, -1) / count), 1.0)
            weight = information / np.maximum(residual / (_CUT * scale[..., None]), 1.0) ** 2
    return np.where(known, mean, 0.0), np.where(known, scale / np.sqrt(total), NO_INFORMATION)
