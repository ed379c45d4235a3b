"""Whether a pair of frames is one: the laser's line in the first, and not in the second."""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pydantic
from jaxtyping import Float, UInt8

from jaxscan.files.disk import FileModel, Number
from jaxscan.stripes import (
    Colour,
    LaserLine,
    PixelFormat,
    Response,
    decode_table,
    frame_rank,
    laser_plane,
)
from scanrig.checks.ridges import Relief, Ridges, find_ridges, heights


Verdict = Literal["ok", "swapped", "stays on", "dark laser", "covered", "flooded", "changed", "too faint"]
Share = Annotated[Number, pydantic.Field(ge=0, le=1)]

_COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_LINES = 256
"""Lines that are looked at; each is evidence of its own."""
_STACK = 4
"""Image lines that are added up to one of them at most: a faint line gains, a leaning one loses little."""
_CLIPPED = 250
"""Code from which on a pixel is clipped."""
_BLACK_DN = 32.0
_FEATURELESS_DN = 3.0
"""Under a lens cap a frame is darker than the one, and its large features are flatter than the other."""
_LIGHTER = 2.0
"""Factor between the light of two frames that no flicker of lamps explains."""
_NOISE_CUT = 6.0
"""Residual at which a pixel's part in the unrest ends, in standard deviations."""
_NEARLY_CLIPPED = 245.0
_BESIDE = 14
"""Samples on either side of a ridge within which contrast may explain it."""
_EXPLAINS_MOST = 1.5
"""Part of a contrast that motion changes at most: all of it, and as much again where thin things pass."""
_MOSTLY = 0.4
"""Part of the ridges that contrast may not explain: of a laser nearly all, of what moves a fifth."""
_MARGIN = 3.0
"""By how much the largest change of a contrast may exceed that which nine tenths of them keep to."""
_ALIKE = 4.0
"""Neighbouring lines that see the same texture."""
_WELDED = 0.25
"""Part of the lines on which both frames show the same line, from which on it is the laser's and not the scene's."""
_CERTAIN = 3.0
"""Standard deviations by which a leak has to exceed what is allowed."""
_GLOWS = 0.5
"""Part of the line in the laser-off frame that no texture along it explains, from which on a single pair is refused."""
_STRONGER = 4.0
"""Factor by which all ridges of a pair have to be stronger than all furrows: motion makes as many of both."""
_UNSETTLED = 2.5
"""Unrest from which on a pair without a line is called changed rather than dark."""


class ProofLimits(FileModel):
    """What a pair has to keep to."""

    lit_lines: Share = 0.02
    """Part of the image's lines that must show the laser at least."""
    peak_dn: Annotated[Number, pydantic.Field(ge=0, le=255)] = 0.0
    """Height that the line must have at least [DN]."""
    leak: Share = 0.1
    """Part of the line's light that the laser-off frames may have, over several places (`leaks`)."""
    unrest: Annotated[Number, pydantic.Field(gt=0)] = 4.0
    """What may differ beside the laser, in standard deviations of the noise; 6 is the most there is."""
    saturated: Share = 1.0
    """Part of the lit lines that may be clipped."""
    flooded: Share = 0.25
    """Part of either frame that may be clipped."""


@dataclass(frozen=True)
class PairProof:
    """What a pair of frames shows; levels in linear DN."""

    ok: bool
    """A line in on − off; none, nor its reverse, in off."""
    verdict: Verdict
    """Which it is, for programs."""
    reason: str
    """Which it is, for people; "" where it is well."""
    lit_lines: float
    """Part of the image's lines that show the laser [1]."""
    peak_dn: float
    """Height of the line, median [DN]; 0 where there is none."""
    saturated: float
    """Part of the lit lines whose peak is clipped [1]."""
    ambient_dn: float
    """Mean level of the laser-off frame [DN]."""
    unrest: float
    """What differs beside the laser, root mean square in that of the noise, 6 at most: about 1 where all is still."""
    leak: float
    """Part of the line's light that is in the laser-off frame too [1]."""


class _Pair(NamedTuple):
    """The lines that are looked at, in mean DN of the image lines that each is made of."""

    on: Float[np.ndarray, "lines samples"]
    off: Float[np.ndarray, "lines samples"]
    clipped: float
    """Larger part of clipped pixels of the two frames."""
    lit: UInt8[np.ndarray, "all samples"]
    """Codes of the laser-on frame."""
    step: int
    """Image lines from one to the next."""


def prove_pair(
    on: UInt8[np.ndarray, "rows columns *three"],
    off: UInt8[np.ndarray, "rows columns *three"],
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    limits: ProofLimits | None = None,
) -> PairProof:
    """Look for the laser in the difference of two frames, and for what else may have happened.

    A line counts that stands 4 standard deviations above both sides, has no rival and no furrow on its row, and
    continues on the rows beside it; noise, texture, flicker and motion do not do that (`ridges`).

    Args:
        on: The frame that should show the laser's line, uint8 [rows, columns] (rgb8: and 3).
        off: The frame that should not, of the same shape.
        pixel_format: How a frame is to be read.
        response: "linear" or "srgb".
        line: The laser; of a colour "auto" the channel that changed most is taken.
        limits: What the pair has to keep to.

    Raises:
        ValueError: If the frames are not such images, or too small for a line with its sides (64 px).
    """
    limits = limits or ProofLimits()
    _check(on, off, pixel_format)
    line = _with_colour(on, off, pixel_format, line)
    pair = _lines_of(on, off, pixel_format, response, line)
    gain = _gain(pair)
    difference = _difference(pair, gain)
    relief = find_ridges(difference, pair.off)
    ridges = relief.ridges
    rows = np.flatnonzero(ridges.seen)
    lit, at = len(rows) / len(ridges.at), ridges.at[rows]
    unrest = _unrest(difference, pair.off)
    tall = heights(difference[rows], at) if len(rows) else np.zeros(0)
    peak = float(np.median(_peaks(difference[rows], at))) if len(rows) else 0.0
    leak, leak_sigma = _leak(heights(pair.off[rows], at), tall)
    saturated = _saturated(pair, rows, at)
    few = max(limits.lit_lines, 3.0 / len(ridges.at))
    explains = _explains(difference, pair.off, relief)
    if _solid(ridges, difference, pair.off, explains) < few or ridges.strength < _STRONGER * relief.furrows.strength:
        verdict, reason = _without_line(pair, relief, difference, explains, unrest, few, limits)
        if verdict in ("dark laser", "changed") and _shines_in_both(on, off, pixel_format, response, line):
            verdict, reason = (
                "stays on",
                ("the laser stays on: the same line is in both frames; see relay and wiring, open the contactor"),
            )
    else:
        verdict, reason = _with_line(pair, leak, leak_sigma, unrest, peak, saturated, limits)
    return PairProof(verdict == "ok", verdict, reason, lit, peak, saturated, float(pair.off.mean()), unrest, leak)


def _with_line(
    pair: _Pair, leak: float, leak_sigma: float, unrest: float, peak: float, saturated: float, limits: ProofLimits
) -> tuple[Verdict, str]:
    """The verdict on a pair with a line in its difference."""
    if leak - _CERTAIN * leak_sigma > max(_GLOWS, limits.leak):
        return "stays on", (
            f"the laser stays on: {100 * leak:.0f} % of its line is in the laser-off frame too; "
            "see relay, wiring and off_ms"
        )
    if pair.clipped > limits.flooded:
        return "flooded", _flood(pair)
    if flash := _flash(pair):
        return "flooded", flash
    if unrest > limits.unrest:
        return "changed", (
            f"the frames differ beside the laser by {unrest:.1f} times the noise, expected at most "
            f"{limits.unrest:.1f}: something moved, or the light changed"
        )
    if peak < limits.peak_dn:
        return "too faint", f"the line is {peak:.0f} DN high, expected at least {limits.peak_dn:.0f} DN"
    if saturated > limits.saturated:
        return "flooded", (
            f"the line is clipped on {100 * saturated:.0f} % of its rows, expected at most "
            f"{100 * limits.saturated:.0f} %; expose shorter"
        )
    return "ok", ""


def _without_line(
    pair: _Pair, relief: Relief, difference: np.ndarray, explains: float, unrest: float, few: float, limits: ProofLimits
) -> tuple[Verdict, str]:
    """The verdict on a pair whose difference shows no line: why not."""
    if _is_covered(pair.on) and _is_covered(pair.off):
        return "covered", "both frames are black and flat: the lens is covered, or the room and the laser are dark"
    if pair.clipped > limits.flooded:
        return "flooded", _flood(pair)
    if flash := _flash(pair):
        return "flooded", flash
    ridges, furrows = relief
    if _solid(furrows, -difference, pair.on, explains) >= few and furrows.strength > _STRONGER * ridges.strength:
        return "swapped", "the line is in the laser-off frame and not in the laser-on frame: the frames are swapped"
    if unrest > min(_UNSETTLED, limits.unrest):
        return "changed", (
            f"no line, and the frames differ by {unrest:.1f} times the noise: something moved, or the light changed"
        )
    if max(ridges.seen.mean(), furrows.seen.mean()) >= few:
        return "changed", (
            "what looks like a line is no brighter than edges beside it that may have moved: see that all stands "
            "still, or make the laser brighter"
        )
    return "dark laser", (
        "the frames are alike, without a line that comes and goes: the laser is dark (see supply, relay, interlock), "
        "or, if it shines, does not go off"
    )


def _flood(pair: _Pair) -> str:
    return f"flooded by light: {100 * pair.clipped:.0f} % of a frame is clipped; expose shorter or darken the room"


def _flash(pair: _Pair) -> str:
    """What to say where one frame has much more light than the other, all in all; "" where it has not."""
    brighter = (float(pair.on.mean()) + 4.0) / (float(pair.off.mean()) + 4.0)
    if 1.0 / _LIGHTER < brighter < _LIGHTER:
        return ""
    return f"flooded by light that came or went: the laser-on frame is {brighter:.1f} times as bright as the other"


def _check(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat) -> None:
    rank = frame_rank(pixel_format)
    if on.dtype != np.uint8 or on.ndim != rank or min(on.shape[:2]) < 64:
        raise ValueError(f"`on` must be uint8 with {rank} dimensions and 64 px, got {on.dtype} with shape {on.shape}.")
    if off.shape != on.shape or off.dtype != np.uint8:
        raise ValueError(f"`off` must be like `on`, got {off.dtype} with shape {off.shape}.")


def _with_colour(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> LaserLine:
    """The laser with the colour whose brightest change is greatest."""
    if line.colour != "auto" or pixel_format == "mono8":
        return line
    lines = [LaserLine(line.name, colour, line.stripe_axis) for colour in _COLOURS]
    return max(lines, key=lambda one: _brightest_change(on, off, pixel_format, one))


def _brightest_change(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, line: LaserLine) -> float:
    lit, dark = (laser_plane(a[None], pixel_format=pixel_format, line=line)[0, ::4].astype(np.int16) for a in (on, off))
    return float(np.abs(lit - dark).max(1).mean())


def _lines_of(on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, response: Response, line: LaserLine) -> _Pair:
    lit, dark = (np.asarray(laser_plane(a[None], pixel_format=pixel_format, line=line))[0] for a in (on, off))
    step = max(1, len(lit) // _LINES)
    few = (slice(None, None, 4), slice(None, None, 3))
    clipped = max(float((a[few] >= _CLIPPED).mean()) for a in (lit, dark))
    frames = _stacked(lit, step, response), _stacked(dark, step, response)
    return _Pair(*frames, clipped, lit, step)


def _stacked(
    plane: UInt8[np.ndarray, "all samples"], step: int, response: Response
) -> Float[np.ndarray, "lines samples"]:
    """Means of up to `_STACK` image lines each [linear DN]."""
    lines, stack = len(plane) // step, min(step, _STACK)
    unit = 1.0
    if response != "linear":
        unit = 1.0 / 16.0
        plane = np.rint(16.0 * decode_table(response)[0]).astype(np.uint16)[plane]
    total = plane[: lines * step : step].astype(np.uint16)
    for k in range(1, stack):
        np.add(total, plane[k : lines * step : step], out=total)
    # Where stripes lie across, the lines are columns of the image: in order only from here on.
    return np.ascontiguousarray(total).astype(np.float32) * np.float32(unit / stack)


def _difference(pair: _Pair, gain: float) -> Float[np.ndarray, "lines samples"]:
    """The laser-on frame without the light of the room; nothing where that is clipped."""
    room = pair.off * np.float32(gain)
    np.minimum(room, np.float32(255.0), out=room)
    difference = np.subtract(pair.on, room, out=room)
    difference[(pair.off > _NEARLY_CLIPPED) & (difference > 0)] = 0.0
    return difference


def _solid(ridges: Ridges, field: np.ndarray, frame: np.ndarray, explains: float) -> float:
    """Part of the lines whose ridge nothing in the other frame explains; 0 where that is the lesser part of the ridges.

    Whatever moves or flickers changes a picture by a part of the contrast that is there. A ridge that is higher than
    that part of all contrast of the other frame beside it is light of its own.
    """
    rows = np.flatnonzero(ridges.clear)
    if len(rows) == 0:
        return 0.0
    at = ridges.at[rows]
    beside = np.clip(at[:, None] + np.arange(-_BESIDE, _BESIDE + 1), 0, field.shape[1] - 1)
    contrast = np.ptp(_smooth(frame[rows[:, None], beside]), 1)
    solid = float((_peaks(field[rows], at) > explains * contrast).mean())
    return solid * len(rows) / len(ridges.at) if solid > _MOSTLY else 0.0


def _explains(difference: np.ndarray, off: np.ndarray, relief: Relief) -> float:
    """What part of the contrast of a picture its change may be: near 0 where all is still, 1 where all moved.

    From the blocks with contrast themselves, but for those in which the line itself may be: along a door's frame
    they would be a sixth of all.
    """
    few = slice(None, None, max(1, len(off) // 32))
    change, light = _smooth(difference[few]), _smooth(off[few])
    noise = 1.4826 * float(np.median(np.abs(change))) + 0.1
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


def _gain(pair: _Pair) -> float:
    """How much brighter the room is in the laser-on frame: the median, narrowed down on the bulk of the pixels."""
    few = (slice(None, None, max(1, len(pair.on) // 32)), slice(None, None, 3))
    on, off = pair.on[few].ravel(), pair.off[few].ravel()
    # By the sum, and weighted by it: chosen by the noise of one of them, the other would seem darker.
    usable = (on + off > 8.0) & (on < _CLIPPED) & (off < _CLIPPED)
    on, off = on[usable], off[usable]
    if len(on) < 200:
        return 1.0
    gain = float(np.clip(np.median(on / np.maximum(off, 0.25)), 0.1, 10.0))
    both = on + off
    for _ in range(2):
        residual = on - np.float32(gain) * off
        scale = 1.4826 * float(np.median(np.abs(residual))) + 0.1
        weight = np.maximum(1.0 - (residual / (3.0 * scale)) ** 2, 0.0) ** 2
        bottom = float(np.sum(weight * both * off))
        gain = float(np.sum(weight * both * on)) / bottom if bottom > 0 else gain
    return gain


def _unrest(difference: Float[np.ndarray, "lines samples"], off: Float[np.ndarray, "lines samples"]) -> float:
    """Root mean square of the difference where it is negative - a laser only adds light -, in that of the noise.

    The noise is that of second differences along the lines, in the calmer half of the blocks of equal level: neither
    smooth light nor edges are in it.
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
    # The median of 12 correlated squares lies below their mean.
    table = [
        (np.median(light[part]), np.median(variance[part]) / 0.89) for part in np.array_split(order, 8) if len(part)
    ]
    floor = 2.0 / 12.0 / 4.0
    noise = np.maximum(np.interp(level, *np.array(table).T), floor)
    square = np.minimum(residual * residual / noise, _NOISE_CUT**2)
    # Darkness is cut off at zero.
    darker = (residual < 0) & (level > 2.0)
    return float(np.sqrt(square[darker].mean())) if darker.sum() > 50 else 0.0


def _peaks(difference: Float[np.ndarray, "n samples"], at: np.ndarray) -> Float[np.ndarray, " n"]:
    """Highest sample near a ridge, over what lies beside it [DN]."""
    rows, last = np.arange(len(at))[:, None], difference.shape[1] - 1
    near = difference[rows, np.clip(at[:, None] + np.arange(-4, 5), 0, last)]
    beside = difference[rows, np.clip(at[:, None] + np.array([-32, -28, -24, -20, 20, 24, 28, 32]), 0, last)]
    return near.max(1) - np.median(beside, 1)


def _leak(off: Float[np.ndarray, " n"], difference: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Part of a line's light that is in the laser-off frame: median over the rows, and its standard deviation."""
    good = difference > 0
    if np.count_nonzero(good) < 3:
        return 0.0, 1.0
    ratio = off[good] / difference[good]
    middle = float(np.median(ratio))
    scatter = 1.4826 * float(np.median(np.abs(ratio - middle)))
    leak = middle / (1.0 + middle) if middle > 0 else middle
    return leak, 1.2533 * scatter / float(np.sqrt(len(ratio) / _ALIKE))


def _saturated(pair: _Pair, rows: np.ndarray, at: np.ndarray) -> float:
    if len(rows) == 0:
        return 0.0
    lines = rows[:, None, None] * pair.step + np.arange(min(pair.step, _STACK))[None, :, None]
    samples = np.clip(at[:, None, None] + np.arange(-2, 3)[None, None, :], 0, pair.lit.shape[1] - 1)
    return float((pair.lit[lines, samples] >= _CLIPPED).any((1, 2)).mean())


def _is_covered(frame: Float[np.ndarray, "lines samples"]) -> bool:
    """Dark, and without any large feature: blocks of 16 lines and samples tell it from noise."""
    lines, samples = (size // 16 for size in frame.shape)
    blocks = frame[: lines * 16, : samples * 16].reshape(lines, 16, samples, 16).mean((1, 3))
    return bool(frame.mean() < _BLACK_DN and np.ptp(blocks) < _FEATURELESS_DN)


def _shines_in_both(
    on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, response: Response, line: LaserLine
) -> bool:
    """Whether the same line runs through both frames; in a colour picture, one of the laser's colour."""
    fields = []
    for frame in (on, off):
        one = _lines_of(frame, frame, pixel_format, response, line).on
        if pixel_format == "rgb8":
            others = [LaserLine(line.name, c, line.stripe_axis) for c in _COLOURS if c != line.colour]
            one = one - np.maximum(*(_lines_of(frame, frame, pixel_format, response, o).on for o in others))
        fields.append(find_ridges(one, np.zeros_like(one) if pixel_format == "rgb8" else one).ridges)
    first, second = fields
    same = first.clear & second.clear & (np.abs(first.at - second.at) <= 3)
    return bool(same.mean() >= _WELDED)
