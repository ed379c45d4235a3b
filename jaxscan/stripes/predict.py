r"""The laser-off frame that a laser-on frame speaks of.

Along the line: the running median, which a stripe does not raise.

Colour: a surface's hue changes less along a line than its brightness does. With M the mixture of the other channels
that is most like the laser's channel L away from all stripes, the prediction is $M \cdot \mathrm{median}(L / M)$, with
the running median along the line. Where the laser's channel is clipped, the others see the laser too: there M is its
own running median.

Where all channels see the laser, the others would take some of it away: then each is predicted by itself, along the
line.

If there are several predictions, each place takes the one that its surroundings confirm. The remaining median of the
difference is added, so that the prediction is right on average around every stripe.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int16, Shaped, UInt8

from jaxscan.geometry import Array
from jaxscan.stripes.frames import Colour, LaserLine, PixelFormat, laser_plane, laser_sites


_PLACES = 8
"""A median is taken over three times this many samples and one more."""
_WIDE, _FAR = 3, 3
"""Distance of the samples of medians [samples] where stripes are clipped, and of hue: 36 px on either side."""
_AROUND, _BLOCK = 4, 4
"""Lines on either side, and as many blocks of samples, whose residuals choose among predictions; samples of a block."""
_PER_OCTAVE = 128
"""Steps of a ratio by which it doubles: 0.3 % of rounding."""
_SOFT_DN = 4.0
"""Added to both levels of a ratio, which noise would rule in the dark [DN]."""
_MOST_DN = 24.0
"""Residual from which more is not worse: that of a stripe [DN]."""
_CLIPPED = 254
_STRIPE_DN = 60.0
_BRIGHT = 224
"""Level from which a sample may be a clipped one that compression or demosaicing has mixed with its neighbours, and by
how much it is then above the line around it [DN]."""
_LINES = 32
"""Lines of which medians are taken together: they stay in a core's cache."""
_END = 32_000
"""Above all values of which medians are taken."""
_MIXED = 1
"""Samples beyond clipped ones in which the other channels show too much of the laser."""
_LATTICE = 5_000
"""Pixels of a frame from which the mixture is learned."""
_STEPS = 12

Planes = Float[np.ndarray, "frames lines samples"]
Places = Bool[np.ndarray, "frames lines samples"]
_COLOURS: tuple[Colour, ...] = ("red", "green", "blue")


class Channels(NamedTuple):
    """Planes of a chunk of frames on the pixels of the laser's channel."""

    laser: UInt8[np.ndarray, "frames lines samples"]
    """Level of the laser's channel [DN]."""
    others: tuple[Float[np.ndarray, "frames lines samples"], ...]
    """Levels of the other two [DN], interpolated where a mosaic has others there; none of a mono camera."""


def predict_off(
    on: Array, pixel_format: PixelFormat, line: LaserLine, *, elsewhere: Channels | None = None, alone: bool = False
) -> UInt8[np.ndarray, "frames ..."]:
    """Laser-off frames for laser-on frames that have none; each from its own frame alone.

    Args:
        on: Laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
        elsewhere: Levels that other frames predict for the only frame, taken where they are good.
        alone: Whether every channel is predicted without the others, which see the laser too.

    Returns:
        Frames of the same shape: the laser's channel predicted; the others, unless `alone`, as they are, and along the
        line where the laser's is clipped, as they see the laser there.
    """
    on = np.asarray(on)
    off = on.copy()
    for k in range(len(on)):
        part = slice(k, k + 1)
        if alone and pixel_format != "mono8":
            for number, one in enumerate(_colours_of(line)):
                seen = Channels(np.ascontiguousarray(laser_plane(on[part], pixel_format=pixel_format, line=one)), ())
                pitch, moved = laser_sites(pixel_format, one).pitch, None
                # The other channels of a mosaic have pixels of their own.
                if elsewhere is not None and (number == 0 or pixel_format == "rgb8"):
                    moved = Channels((elsewhere.laser, *elsewhere.others)[number], ())
                room = _room(seen, moved, _clipped(seen.laser, pitch), _PLACES // pitch)
                put_plane(off[part], _codes(room), pixel_format=pixel_format, line=one)
            continue
        seen, pitch = read_channels(on[part], pixel_format, line), laser_sites(pixel_format, line).pitch
        clipped, places = _clipped(seen.laser, pitch), _PLACES // pitch
        room = _room(seen, elsewhere, clipped, places)
        put_plane(off[part], _codes(room), pixel_format=pixel_format, line=line)
        near = _near(seen.laser >= _CLIPPED, 3 * places // 2)
        if pixel_format != "rgb8" or not near.any():
            continue
        for other, plane in zip(_colours_of(line)[1:], seen.others, strict=True):
            cleared = _codes(_put(plane, near, _along(plane, places, near)))
            put_plane(off[part], cleared, pixel_format="rgb8", line=other)
    return off


def _colours_of(line: LaserLine) -> list[LaserLine]:
    """The line as each channel sees it, the laser's own first."""
    return [line, *(dataclasses.replace(line, colour=one) for one in _COLOURS if one != line.colour)]


def _codes(room: Planes) -> UInt8[np.ndarray, "frames lines samples"]:
    return np.clip(np.rint(room), 0, 255).astype(np.uint8)


def _clipped(level: UInt8[np.ndarray, "frames lines samples"], pitch: int) -> Places:
    """Samples that are clipped, or are so bright in a stripe that a clipped one may have been mixed into them."""
    bright = level >= _BRIGHT
    if bright.any():
        above = level[bright] - _along(level, _PLACES // pitch, bright)
        bright[bright] = (level[bright] >= _CLIPPED) | (above > _STRIPE_DN)
    return bright


def _room(seen: Channels, elsewhere: Channels | None, clipped: Places, places: int) -> Planes:
    level = seen.laser.astype(np.float32)
    far = _near(clipped, 4 * places)
    rooms = [np.zeros_like(level)]
    if seen.others:
        rooms.append(_from_others(level, seen.others, _near(clipped, _MIXED), places))
    if elsewhere is not None:
        moved = elsewhere.laser.astype(np.float32)
        if seen.others:
            changes = (now - then for now, then in zip(seen.others, elsewhere.others, strict=True))
            # Where the light has changed all channels have; where they are clipped they see the laser.
            moved = moved + np.where(far, 0.0, sum(changes, np.zeros_like(level)) / len(seen.others))
        rooms.append(moved)
    return level - _least([_without_rest(level - room, far, places) for room in rooms], places)


def _without_rest(residual: Planes, far: Places, places: int) -> Planes:
    """A prediction's residual less its median nearby, or further away where a wide stripe is clipped."""
    rest = _along(residual, places)
    return residual - (_put(rest, far, _along(residual, places, far)) if far.any() else rest)


def _put(plane: Planes, where: Places, values: Float[np.ndarray, " n"]) -> Planes:
    plane = plane.copy()
    plane[where] = values
    return plane


def _least(residuals: Sequence[Planes], places: int) -> Planes:
    """The residuals of the prediction that leaves the smallest ones around each place; the laser only adds light."""
    best, least = residuals[0], None
    for residual in residuals if len(residuals) > 1 else ():
        size = np.abs(residual)
        np.minimum(size, np.float32(_MOST_DN), out=size)
        samples = size.shape[2]
        size = np.pad(size, ((0, 0), (0, 0), (0, -samples % _BLOCK)), mode="edge")
        blocks = np.add.reduce([size[:, :, k::_BLOCK] for k in range(_BLOCK)])
        size = box_mean(blocks, 4 * places // _BLOCK, _AROUND)
        if least is None:
            least = size
        else:
            better = np.repeat(size < least, _BLOCK, 2)[:, :, :samples]
            best, least = np.where(better, residual, best), np.minimum(size, least)
    return best


def _from_others(level: Planes, others: tuple[Planes, ...], clipped: Places, places: int) -> Planes:
    mixed = np.stack([_mixture(*planes) for planes in zip(level, *others, strict=True)])
    if clipped.any():
        mixed = _put(mixed, clipped, np.minimum(mixed[clipped], _along(mixed, places, clipped)))
    ratio = np.log2((level + np.float32(_SOFT_DN)) / (mixed + np.float32(_SOFT_DN)))
    hue = np.exp2(running_median(_PER_OCTAVE * ratio, places, _FAR) / np.float32(_PER_OCTAVE))
    return np.maximum(hue * (mixed + np.float32(_SOFT_DN)) - np.float32(_SOFT_DN), 0.0)


def _mixture(level: np.ndarray, *others: np.ndarray) -> Float[np.ndarray, "lines samples"]:
    """The mixture of the other channels that is most like the laser's, by least absolute residuals."""
    every = max(1, level.size // _LATTICE)
    lattice = np.stack([plane.reshape(-1)[::every] for plane in (*others, np.ones_like(level), level)], 1)
    usable = lattice[:, [*range(len(others)), -1]].max(1) < _CLIPPED
    x, y = lattice[usable, :-1].astype(np.float64), lattice[usable, -1].astype(np.float64)
    share = np.array([1.0 / len(others)] * len(others) + [0.0])
    for _ in range(_STEPS):
        weight = 1.0 / np.maximum(np.abs(y - x @ share), 1.0)
        # If all surfaces have one hue, many mixtures fit; the smallest one is taken.
        share = np.linalg.lstsq((weight[:, None] * x).T @ x, (weight * y) @ x, rcond=1e-9)[0]
    mixed = sum((s * plane for s, plane in zip(share, others, strict=False)), np.full_like(level, share[-1]))
    return np.maximum(np.asarray(mixed, np.float32), 0.0)


def _near(marked: Places, half: int) -> Places:
    """Samples within reach of a marked one on their line."""
    before = np.cumsum(np.pad(marked, ((0, 0), (0, 0), (half + 1, half))), 2, dtype=np.int32)
    return before[:, :, 2 * half + 1 :] - before[:, :, : -2 * half - 1] > 0


def box_mean(values: Planes, samples: int, lines: int) -> Planes:
    """Mean over the given numbers of samples and lines on either side; over fewer at the borders."""
    for axis, reach in ((2, samples), (1, lines)):
        size = values.shape[axis]
        total = np.zeros([size + 1 if k == axis else length for k, length in enumerate(values.shape)], np.float32)
        np.cumsum(values, axis, out=total[:, 1:] if axis == 1 else total[:, :, 1:])
        first, last = np.maximum(np.arange(size) - reach, 0), np.minimum(np.arange(size) + reach + 1, size)
        number = (last - first).astype(np.float32)
        if axis == 1:
            values = (total[:, last] - total[:, first]) / number[:, None]
        else:
            values = (total[:, :, last] - total[:, :, first]) / number
    return values


def _along(
    level: Shaped[np.ndarray, "frames lines samples"], places: int, where: Places | None = None
) -> Float[np.ndarray, "..."]:
    """The running median of levels, to half a DN: the narrow one everywhere, or the wide one at some places."""
    doubled = 2.0 * level.astype(np.float32)
    return np.float32(0.5) * (running_median(doubled, places) if where is None else median_at(doubled, places, where))


def running_median(values: Planes, places: int, spacing: int = 1) -> Float[np.ndarray, "frames lines samples"]:
    """Median along each line of 3 `places` + 1 samples around; beyond a line's ends are as many below as above all.

    Args:
        values: Between -16,000 and 16,000; rounded to whole numbers.
        places: A power of 2.
        spacing: Distance of the samples that are looked at.
    """
    frames, lines, samples = values.shape
    out = np.empty(values.shape, np.float32)
    wide = _between_ends(values, places, spacing).reshape(frames * lines, -1)
    for start in range(0, len(wide), _LINES):
        run, length = [wide[start : start + _LINES]], 1
        while length < places:
            reach = length * spacing
            run = _merged([one[:, :-reach] for one in run], [one[:, reach:] for one in run])
            length *= 2
        at = lambda k, run=run: [one[:, k * spacing : k * spacing + samples] for one in run]
        last = wide[start : start + _LINES, 3 * places * spacing :]
        out.reshape(frames * lines, -1)[start : start + _LINES] = _middle([at(k * places) for k in range(3)], last)
    return out


def median_at(values: Planes, places: int, where: Places, spacing: int = _WIDE) -> Float[np.ndarray, " n"]:
    """The values of `running_median` at some samples."""
    wide = _between_ends(values, places, spacing)
    first = np.flatnonzero(where)
    first += first // values.shape[2] * (wide.shape[2] - values.shape[2])
    taken = [wide.reshape(-1)[first + k * spacing] for k in range(3 * places + 1)]
    runs = [_ordered(taken[k * places : (k + 1) * places]) for k in range(3)]
    return _middle(runs, taken[-1]).astype(np.float32)


def _between_ends(values: Planes, places: int, spacing: int) -> Int16[np.ndarray, "frames lines wide"]:
    half = (3 * places) // 2 * spacing
    ends = np.where(np.arange(half) // spacing % 2 == 0, -_END, _END).astype(np.int16)
    wide = np.empty((*values.shape[:2], values.shape[2] + 2 * half), np.int16)
    wide[:, :, :half], wide[:, :, -half:] = ends[::-1], ends
    wide[:, :, half:-half] = np.rint(values)
    return wide


Run = list[np.ndarray]
"""Arrays of one shape; each is nowhere below the one before."""


def _ordered(values: Run) -> Run:
    half = len(values) // 2
    return values if half == 0 else _merged(_ordered(values[:half]), _ordered(values[half:]))


def _merged(a: Run, b: Run) -> Run:
    """Two runs of equal length as one (K. E. Batcher, Sorting networks and their applications, AFIPS 1968)."""
    if len(a) == 1:
        return [np.minimum(a[0], b[0]), np.maximum(a[0], b[0])]
    even, odd = _merged(a[::2], b[::2]), _merged(a[1::2], b[1::2])
    pairs = [(np.minimum(e, o), np.maximum(e, o)) for e, o in zip(even[1:], odd, strict=False)]
    return [even[0], *(one for pair in pairs for one in pair), odd[-1]]


def _middle(runs: Sequence[Run], last: np.ndarray) -> np.ndarray:
    """Median of three runs and one more."""
    long, short = _merged(runs[0], runs[1]), []
    for one in runs[2]:
        short.append(np.minimum(one, last))
        last = np.maximum(one, last)
    short.append(last)
    # The k-th of both is the least of the larger ones of i and k - i of them.
    k = 3 * len(runs[0]) // 2
    found = long[k]
    for i, one in enumerate(short[: k + 1]):
        found = np.minimum(found, np.maximum(one, long[k - i - 1]) if i < k else one)
    return found


def warped(
    planes: Float[np.ndarray, "planes lines samples"], where: Float[np.ndarray, "a b 2"], pitch: int
) -> Float[np.ndarray, "planes lines samples"]:
    """Planes read at other places, bilinear; NaN beyond them.

    Args:
        planes: float32.
        where: Line and sample that are read, at every `pitch`-th line and sample; bilinear in between.
        pitch: Distance of the given places.
    """
    lines, samples = planes.shape[1:]
    i, j = (np.arange(size) // pitch for size in (lines, samples))
    down, right = ((np.arange(size) % pitch).astype(np.float32) / np.float32(pitch) for size in (lines, samples))
    along = where[i] + down[:, None, None] * (where[i + 1] - where[i])
    places = along[:, j] + right[None, :, None] * (along[:, j + 1] - along[:, j])
    at = np.moveaxis(places, -1, 0)
    # Imported here, because few sweeps need it.
    import scipy.ndimage  # type: ignore[import-untyped]

    read = lambda plane: scipy.ndimage.map_coordinates(plane, at, np.float32, order=1, cval=np.nan)
    return np.stack([read(plane) for plane in planes])


def read_channels(on: UInt8[np.ndarray, "frames ..."], pixel_format: PixelFormat, line: LaserLine) -> Channels:
    """All channels of frames uint8 [frames, rows, columns] (rgb8: and 3) where the laser's is measured."""
    laser = np.ascontiguousarray(laser_plane(on, pixel_format=pixel_format, line=line))
    names = [colour for colour in _COLOURS if colour != line.colour]
    if pixel_format == "mono8":
        return Channels(laser, ())
    if pixel_format == "rgb8":
        planes = [on[..., _COLOURS.index(name)] for name in names]
        if line.stripe_axis == "columns":
            planes = [plane.swapaxes(1, 2) for plane in planes]
        return Channels(laser, tuple(plane.astype(np.float32) for plane in planes))
    full = [_interpolated(on, pixel_format, name) for name in names]
    others = (laser_plane(plane, pixel_format=pixel_format, line=line) for plane in full)
    return Channels(laser, tuple(np.ascontiguousarray(other) for other in others))


def put_plane(
    frames: UInt8[np.ndarray, "frames ..."],
    plane: UInt8[np.ndarray, "frames lines samples"],
    *,
    pixel_format: PixelFormat,
    line: LaserLine,
) -> None:
    """Write the samples of the laser's channel into frames; the inverse of `laser_plane`."""
    if pixel_format == "rgb8":
        frames = frames[..., _COLOURS.index(str(line.colour))]
    if line.stripe_axis == "columns":
        frames = frames.swapaxes(1, 2)
    sites = laser_sites(pixel_format, line)
    kinds, (_, lines, samples) = len(sites.offsets), plane.shape
    for k, offset in enumerate(sites.offsets):
        rows = slice(sites.first_line + sites.line_step * k, sites.first_line + sites.line_step * lines, None)
        target = frames[:, rows][:, :: sites.line_step * kinds, offset :: sites.pitch]
        target[:, :, :samples] = plane[:, k::kinds]


def _interpolated(on: np.ndarray, pixel_format: PixelFormat, colour: str) -> Float[np.ndarray, "frames rows columns"]:
    """One colour of a mosaic at every pixel, bilinear."""
    tile = pixel_format[6:10]
    here = np.zeros(on.shape[1:], np.float32)
    for k, letter in enumerate(tile):
        here[k // 2 :: 2, k % 2 :: 2] = letter == colour[0]
    return _spread(on * here) / _spread(here[None])


def _spread(values: Float[np.ndarray, "frames rows columns"]) -> Float[np.ndarray, "frames rows columns"]:
    for axis in (1, 2):
        padded = np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(3)])
        before, here, after = (np.take(padded, range(k, k + values.shape[axis]), axis) for k in range(3))
        values = before + 2.0 * here + after
    return values
