"""Whether a pair of frames is one: the laser's line in the first, and not in the second."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.stripes import LaserLine, PixelFormat, Response
from scanrig.checks.frame_pair import COLOURS, FramePair, check_frames, difference_of, gain_of, lines_of, with_colour
from scanrig.checks.limits import ProofLimits
from scanrig.checks.measures import (
    explained_part,
    is_covered,
    leak_of,
    peak_heights,
    saturated_part,
    solid_part,
    unrest_of,
)
from scanrig.checks.ridges import Relief, find_ridges, heights


Verdict = Literal["ok", "swapped", "stays on", "dark laser", "covered", "flooded", "changed", "too faint"]

_LIGHTER = 2.0
"""Factor between the light of two frames that no flicker of lamps explains."""
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


class _Seen(NamedTuple):
    """What the difference of two frames shows."""

    difference: Float[np.ndarray, "lines samples"]
    """The laser-on frame without the light of the room [DN]."""
    relief: Relief
    explains: float
    """What part of the contrast of a picture its change may be."""
    few: float
    """Part of the lines that have to show the laser."""
    unrest: float
    peak: float
    """Height of the line, median [DN]; 0 where there is none."""
    saturated: float
    leak: float
    leak_sigma: float
    """Standard deviation of `leak`."""


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
    check_frames(on, off, pixel_format)
    line = with_colour(on, off, pixel_format, line)
    pair = lines_of(on, off, pixel_format, response, line)
    seen = _look(pair, limits)
    ridges, furrows = seen.relief
    solid = solid_part(ridges, seen.difference, pair.off, seen.explains)
    if solid < seen.few or ridges.strength < _STRONGER * furrows.strength:
        verdict, reason = _without_line(pair, seen, limits)
        if verdict in ("dark laser", "changed") and _shines_in_both(on, off, pixel_format, response, line):
            verdict, reason = (
                "stays on",
                ("the laser stays on: the same line is in both frames; see relay and wiring, open the contactor"),
            )
    else:
        verdict, reason = _with_line(pair, seen, limits)
    return PairProof(
        ok=verdict == "ok",
        verdict=verdict,
        reason=reason,
        lit_lines=np.count_nonzero(ridges.seen) / len(ridges.at),
        peak_dn=seen.peak,
        saturated=seen.saturated,
        ambient_dn=float(pair.off.mean()),
        unrest=seen.unrest,
        leak=seen.leak,
    )


def _look(pair: FramePair, limits: ProofLimits) -> _Seen:
    """What the difference of the frames shows."""
    difference = difference_of(pair, gain_of(pair))
    relief = find_ridges(difference, pair.off)
    ridges = relief.ridges
    rows = np.flatnonzero(ridges.seen)
    at = ridges.at[rows]
    tall = heights(difference[rows], at) if len(rows) else np.zeros(0)
    leak, leak_sigma = leak_of(heights(pair.off[rows], at), tall)
    return _Seen(
        difference,
        relief,
        explains=explained_part(difference, pair.off, relief),
        few=max(limits.lit_lines, 3.0 / len(ridges.at)),
        unrest=unrest_of(difference, pair.off),
        peak=float(np.median(peak_heights(difference[rows], at))) if len(rows) else 0.0,
        saturated=saturated_part(pair, rows, at),
        leak=leak,
        leak_sigma=leak_sigma,
    )


def _with_line(pair: FramePair, seen: _Seen, limits: ProofLimits) -> tuple[Verdict, str]:
    """The verdict on a pair with a line in its difference."""
    if seen.leak - _CERTAIN * seen.leak_sigma > max(_GLOWS, limits.leak):
        return "stays on", (
            f"the laser stays on: {100 * seen.leak:.0f} % of its line is in the laser-off frame too; "
            "see relay, wiring and off_ms"
        )
    if pair.clipped > limits.flooded:
        return "flooded", _flood(pair)
    if flash := _flash(pair):
        return "flooded", flash
    if seen.unrest > limits.unrest:
        return "changed", (
            f"the frames differ beside the laser by {seen.unrest:.1f} times the noise, expected at most "
            f"{limits.unrest:.1f}: something moved, or the light changed"
        )
    if seen.peak < limits.peak_dn:
        return "too faint", f"the line is {seen.peak:.0f} DN high, expected at least {limits.peak_dn:.0f} DN"
    if seen.saturated > limits.saturated:
        return "flooded", (
            f"the line is clipped on {100 * seen.saturated:.0f} % of its rows, expected at most "
            f"{100 * limits.saturated:.0f} %; expose shorter"
        )
    return "ok", ""


def _without_line(pair: FramePair, seen: _Seen, limits: ProofLimits) -> tuple[Verdict, str]:
    """The verdict on a pair whose difference shows no line: why not."""
    if is_covered(pair.on) and is_covered(pair.off):
        return "covered", "both frames are black and flat: the lens is covered, or the room and the laser are dark"
    if pair.clipped > limits.flooded:
        return "flooded", _flood(pair)
    if flash := _flash(pair):
        return "flooded", flash
    ridges, furrows = seen.relief
    if (
        solid_part(furrows, -seen.difference, pair.on, seen.explains) >= seen.few
        and furrows.strength > _STRONGER * ridges.strength
    ):
        return "swapped", "the line is in the laser-off frame and not in the laser-on frame: the frames are swapped"
    if seen.unrest > min(_UNSETTLED, limits.unrest):
        return "changed", (
            f"no line, and the frames differ by {seen.unrest:.1f} times the noise: "
            "something moved, or the light changed"
        )
    if max(ridges.seen.mean(), furrows.seen.mean()) >= seen.few:
        return "changed", (
            "what looks like a line is no brighter than edges beside it that may have moved: see that all stands "
            "still, or make the laser brighter"
        )
    return "dark laser", (
        "the frames are alike, without a line that comes and goes: the laser is dark (see supply, relay, interlock), "
        "or, if it shines, does not go off"
    )


def _flood(pair: FramePair) -> str:
    return f"flooded by light: {100 * pair.clipped:.0f} % of a frame is clipped; expose shorter or darken the room"


def _flash(pair: FramePair) -> str:
    """What to say where one frame has much more light than the other, all in all; "" where it has not."""
    brighter = (float(pair.on.mean()) + 4.0) / (float(pair.off.mean()) + 4.0)
    if 1.0 / _LIGHTER < brighter < _LIGHTER:
        return ""
    return f"flooded by light that came or went: the laser-on frame is {brighter:.1f} times as bright as the other"


def _shines_in_both(
    on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, response: Response, line: LaserLine
) -> bool:
    """Whether the same line runs through both frames; in a colour picture, one of the laser's colour."""
    fields = []
    for frame in (on, off):
        one = lines_of(frame, frame, pixel_format, response, line).on
        if pixel_format == "rgb8":
            others = [LaserLine(line.name, c, line.stripe_axis) for c in COLOURS if c != line.colour]
            one = one - np.maximum(*(lines_of(frame, frame, pixel_format, response, o).on for o in others))
        fields.append(find_ridges(one, np.zeros_like(one) if pixel_format == "rgb8" else one).ridges)
    first, second = fields
    same = first.clear & second.clear & (np.abs(first.at - second.at) <= 3)
    return bool(same.mean() >= _WELDED)
