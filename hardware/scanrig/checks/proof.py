"""The proof of a pair: whether its two frames show what they should, within configurable limits."""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pydantic
from jaxtyping import Float, UInt8, UInt16

from jaxscan.files.disk import FileModel, Number
from jaxscan.stripes import LaserLine, PixelFormat, Response
from scanrig.checks.measures import (
    COLOURS,
    FramePair,
    Relief,
    check_frames,
    difference_of,
    explained_part,
    find_ridges,
    gain_of,
    heights,
    is_covered,
    leak_of,
    lines_of,
    peak_heights,
    saturated_part,
    solid_part,
    unrest_of,
    with_colour,
)


Share = Annotated[Number, pydantic.Field(ge=0, le=1)]


class ProofLimits(FileModel):
    """Limits for the proof of a pair."""

    lit_lines: Share = 0.02
    """Least part of the frame's lines that must show the laser."""
    peak_dn: Annotated[Number, pydantic.Field(ge=0, le=255)] = 0.0
    """Least height of the stripe [DN]."""
    leak: Share = 0.1
    """Largest part of the stripe's light in the laser-off frames, over several places (`leaks`)."""
    unrest: Annotated[Number, pydantic.Field(gt=0)] = 4.0
    """Largest difference beside the laser, in standard deviations of the noise, at most 6."""
    saturated: Share = 1.0
    """Largest part of the lit lines that may be clipped."""
    flooded: Share = 0.25
    """Largest part of either frame that may be clipped."""


Verdict = Literal["ok", "swapped", "stays on", "dark laser", "covered", "flooded", "changed", "too faint"]

_LIGHTER = 2.0
"""Ratio of the light of two frames that is too large for flicker of lamps."""
_WELDED = 0.25
"""Part of the lines with the same stripe in both frames above which it is the laser, not the scene."""
_CERTAIN = 3.0
"""Standard deviations by which a leak must exceed its limit."""
_GLOWS = 0.5
"""Leak above which a single pair is rejected: texture along the stripe does not explain so much."""
_STRONGER = 4.0
"""Factor by which the ridges of a pair must be stronger than the furrows; motion makes both alike."""
_UNSETTLED = 2.5
"""Unrest above which a pair without a stripe counts as changed instead of dark."""


@dataclass(frozen=True)
class PairProof:
    """The verdict on a pair, and its measures; levels in linear DN."""

    ok: bool
    verdict: Verdict
    reason: str
    lit_lines: float
    """Part of the frame's lines that show the laser [1]."""
    peak_dn: float
    """Height of the stripe, median [DN]; 0 if there is none."""
    saturated: float
    """Part of the lit lines whose peak is clipped [1]."""
    ambient_dn: float
    """Mean level of the laser-off frame [DN]."""
    unrest: float
    """Differences beside the laser, root mean square over that of the noise, at most 6; about 1 if nothing changed."""
    leak: float
    """Part of the stripe's light that is in the laser-off frame too [1]."""


class _Seen(NamedTuple):
    """Measures on the difference of two frames."""

    difference: Float[np.ndarray, "lines samples"]
    """The laser-on frame without the light of the room [DN]."""
    relief: Relief
    explains: float
    """Fraction of a frame's contrast by which it may have changed; see `explained_part`."""
    few: float
    unrest: float
    peak: float
    saturated: float
    leak: float
    leak_sigma: float


def prove_pair(
    on: UInt8[np.ndarray, "rows columns *three"] | UInt16[np.ndarray, "rows columns"],
    off: UInt8[np.ndarray, "rows columns *three"] | UInt16[np.ndarray, "rows columns"],
    *,
    pixel_format: PixelFormat,
    response: Response,
    line: LaserLine,
    limits: ProofLimits | None = None,
    bits: int = 8,
) -> PairProof:
    """Search for the laser in the difference of two frames, and find the cause if it is missing.

    A ridge counts if it is 4 standard deviations above both sides, has no rival and no furrow on its row, and continues
    on neighbouring rows; noise, texture, flicker and motion do not make such ridges.

    Args:
        on: The frame that should show the laser's line, uint16 of more than 8 bits.
        off: The frame that should not.
        line: The laser; for the colour "auto" the channel that changed most is used.
        bits: Bits of a sample. All measures are in DN of 8 bits.

    Raises:
        ValueError: If the frames have another type or shape, or fewer than 64 px on a side.
    """
    limits = limits or ProofLimits()
    check_frames(on, off, pixel_format, bits)
    line = with_colour(on, off, pixel_format, line)
    pair = lines_of(on, off, pixel_format, response, line, bits)
    seen = _look(pair, limits)
    ridges, furrows = seen.relief
    solid = solid_part(ridges, seen.difference, pair.off, seen.explains)
    if solid < seen.few or ridges.strength < _STRONGER * furrows.strength:
        verdict, reason = _without_line(pair, seen, limits)
        if verdict in ("dark laser", "changed") and _shines_in_both(on, off, pixel_format, response, line, bits):
            verdict, reason = (
                "stays on",
                "the laser stays on: the same line is in both frames; check relay and wiring, open the contactor",
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
    """Measure the difference of the frames."""
    difference = difference_of(pair, gain_of(pair))
    relief = find_ridges(difference, pair.off)
    ridges = relief.ridges
    rows = np.flatnonzero(ridges.seen)
    at = ridges.at[rows]
    tall = heights(difference, rows, at)
    leak, leak_sigma = leak_of(heights(pair.off, rows, at), tall)
    return _Seen(
        difference,
        relief,
        explains=explained_part(difference, pair.off, relief),
        few=max(limits.lit_lines, 3.0 / len(ridges.at)),
        unrest=unrest_of(difference, pair.off),
        peak=float(np.median(peak_heights(difference, rows, at))) if len(rows) else 0.0,
        saturated=saturated_part(pair, rows, at),
        leak=leak,
        leak_sigma=leak_sigma,
    )


def _with_line(pair: FramePair, seen: _Seen, limits: ProofLimits) -> tuple[Verdict, str]:
    """The verdict on a pair with a stripe in its difference."""
    if seen.leak - _CERTAIN * seen.leak_sigma > max(_GLOWS, limits.leak):
        return "stays on", (
            f"the laser stays on: {100 * seen.leak:.0f} % of its line is in the laser-off frame too; "
            "check relay, wiring and off_ms"
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
    """The verdict on a pair whose difference shows no stripe, with the cause."""
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
            "a possible line is no brighter than edges beside it that may have moved: keep everything still, or make "
            "the laser brighter"
        )
    return "dark laser", (
        "both frames are alike, and no line appears or disappears: the laser is dark (check supply, relay, interlock), "
        "or, if it shines, it does not go off"
    )


def _flood(pair: FramePair) -> str:
    return f"flooded by light: {100 * pair.clipped:.0f} % of a frame is clipped; expose shorter or darken the room"


def _flash(pair: FramePair) -> str:
    """The reason if one frame has much more light than the other; "" if not."""
    brighter = (float(pair.on.mean()) + 4.0) / (float(pair.off.mean()) + 4.0)
    if 1.0 / _LIGHTER < brighter < _LIGHTER:
        return ""
    return f"flooded by light that came or went: the laser-on frame is {brighter:.1f} times as bright as the other"


def _shines_in_both(
    on: np.ndarray, off: np.ndarray, pixel_format: PixelFormat, response: Response, line: LaserLine, bits: int
) -> bool:
    """Whether the same stripe is in both frames; in colour frames, a stripe of the laser's colour."""
    fields = []
    for frame in (on, off):
        one = lines_of(frame, frame, pixel_format, response, line, bits).on
        if pixel_format == "rgb8":
            others = [LaserLine(line.name, c, line.stripe_axis) for c in COLOURS if c != line.colour]
            one = one - np.maximum(*(lines_of(frame, frame, pixel_format, response, o, bits).on for o in others))
        fields.append(find_ridges(one, np.zeros_like(one) if pixel_format == "rgb8" else one).ridges)
    first, second = fields
    same = first.clear & second.clear & (np.abs(first.at - second.at) <= 3)
    return bool(same.mean() >= _WELDED)
