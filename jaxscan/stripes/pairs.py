"""Whether the two frames of a pair show the same room, one with the laser and one without."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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
from jaxscan.stripes.leak import Leak, OffWindow, frame_leak, leak
from jaxscan.stripes.stripes import Stripes


_MONO = FrameFormat()
_HALF_WINDOW = 12
"""Samples on either side of a stripe in which its trace is looked for."""


class PairQuality(NamedTuple):
    """Laser light in the laser-off frame, and motion, of each pair of frames."""

    leak: Float[np.ndarray, " frames"]
    """Amplitude of the stripe in the laser-off frame over that in the difference [1]."""
    leak_sigma: Float[np.ndarray, " frames"]
    """Standard deviation of `leak` [1]."""
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
        frames: How a frame is to be read.
        line: The laser, of which the colour is known.
    """
    pixel_format, response = frames.pixel_format, frames.response
    noise = estimate_noise(on, off, pixel_format=pixel_format, response=response, line=line)
    sites = laser_sites(pixel_format, line)
    lit, dark = (np.asarray(laser_plane(np.asarray(a), pixel_format=pixel_format, line=line)) for a in (on, off))
    count, lines, samples = dark.shape
    image_lines = sites.first_line + sites.line_step * np.arange(lines)
    offsets = np.asarray(sites.offsets)[np.arange(lines) % len(sites.offsets)]
    u, width, amplitude, valid = (
        np.asarray(field)[:, image_lines] for field in (stripes.u, stripes.width, stripes.amplitude, stripes.valid)
    )
    # In samples of the laser's plane, windows first.
    centre = (u - offsets) / sites.pitch
    middle = np.round(centre).astype(np.int64)
    x = np.arange(-_HALF_WINDOW, _HALF_WINDOW + 1)[:, None, None]
    index = middle[None] + x
    used = (index >= 0) & (index < samples) & valid[None]
    rows = np.arange(count * lines).reshape(count, lines)
    level = decode_table(response)[0][dark.reshape(-1, samples)[rows[None], np.clip(index, 0, samples - 1)]]
    variance = noise.variance(level)

    def flat(values):
        return np.asarray(values, np.float32).reshape(*values.shape[:-2], -1)

    window = OffWindow(flat(level), flat(np.broadcast_to(x, index.shape)), used.reshape(len(x), -1), flat(variance))
    width = np.where(valid, width / sites.pitch, 1.0)
    each = leak(window, flat(centre - middle), flat(width), flat(amplitude))
    of_frame = frame_leak(Leak(*(field.reshape(count, lines) for field in each)), valid)
    unrest = lamp_ratio(*sample_pair(lit, dark), noise.read_dn, noise.electrons_per_dn).unrest
    return PairQuality(of_frame.ratio, of_frame.sigma, np.asarray(unrest))
