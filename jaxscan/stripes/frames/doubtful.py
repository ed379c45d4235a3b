"""Signs in the first pairs that codes are not as a sensor makes them, and a black level that cannot be."""

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Array, median_sigma
from jaxscan.stripes.frames.formats import FrameFormat, LaserLine, decode_table, laser_plane
from jaxscan.stripes.stripes import NoiseModel


_FALLING = 0.7
"""Variance of bright over that of dark levels, below which codes are no counts of photons."""
_LEAST_SIGMAS = 5.0
_BLOCK = 8
"""Pixels of a JPEG's block."""
_MANY_ZEROS = 1.25
"""Coefficients near zero of blocks that lie as a JPEG's do, over those of blocks half a block aside."""
_NEAR_ZERO = 0.25
"""Limit of such coefficients, in standard deviations: a fifth of those of noise."""
_LEAST = 1e-3
_BELOW = 3.0
"""Standard deviations of the noise by which a black level may exceed the picture."""


class BlackLevelError(ValueError):
    """A black level that no pixel reaches."""


def check_black(noise: NoiseModel, on: Array, *, frames: FrameFormat, line: LaserLine) -> None:
    """Refuse a black level that no pixel reaches.

    Args:
        noise: Noise of a frame.
        on: Laser-on frames, of which the first is looked at.
        frames: How a frame is to be read.
        line: The laser, of which the colour is known.

    Raises:
        BlackLevelError: If the black level lies above the frames.
    """
    if noise.black_dn <= 0:
        return
    plane = np.asarray(laser_plane(np.asarray(on[:1]), pixel_format=frames.pixel_format, line=line))
    top = float(decode_table(frames.response)[0][int(np.percentile(plane, 99.0))])
    # Without any light half of the pixels are below the black level.
    if noise.black_dn - _BELOW * np.sqrt(noise.read_dn**2 + 1 / 12) >= top:
        raise BlackLevelError(
            f"The black level is {noise.black_dn:g} DN, but 99 % of the pixels are at {top:.3g} DN or below; expected "
            "a level below the picture. Give the level of a covered lens, or 0."
        )


def falling_noise(level: np.ndarray, variance: np.ndarray, sigma: np.ndarray, response: str) -> list[str]:
    """Noise that falls with the level, as gamma makes it fall.

    Args:
        level: Levels that the frames show [DN].
        variance: Twice the variance of a frame there [DN^2].
        sigma: Its standard deviation [DN^2].
        response: The response that the header says.
    """
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


def noise_in_blocks(difference: Float[np.ndarray, "frames lines samples"]) -> list[str]:
    """Noise in blocks of 8 pixels, as JPEG leaves it.

    JPEG rounds the cosine transform of every block, most of it to zero. Of any other picture as many coefficients are
    near zero in blocks half a block aside. Coefficients that are constant along an axis do not count: bars and stripes
    are such.

    Args:
        difference: Laser-on frames minus the light of the room, of whole bands of 8 lines that lie as a JPEG's blocks
            do [DN].

    Source:
        ITU-T T.81 (JPEG), A.3.3 and A.3.4.
    """
    if min(difference.shape[1] // _BLOCK, difference.shape[2] // _BLOCK) < 4:
        return []
    own, aside = (np.abs(_coefficients(difference, start)) for start in (0, _BLOCK // 2))
    # Coarse JPEG leaves no noise at all in most blocks.
    limit = max(_NEAR_ZERO * median_sigma(aside), _LEAST)
    zeros, expected = float(np.mean(own < limit)), float(np.mean(aside < limit))
    error = np.sqrt(2.0 * expected / own.size)
    if zeros < max(_MANY_ZEROS * expected, expected + _LEAST_SIGMAS * error):
        return []
    return [
        f"the noise of the images lies in blocks of {_BLOCK} px, as JPEG leaves it: sigmas are estimates; record "
        'PNG or raw images, or write compression = "jpeg" into capture.toml'
    ]


def _coefficients(difference: np.ndarray, start: int) -> Float[np.ndarray, " n"]:
    """Cosine transforms of blocks of 8 x 8 pixels, without those that are constant along an axis."""
    frames, lines, samples = difference.shape
    bands, blocks = lines // _BLOCK, (samples - start) // _BLOCK
    # A band is of neighbouring lines; the next band is not next to it. So blocks are moved along the samples only.
    part = difference[:, : bands * _BLOCK, start : start + blocks * _BLOCK].astype(np.float32)
    place, wave = np.arange(_BLOCK), np.arange(1, _BLOCK)
    cosine = (0.5 * np.cos((2 * place + 1) * wave[:, None] * np.pi / 16)).astype(np.float32)
    # Line by line: one large product would wake the threads of BLAS, for longer than it takes.
    along = part.reshape(frames * bands * _BLOCK, blocks, _BLOCK) @ cosine.T
    return np.matmul(cosine, along.reshape(frames * bands, _BLOCK, -1)).ravel()
