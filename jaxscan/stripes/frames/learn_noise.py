"""All that the first pairs tell about a frame's noise, and about codes that are not as a sensor makes them."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames.formats import FrameFormat, LaserLine, decode_table, laser_plane
from jaxscan.stripes.frames.noise import photon_points, photon_transfer
from jaxscan.stripes.stripes import NoiseModel


_FRAMES = 4
_BOX = 5
"""Samples of a line whose mean is a level."""
_DARK_SHARE = 0.002
"""Share of the levels that the darkest surface has at least."""
_GAP = 0.5
"""Levels just above the darkest surface's, over its own: fewer, if it ends there."""
_BLACKEST_DN, _BLACKEST_SHARE = 32.0, 1 / 3
"""A darkest surface above this, or above this share of the usual level, is lit."""
_EVEN, _CUT_VARIANCE = 1.12, 0.911
"""Variance of the darkest levels over that of noise, below which they are without shades; and the variance of a normal
distribution that is cut off at 2.5 standard deviations."""
_FALLING = 0.7
"""Variance of bright over that of dark levels, below which codes are no counts of photons."""
_BLOCK = 8
"""Pixels of a JPEG's block."""
_BLOCKY = 1.15
"""Squared differences across the borders of blocks, over those within them."""
_LEAST_SIGMAS = 5.0


class LearnedNoise(NamedTuple):
    """Noise of a frame, and how much of it the frames told."""

    noise: NoiseModel
    unknown: tuple[str, ...]
    """Numbers that the frames do not tell, in words."""
    doubts: tuple[str, ...]
    """Signs that codes are no levels of a sensor, a sentence each."""

    def words(self, found: NoiseModel) -> str:
        """One line on the noise, with the speckle that the stripes told."""
        parts = [
            f"read noise {found.read_dn:.2g} DN",
            f"{found.electrons_per_dn:.2g} electrons per DN",
            *([] if any(one.startswith("black") for one in self.unknown) else [f"black level {found.black_dn:.2g} DN"]),
            *([f"speckle {100 * found.speckle:.2g} % of a pixel"] if found.speckle else []),
        ]
        missing = [*self.unknown, *([] if found.speckle else ["speckle (lost in the other noise)"])]
        return ", ".join(parts) + (f"; not learned: {', '.join(missing)}" if missing else "")


def learn_noise(on: Array, off: Array | None, *, frames: FrameFormat, line: LaserLine) -> LearnedNoise:
    """Read noise, gain and black level of a frame from pairs.

    The black level is that of a darkest place without shades where it ends the levels: elsewhere nothing tells dark
    from black.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        frames: How a frame is to be read.
        line: The laser, of which the colour is known.
    """
    level, variance, sigma = photon_points(on, off, **vars(frames), line=line)
    noise, gain_told = photon_transfer(level, variance, sigma)
    room = on if off is None else off
    chosen = np.unique(np.linspace(0, len(room) - 1, _FRAMES).astype(int))
    planes = [
        np.asarray(laser_plane(np.asarray(a[chosen]), pixel_format=frames.pixel_format, line=line)) for a in (on, room)
    ]
    unknown = [] if gain_told else ["gain and read noise apart (one level only: their sum holds)"]
    black, most = _darkest(decode_table(frames.response)[0], planes[1], noise)
    if black is None:
        read = np.sqrt(noise.read_dn**2 + most / noise.electrons_per_dn)
        unknown.append(f"black level (at most {most:.0f} DN, with read noise {read:.2g} DN)")
    else:
        # What black adds to a level is no light: it has no shot noise.
        read = np.sqrt(noise.read_dn**2 + black / noise.electrons_per_dn)
        noise = dataclasses.replace(noise, read_dn=float(read), black_dn=black)
    doubts = _falling(level, variance, sigma, frames.response)
    if off is not None and not frames.pixel_format.startswith("bayer"):
        doubts += _blocks(planes[0].astype(np.int16) - planes[1])
    return LearnedNoise(noise, tuple(unknown), tuple(doubts))


def check_black(noise: NoiseModel, on: Array) -> None:
    """Refuse a black level that no pixel reaches.

    Raises:
        ValueError: With what to do.
    """
    if noise.black_dn <= 0:
        return
    top = float(np.percentile(np.asarray(on[:1]), 99.0))
    if noise.black_dn >= top:
        raise ValueError(
            f"The black level is {noise.black_dn:g} DN, but 99 % of the pixels are at {top:g} DN or below; expected a "
            "level below the picture. Give the level of a covered lens, or 0."
        )


def _darkest(
    table: Float[np.ndarray, "256"], planes: UInt8[np.ndarray, "frames lines samples"], noise: NoiseModel
) -> tuple[float | None, float]:
    """The level of a darkest surface, or None; and a bound of the black level [DN]."""
    samples = planes.shape[2] // _BOX * _BOX
    if samples == 0:
        return None, 255.0
    means = table[planes[:, :, :samples]].reshape(*planes.shape[:2], -1, _BOX).mean(3).ravel()
    low = float(np.quantile(means, _DARK_SHARE))
    spread = float(np.sqrt(noise.variance(low) / _BOX))
    centre = low + spread
    for _ in range(5):
        near = means[np.abs(means - centre) < 2.5 * spread]
        centre = float(np.median(near)) if len(near) else low
    near = means[np.abs(means - centre) < 2.5 * spread]
    own = len(near)
    above = np.count_nonzero((means >= centre + 2.5 * spread) & (means < centre + 7.5 * spread))
    # No light has no shade: a dark surface that is lit unevenly varies beyond its noise.
    even = own > 0 and float(np.var(near)) < _EVEN * _CUT_VARIANCE * spread**2
    dark = even and centre < min(_BLACKEST_DN, _BLACKEST_SHARE * float(np.median(means)))
    if dark and own >= _DARK_SHARE * len(means) and above < _GAP * own:
        return max(centre, 0.0), centre
    return None, low + 2.0 * spread


def _falling(level: np.ndarray, variance: np.ndarray, sigma: np.ndarray, response: str) -> list[str]:
    """Noise that falls with the level, as gamma makes it fall."""
    if len(level) < 2 or response != "linear":
        return []
    dark, bright = int(np.argmin(level)), int(np.argmax(level))
    fall, doubt = variance[dark] - variance[bright], np.hypot(sigma[dark], sigma[bright])
    if fall <= _LEAST_SIGMAS * doubt or variance[bright] >= _FALLING * variance[dark]:
        return []
    return [
        f"the noise falls from {np.sqrt(0.5 * variance[dark]):.2g} DN at level {level[dark]:.0f} to "
        f"{np.sqrt(0.5 * max(variance[bright], 0.0)):.2g} DN at {level[bright]:.0f}: expected of images with gamma, "
        'and the header says response "linear"; record raw images, or write the response ("srgb") into capture.toml'
    ]


def _blocks(difference: np.ndarray) -> list[str]:
    """Noise in blocks of 8 pixels, as JPEG leaves it."""
    steps = np.diff(difference.astype(np.float32), axis=2)
    # The laser's stripe and edges of what moved are no noise.
    small = np.minimum(steps**2, np.quantile(np.abs(steps[:, ::7]), 0.9) ** 2)
    phase = np.arange(small.shape[2]) % _BLOCK
    if small.shape[2] < 4 * _BLOCK:
        return []
    mean = np.array([small[:, :, phase == k].mean() for k in range(_BLOCK)])
    inner = float(np.median(mean[:-1]))
    error = np.sqrt(2.0 / (small.size / _BLOCK))
    if inner <= 0 or mean[-1] / inner < max(_BLOCKY, 1 + _LEAST_SIGMAS * error):
        return []
    return [
        f"the noise of the images lies in blocks of {_BLOCK} px, as JPEG leaves it: sigmas are estimates; record "
        'PNG or raw images, or write compression = "jpeg" into capture.toml'
    ]
