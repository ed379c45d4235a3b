"""Doubts about the journal of a sweep: numbers that are missing, angles that jump, stand still or are in radians."""

from collections.abc import Sequence

import numpy as np

from jaxscan.reconstruction.doubts.outliers import groups_of, named, scatter


_FEW = 6
"""Records of one laser from which a regularity is asked for."""
_WINDOW = 3
"""Steps on either side that say how large a step is."""
_STEP = 0.01
"""Part of a step by which angles may be off [1]; tables that count microsteps round."""
_ROUND_DEG = 0.05
"""Angle that microsteps may be off [deg]."""
_TURN_IN_RADIANS = 24
"""Records from which steps that divide 2 pi are taken for radians; of fewer, only a whole turn."""
_WHOLE_TURN = 0.002
"""Part by which a whole turn may differ from 2 pi [1]."""


def journal_doubts(
    numbers: Sequence[int], degrees: np.ndarray | None, lit: Sequence[tuple[int, ...]], planned: int | None
) -> list[str]:
    """Contradictions in the journal of a sweep.

    Args:
        numbers: Of the records, ascending.
        degrees: The table's angles, float64 [records], deg; None without a table.
        lit: The lasers that are lit in each record.
        planned: Records that the header plans, if it does.
    """
    number = np.asarray(numbers, np.int64)
    doubts = _missing(number, planned)
    for own in groups_of(lit):
        if degrees is not None and len(own) >= _FEW:
            doubts += _angles(number[own], degrees[own])
    return doubts


def _missing(number: np.ndarray, planned: int | None) -> list[str]:
    doubts = []
    if planned is not None and len(number) < planned:
        doubts.append(f"{len(number)} of the {planned} planned records are there")
    gaps = np.diff(number)
    # Every tenth record of another capture is a regular choice.
    if len(gaps) and gaps.max() > gaps.min():
        at = np.flatnonzero(gaps > gaps.min())
        before, after = number[at[0]], number[at[0] + 1]
        more = f", and {len(at) - 1} more gaps" if len(at) > 1 else ""
        doubts.append(f"records are missing: {before + gaps.min()} to {after - gaps.min()}{more}")
    return doubts


def _angles(number: np.ndarray, degrees: np.ndarray) -> list[str]:
    if np.ptp(degrees) < 1e-9:
        return [f"all {len(degrees)} records have the same angle, {degrees[0]:g} deg: the table did not turn"]
    stride = np.median(np.diff(number))
    # Whole turns make no difference.
    steps = (np.diff(degrees) + 180.0) % 360.0 - 180.0
    steps = steps / np.maximum(np.diff(number) / stride, 1.0)
    sizes = np.abs(steps)
    around = np.stack([np.roll(np.pad(sizes, _WINDOW, mode="reflect"), k) for k in range(-_WINDOW, _WINDOW + 1)])
    usual = np.median(around, 0)[_WINDOW:-_WINDOW]
    residuals = sizes - usual
    limit = np.maximum(4.0 * scatter(residuals), np.maximum(_STEP * usual, np.minimum(_ROUND_DEG, 0.3 * usual)))
    turned = np.sign(steps[1:]) * np.sign(steps[:-1]) < 0
    doubts = _radians(degrees, float(np.median(sizes)))
    if turned.mean() > 0.25:
        return [*doubts, "the angle goes back and forth from record to record: the records may have been exchanged"]
    # A table that goes to and fro turns round once, not twice in a row.
    back = np.concatenate([[False], turned[:-1] & turned[1:], [False]])
    wrong = np.flatnonzero((np.abs(residuals) > limit) | back)
    if 0 < len(wrong) <= max(2, 0.4 * len(steps)):
        both = np.intersect1d(wrong, wrong + 1)
        records = number[both] if len(both) else number[wrong + 1]
        expected = float(np.median(usual))
        doubts.append(
            f"the angle of {named(records)} does not continue that of the records around: "
            + _unlike(float(np.diff(degrees)[wrong[0]]), float(steps[wrong[0]]), expected)
        )
    return doubts


def _unlike(written: float, step: float, expected: float) -> str:
    """A step as it stands in the journal beside the usual one, with as many digits as tell them apart."""
    shown = written if abs(written) > 360.0 else step
    digits = next((n for n in range(4, 16) if f"{shown:.{n}g}" != f"{expected:.{n}g}"), 16)
    return f"a step of {shown:.{digits}g} deg, where {expected:.{digits}g} deg are usual"


def _radians(degrees: np.ndarray, step: float) -> list[str]:
    """A turn that fits into 2 pi, in steps that divide it evenly."""
    whole = abs(np.ptp(degrees) + step - 2 * np.pi) < _WHOLE_TURN * 2 * np.pi
    if step <= 0 or np.ptp(degrees) > 2 * np.pi * 1.01 or not (whole or len(degrees) >= _TURN_IN_RADIANS):
        return []
    parts = 2 * np.pi / step
    if abs(parts - round(parts)) > 0.02 or (parts > 2000 and abs(np.ptp(degrees) + step - 2 * np.pi) > 0.01):
        return []
    return [
        f"all angles lie within {np.ptp(degrees):.4g} deg, and {round(parts)} steps make 2 pi: they may be in radians; "
        "angle_deg needs degrees"
    ]
