"""Records in which the board was not found, and the likely reason: cheap statistics of their images."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Real


# Brightest level of an image that is too dark [DN]; share of clipped pixels of one that is too bright [1].
_DARK_DN = 60
_CLIPPED_DN, _MANY_CLIPPED = 250, 0.3
# Sharpness of a blurred image, over that of the images in which the board was found [1].
_BLURRED = 0.5


class Light(NamedTuple):
    """How an image is exposed and focused."""

    brightest: float
    """Level that one of a hundred pixels exceeds [DN]."""
    clipped: float
    """Share of clipped pixels [1]."""
    sharpness: float
    """Steepest steps between neighbours, over the contrast [1]."""


class MissedRecord(NamedTuple):
    """A record in which the board was not found."""

    record: int
    why: str


def measure_light(grey: Real[np.ndarray, "rows columns"]) -> Light:
    """The light of one image [DN of 8 bits]."""
    some = grey[::4]
    low, high = np.percentile(some[:, ::4], (1, 99))
    steps = np.abs(np.diff(some.astype(np.float32), axis=1))
    sharpness = float(np.percentile(steps, 99.5)) / max(float(high - low), 1.0)
    return Light(float(high), float(np.mean(some >= _CLIPPED_DN)), sharpness)


def missed_records(seen: Sequence[tuple[int, bool, Light | None]]) -> tuple[MissedRecord, ...]:
    """The records without the board, each with the likely reason.

    Args:
        seen: Of every record its number, whether the board was found, and its light; None where it has no image.
    """
    sharp = [light.sharpness for _, found, light in seen if found and light is not None]
    usual = float(np.median(sharp)) if sharp else 0.0
    return tuple(MissedRecord(record, _reason(light, usual)) for record, found, light in seen if not found)


def count_reasons(missed: Sequence[MissedRecord]) -> str:
    """The reasons, the commonest first: "12 too dark, 3 blurred"."""
    counts = Counter(record.why for record in missed).most_common()
    return ", ".join(f"{count} {why}" for why, count in counts)


def _reason(light: Light | None, sharpness: float) -> str:
    if light is None:
        return "no image to look at"
    if light.brightest < _DARK_DN:
        return "too dark"
    if light.clipped > _MANY_CLIPPED:
        return "too bright"
    if light.sharpness < _BLURRED * sharpness:
        return "blurred"
    return "no whole board of this kind in the picture"
