"""All that the first pairs tell about a frame's noise, and signs that codes are not as a sensor makes them."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, median_sigma
from jaxscan.stripes.frames.formats import FrameFormat, LaserLine, decode_table, laser_plane
from jaxscan.stripes.frames.noise import UNITS, PerBin, flicker_of, free_line, photon_points, photon_transfer
from jaxscan.stripes.stripes import NoiseModel


_FRAMES = 4
_SAMPLES = 1 << 18
"""Samples that are looked at, of all frames together."""
_BAND = 8
"""Neighbouring lines that are looked at together: those of a JPEG's block."""
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
_LEAST_SIGMAS = 5.0
_FALLING = 0.7
"""Variance of bright over that of dark levels, below which codes are no counts of photons."""
_MANY_ZEROS = 1.25
"""Coefficients near zero of blocks that lie as a JPEG's do, over those of blocks half a block aside."""
_NEAR_ZERO = 0.25
"""Limit of such coefficients, in standard deviations: a fifth of those of noise."""
_LEAST = 1e-3
_BELOW = 3.0
"""Standard deviations of the noise by which a black level may exceed the picture."""


LOST = "lost in the other noise"
"""Why no speckle is learned, as a rule."""


class BlackLevelError(ValueError):
    """A black level that no pixel reaches."""


def check_black(noise: NoiseModel, on: Array, *, frames: FrameFormat, line: LaserLine) -> None:
    """Refuse a black level that no pixel reaches.

    Args:
        on: Laser-on frames, of which the first is looked at.

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


class LearnedNoise(NamedTuple):
    """Noise of a frame, and how much of it the frames told."""

    noise: NoiseModel
    unknown: tuple[str, ...]
    """Numbers that the frames do not tell, in words."""
    doubts: tuple[str, ...]
    """Signs that codes are no levels of a sensor, a sentence each."""
    gain_told: bool = True
    """Whether the frames tell gain and read noise apart."""

    def words(self, found: NoiseModel, reason: str = LOST) -> str:
        """One line on the noise, with the speckle that the stripes told, or the reason why they told none."""
        parts = [
            f"read noise {found.read_dn:.2g} DN",
            f"{found.electrons_per_dn:.2g} electrons per DN",
            *([] if any(one.startswith("black") for one in self.unknown) else [f"black level {found.black_dn:.2g} DN"]),
            *([speckle_words(found.speckle)] if found.speckle else []),
        ]
        missing = [*self.unknown, *([] if found.speckle else [speckle_words(0.0, reason)])]
        return ", ".join(parts) + (f"; not learned: {', '.join(missing)}" if missing else "")


def speckle_words(speckle: float, reason: str = LOST) -> str:
    """The speckle of a laser, or the reason why none is known."""
    return f"speckle {100 * speckle:.2g} % of a pixel" if speckle else f"speckle ({reason})"


def learn_noise(
    on: Array, off: Array | None, *, frames: FrameFormat, line: LaserLine, compressed: bool = False
) -> LearnedNoise:
    """Read noise, gain and black level of a frame from pairs.

    The black level is that of a darkest place without shades where it ends the levels: elsewhere nothing tells dark
    from black, but that shot noise which falls faster than the level needs some.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        compressed: Whether it is known that the images were compressed with loss.
    """
    chosen = np.unique(np.linspace(0, len(on) - 1, _FRAMES).astype(int))
    room = _bands(on if off is None else off, chosen, frames, line)

    def in_blocks() -> list[str]:
        if off is None or compressed or frames.pixel_format.startswith("bayer"):
            return []
        lit = _bands(on, chosen, frames, line)
        return _noise_in_blocks(np.stack([_less(*pair) for pair in zip(lit, room, strict=True)]))

    with ThreadPoolExecutor(1) as pool:
        blocks = pool.submit(in_blocks)
        level, variance, sigma = photon_points(on, off, **vars(frames), line=line)
        doubts = _falling_noise(level, variance, sigma, frames.response) + blocks.result()
    least, start = _line_of_noise(level, variance, sigma)
    black, most = _darkest(decode_table(frames.response)[0], room, start)
    least = min(least, most)
    noise, gain_told = photon_transfer(level, variance, sigma, black_dn=least if black is None else black)
    unknown = [] if gain_told else ["gain and read noise apart (one level only: their sum holds)"]
    if black is None:
        read = np.sqrt(noise.read_dn**2 + (most - least) / noise.electrons_per_dn)
        bounds = f"{least:.0f} to {most:.0f} DN" if least > 0 else f"at most {most:.0f} DN"
        unknown.append(f"black level ({bounds}, with read noise up to {read:.2g} DN)")
    return LearnedNoise(noise, tuple(unknown), tuple(doubts), gain_told)


def _bands(
    of: Array, chosen: np.ndarray, frames: FrameFormat, line: LaserLine
) -> UInt8[np.ndarray, "frames lines samples"]:
    """Bands of neighbouring lines of some frames, spread over them."""

    def bands(number: int) -> np.ndarray:
        one = np.asarray(of[number : number + 1])
        (plane,) = np.asarray(laser_plane(one, pixel_format=frames.pixel_format, line=line))
        lines = len(plane) // _BAND * _BAND
        step = max(1, plane.size * len(chosen) // _SAMPLES)
        return plane[:lines].reshape(-1, _BAND, plane.shape[1])[::step].reshape(-1, plane.shape[1])

    return np.stack([bands(int(number)) for number in chosen])


def _less(on: UInt8[np.ndarray, "lines samples"], off: UInt8[np.ndarray, "lines samples"]) -> np.ndarray:
    """A laser-on frame without the light of the room, which may flicker [DN]."""
    lit, room = on.astype(np.int16), off.astype(np.int16)
    flicker = flicker_of(UNITS * lit, UNITS * room) if on.shape[1] > 2 * _BOX else 1.0
    return lit - np.float32(flicker) * room


def _line_of_noise(level: PerBin, variance: PerBin, sigma: PerBin) -> tuple[float, tuple[float, float]]:
    """The least black level that the noise needs [DN]; variance of a frame at level 0, and its slope [DN^2, DN]."""
    line = free_line(level, variance, sigma)
    if line is None:
        noise, _ = photon_transfer(level, variance, sigma)
        return 0.0, (noise.read_dn**2, 1.0 / noise.electrons_per_dn)
    start, slope, doubt = line
    return (-start / slope if start < -_LEAST_SIGMAS * doubt else 0.0), (0.5 * start, 0.5 * slope)


def _darkest(
    table: Float[np.ndarray, "256"], planes: UInt8[np.ndarray, "frames lines samples"], noise: tuple[float, float]
) -> tuple[float | None, float]:
    """The level of a darkest surface, or None; and a bound of the black level [DN].

    `noise` is the variance of a frame at level 0, and its slope [DN^2, DN].
    """
    samples = planes.shape[2] // _BOX * _BOX
    if samples == 0 or planes.shape[1] == 0:
        return None, 255.0
    means = table[planes[:, :, :samples]].reshape(*planes.shape[:2], -1, _BOX).mean(3).ravel()
    low = float(np.quantile(means, _DARK_SHARE))
    spread_at = lambda level: float(np.sqrt((max(noise[0] + noise[1] * level, 0.04) + 1 / 12) / _BOX))
    spread = spread_at(low)
    centre = low + spread
    for _ in range(5):
        near = means[np.abs(means - centre) < 2.5 * spread]
        centre = float(np.median(near)) if len(near) else low
        spread = spread_at(centre)
    near = means[np.abs(means - centre) < 2.5 * spread]
    own = len(near)
    above = np.count_nonzero((means >= centre + 2.5 * spread) & (means < centre + 7.5 * spread))
    # No light has no shade: a dark surface that is lit unevenly varies beyond its noise.
    even = own > 0 and float(np.var(near)) < _EVEN * _CUT_VARIANCE * spread**2
    dark = even and centre < min(_BLACKEST_DN, _BLACKEST_SHARE * float(np.median(means)))
    if dark and own >= _DARK_SHARE * len(means) and above < _GAP * own:
        return max(centre, 0.0), centre
    return None, low + 2.0 * spread


def _falling_noise(level: np.ndarray, variance: np.ndarray, sigma: np.ndarray, response: str) -> list[str]:
    """Noise that falls with the level, as gamma makes it fall; points as of `photon_points`."""
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


def _noise_in_blocks(difference: Float[np.ndarray, "frames lines samples"]) -> list[str]:
    """Noise in blocks of 8 pixels, as JPEG leaves it.

    JPEG rounds the cosine transform of every block, most of it to zero. In any other picture, as many coefficients are
    near zero in blocks that are shifted by half a block. Coefficients that are constant along an axis do not count,
    since bars and stripes are such.
    `difference` is of whole bands of 8 lines that lie as a JPEG's blocks do [DN].

    Source:
        ITU-T T.81 (JPEG), A.3.3 and A.3.4.
    """
    if min(difference.shape[1] // _BAND, difference.shape[2] // _BAND) < 4:
        return []
    own, aside = (np.abs(_coefficients(difference, start)) for start in (0, _BAND // 2))
    # Coarse JPEG leaves no noise at all in most blocks.
    limit = max(_NEAR_ZERO * median_sigma(aside), _LEAST)
    zeros, expected = float(np.mean(own < limit)), float(np.mean(aside < limit))
    error = np.sqrt(2.0 * expected / own.size)
    if zeros < max(_MANY_ZEROS * expected, expected + _LEAST_SIGMAS * error):
        return []
    return [
        f"the noise of the images lies in blocks of {_BAND} px, as JPEG leaves it: sigmas are estimates; record "
        'PNG or raw images, or write compression = "jpeg" into capture.toml'
    ]


def _coefficients(difference: np.ndarray, start: int) -> Float[np.ndarray, " n"]:
    """Cosine transforms of blocks of 8 x 8 pixels, without those that are constant along an axis."""
    frames, lines, samples = difference.shape
    bands, blocks = lines // _BAND, (samples - start) // _BAND
    # A band is of neighbouring lines; the next band is not next to it. So blocks are moved along the samples only.
    part = difference[:, : bands * _BAND, start : start + blocks * _BAND].astype(np.float32)
    place, wave = np.arange(_BAND), np.arange(1, _BAND)
    cosine = (0.5 * np.cos((2 * place + 1) * wave[:, None] * np.pi / 16)).astype(np.float32)
    # Line by line: one large product would wake the threads of BLAS, for longer than it takes.
    along = part.reshape(frames * bands * _BAND, blocks, _BAND) @ cosine.T
    return np.matmul(cosine, along.reshape(frames * bands, _BAND, -1)).ravel()
