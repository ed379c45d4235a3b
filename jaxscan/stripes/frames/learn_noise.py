"""All that the first pairs tell about a frame's noise."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames.doubtful import falling_noise, noise_in_blocks
from jaxscan.stripes.frames.formats import FrameFormat, LaserLine, decode_table, laser_plane
from jaxscan.stripes.frames.noise import UNITS, flicker_of, photon_points
from jaxscan.stripes.frames.transfer import PerBin, free_line, photon_transfer
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


LOST = "lost in the other noise"
"""Why no speckle is learned, as a rule."""


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
        frames: How a frame is to be read.
        line: The laser, of which the colour is known.
        compressed: Whether it is known that the images were compressed with loss.
    """
    chosen = np.unique(np.linspace(0, len(on) - 1, _FRAMES).astype(int))
    room = _bands(on if off is None else off, chosen, frames, line)

    def in_blocks() -> list[str]:
        if off is None or compressed or frames.pixel_format.startswith("bayer"):
            return []
        lit = _bands(on, chosen, frames, line)
        return noise_in_blocks(np.stack([_less(*pair) for pair in zip(lit, room, strict=True)]))

    with ThreadPoolExecutor(1) as pool:
        blocks = pool.submit(in_blocks)
        level, variance, sigma = photon_points(on, off, **vars(frames), line=line)
        doubts = falling_noise(level, variance, sigma, frames.response) + blocks.result()
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
    least = -line.start / line.slope if line.start < -_LEAST_SIGMAS * line.sigma else 0.0
    return max(least, 0.0), (0.5 * line.start, 0.5 * line.slope)


def _darkest(
    table: Float[np.ndarray, "256"], planes: UInt8[np.ndarray, "frames lines samples"], noise: tuple[float, float]
) -> tuple[float | None, float]:
    """The level of a darkest surface, or None; and a bound of the black level [DN].

    Args:
        table: Linear level of each code [DN].
        planes: Laser-off frames.
        noise: Variance of a frame at level 0, and its slope [DN^2, DN].
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
