"""Samples of a pair of frames near a stripe."""

from typing import NamedTuple

import numpy as np

from jaxscan.stripes import FrameFormat, LaserLine, NoiseModel, Sites, decode_table


_CLIPPED_DN = 254


class Sight(NamedTuple):
    """One record as the laser's colour shows it."""

    on: np.ndarray
    """Plane of the laser-on frame [lines, samples]: uint8, or uint16 in the finest steps of more than 8 bits; these
    are the DN of all that is found in it."""
    off: np.ndarray
    """Plane of the laser-off frame."""
    lamp_ratio: float
    """Factor by which the laser-off frame is multiplied before it is subtracted [1]."""
    sites: Sites
    """Where its samples lie in the image."""
    frames: FrameFormat
    line: LaserLine
    noise: NoiseModel
    """The noise, in DN of the planes."""
    steps: int = 1
    """DN of the planes that are one of 8 bits."""

    def decoded(self, codes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear levels of some codes [DN], and how much they grow with the code [1]; more than 8 bits are linear."""
        if self.steps > 1:
            return codes.astype(np.float64), np.ones(codes.shape)
        level, slope = decode_table(self.frames.response)
        return level[codes], slope[codes]


class Windows(NamedTuple):
    """Samples near a stripe, one row for each of its lines; the middle one is nearest to its centre."""

    light: np.ndarray
    """Laser-on minus laser-off [lines, samples], DN."""
    variance: np.ndarray
    """Variance of that, without the stripe's own photons and speckle [lines, samples], DN^2."""
    dark: np.ndarray
    """Laser-off [lines, samples], DN."""
    dark_variance: np.ndarray
    used: np.ndarray
    """bool [lines, samples]: inside the image and not clipped."""
    electrons_per_dn: float
    """Conversion gain [e-/DN]."""
    place: np.ndarray
    """Place of each sample, counted from the middle one [samples], px."""


def cut_windows(sight: Sight, line: np.ndarray, centre: np.ndarray, half: int) -> tuple[Windows, np.ndarray]:
    """The samples round a stripe, and the coordinate of the middle one on each line [n], px.

    Args:
        line: Lines of the image [n].
        centre: About where the stripe is on them [n], px.
        half: Samples on either side of the middle one.
    """
    sites, noise = sight.sites, sight.noise
    row = (line - sites.first_line) // sites.line_step
    offset = np.asarray(sites.offsets)[row % len(sites.offsets)]
    middle = np.rint((centre - offset) / sites.pitch).astype(int)
    index = middle[:, None] + np.arange(-half, half + 1)
    lines, samples = sight.on.shape
    at = np.clip(row, 0, lines - 1)[:, None], np.clip(index, 0, samples - 1)
    on, off = sight.on[at], sight.off[at]
    lit, lit_slope = sight.decoded(on)
    dark, dark_slope = sight.decoded(off)
    # `NoiseModel.variance` holds the rounding of a linear frame.
    dark_variance = noise.variance(dark) + (dark_slope**2 - 1.0) / 12.0
    # Brighter lamps bring more photons, and neither more read noise nor coarser codes.
    room = (
        noise.variance(dark)
        + (sight.lamp_ratio - 1.0) * np.maximum(dark - noise.black_dn, 0.0) / noise.electrons_per_dn
    )
    variance = room + (lit_slope**2 - 1.0) / 12.0
    variance = variance + sight.lamp_ratio**2 * dark_variance
    clipped = _CLIPPED_DN * sight.steps
    used = (index >= 0) & (index < samples) & (on < clipped) & (off < clipped)
    light = lit - sight.lamp_ratio * dark
    place = sites.pitch * np.arange(-half, half + 1, dtype=np.float64)
    windows = Windows(light, np.maximum(variance, 0.05), dark, dark_variance, used, noise.electrons_per_dn, place)
    return windows, offset + sites.pitch * middle
