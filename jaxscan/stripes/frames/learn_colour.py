"""Which channel of a colour camera holds the laser, from the frames themselves."""

import dataclasses

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames.flicker import applied_ratio, lamp_ratio
from jaxscan.stripes.frames.formats import Colour, LaserLine, PixelFormat, StripeAxis, frame_rank, laser_plane
from jaxscan.stripes.frames.noise import estimate_noise
from jaxscan.stripes.stripes import NoiseModel


_COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_FRAMES = 8
_LINES = 128
"""Lines of a frame that are looked at."""
_LATTICE = 10_000
"""Pixels of a frame from which the lamp ratio of a pair is taken."""
_BOX = 3
"""Samples that are added up to find a stripe."""
_REACH = 16
"""Samples on either side of a stripe's middle that belong to it."""
_SEEN = 6.0
"""Signal-to-noise ratio from which a line shows the laser: once in 10^9 samples of noise."""
_FEWEST_LINES = 4
_CLIPPED = 254
_FEWEST = 0.01
"""Smallest part of the lines that must show the laser."""


def learn_colour(on: Array, off: Array, pixel_format: PixelFormat, *, stripe_axis: StripeAxis = "rows") -> Colour:
    r"""The channel in which the laser's light stands out most.

    In each channel the difference of the pairs, after the ratio of flickering lamps (`lamp_ratio`), is compared
    with its noise (`estimate_noise`). The information in the stripe's samples, mean over the lines,
    $\tfrac12 \sum \log_2 (1 + \mathrm{snr}^2)$, decides: it grows with the signal-to-noise ratio, and where several
    channels are clipped it grows with the width, which is largest in the laser's own. A few frames and lines
    are looked at, spread over all.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape.

    Returns:
        The colour; "red" for a mono camera, where it has no meaning.

    Raises:
        ValueError: If shapes or types do not fit the pixel format, or no channel shows a laser.

    Source:
        C. E. Shannon, Communication in the presence of noise, 1949 (information of a noisy sample).
    """
    rank = 1 + frame_rank(pixel_format)
    if on.ndim != rank or on.dtype != np.uint8 or off.shape != on.shape or off.dtype != np.uint8 or len(on) == 0:
        raise ValueError(
            f"A laser's colour is learned from pairs of {pixel_format} frames, uint8 with {rank} dimensions; "
            f"got {on.dtype} with shape {tuple(on.shape)} and {off.dtype} with shape {tuple(off.shape)}."
        )
    if pixel_format == "mono8":
        return "red"
    chosen = np.unique(np.linspace(0, len(on) - 1, _FRAMES).astype(int))
    on, off = (np.stack([np.asarray(frames[i]) for i in chosen]) for frames in (on, off))
    scores = {}
    for colour in _COLOURS:
        line = LaserLine(colour=colour, stripe_axis=stripe_axis)
        plane = lambda frames, line=line: np.asarray(laser_plane(frames, pixel_format=pixel_format, line=line))
        scores[colour] = _score(plane(on), plane(off))
    best = max(_COLOURS, key=lambda colour: scores[colour])
    if scores[best] <= 0.0:
        raise ValueError(
            f"No channel of the {len(on)} pairs looked at shows a laser: nothing that is brighter in the laser-on "
            "frames stands out of the noise. Give the laser's colour, or check that `on` and `off` are not "
            "the same frames or exchanged."
        )
    return best


def with_colour(line: LaserLine, on: Array, off: Array | None, pixel_format: PixelFormat) -> LaserLine:
    """The laser with a colour: its own, or that which the frames show if it is "auto".

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3); not looked at without need.
        off: Laser-off frames of the same shape, or None.

    Raises:
        ValueError: If the colour has to be learned and cannot be.
    """
    if line.colour != "auto":
        return line
    if pixel_format == "mono8":
        return dataclasses.replace(line, colour="red")
    if off is None:
        raise ValueError(
            "A colour is learned from pairs; without laser-off frames, give its colour (`colour` under [[laser]] in "
            "capture.toml, or --laser-colour of `jaxscan import`)."
        )
    return dataclasses.replace(line, colour=learn_colour(on, off, pixel_format, stripe_axis=line.stripe_axis))


def _score(on: UInt8[np.ndarray, "frames lines samples"], off: UInt8[np.ndarray, "frames lines samples"]) -> float:
    """Information in the stripes, mean over the lines [bit]; 0 where there are none."""
    # An odd stride takes both kinds of a Bayer tile's lines.
    stride = max(1, on.shape[1] // _LINES) | 1
    on, off = on[:, ::stride], off[:, ::stride]
    default = NoiseModel()
    frames, lines, samples = on.shape
    if samples < _BOX:
        return 0.0
    step = max(1, lines * samples // _LATTICE)
    lattice = lambda a: np.ascontiguousarray(a.reshape(frames, -1)[:, ::step])
    pair = lamp_ratio(lattice(on), lattice(off), default.read_dn, default.electrons_per_dn)
    ratio = np.asarray(applied_ratio(pair))[:, None, None]
    room = ratio * off.astype(np.float32)
    steady = np.clip(np.rint(room), 0, 255).astype(np.uint8)
    noise = estimate_noise(on, steady)
    variance = (1 + ratio**2) * (noise.read_dn**2 + 1 / 12) + (1 + ratio) * room / noise.electrons_per_dn
    # Where the room alone saturates nothing can be added.
    added = np.where(off < _CLIPPED, on - room, 0.0) / np.sqrt(variance)
    return _told(added.reshape(-1, samples))


def _told(added: Float[np.ndarray, "lines samples"]) -> float:
    """Information in the stripe's samples, mean over the lines [bit]; signals in units of their noise."""
    total = np.cumsum(np.pad(added, ((0, 0), (1, 0))), 1)
    box = (total[:, _BOX:] - total[:, :-_BOX]) / np.sqrt(_BOX)
    seen = box.max(1) > _SEEN
    if np.count_nonzero(seen) < max(_FEWEST_LINES, _FEWEST * len(added)):
        return 0.0
    middle = box[seen].argmax(1) + _BOX // 2
    near = np.clip(middle[:, None] + np.arange(-_REACH, _REACH + 1), 0, added.shape[1] - 1)
    light = np.maximum(np.take_along_axis(added[seen], near, 1), 0.0)
    return float(0.5 * np.sum(np.log2(1.0 + light**2)) / len(added))
