"""Doubts about frames: one that comes twice, laser on and off exchanged, one that does not continue its neighbours."""

import numpy as np

from jaxscan.reconstruction.doubts.outliers import bend, named, peaks, said, scatter
from jaxscan.reconstruction.doubts.seen import Seen


_FEW = 8
"""Records of one laser from which neighbours are compared."""


def repeated_frames(seen: Seen, numbers: np.ndarray, off_images: np.ndarray | None = None) -> list[str]:
    """Frames that are the same to the last bit, which noise never makes.

    Args:
        seen: Of all records.
        numbers: Of all records.
        off_images: A number for each record's laser-off image, int [records]; records that name the same image, as two
            lasers at one angle may, have the same. None if each record has its own.
    """
    doubts = []
    on, off = seen.prints[:, 0], seen.prints[:, 1]
    alike = np.flatnonzero((on == off) & (on != 0))
    if len(alike):
        doubts.append(f"the laser-on and the laser-off frame of {named(numbers[alike])} are the same")
    own = np.arange(len(off))
    firsts = own if off_images is None else np.unique(off_images, return_index=True)[1]
    for side, prints, counted in (("on", on, own), ("off", off, firsts)):
        known = counted[prints[counted] != 0]
        values, counts = np.unique(prints[known], return_counts=True)
        # One laser-off frame for the whole sweep is somebody's intention.
        if len(known) and counts.max() > 1 and (side == "on" or len(values) > 1):
            again = np.flatnonzero(np.isin(prints, values[counts > 1]))
            doubts.append(f"the laser-{side} frames of {named(numbers[again])} are the same frame again")
    mixed = np.flatnonzero(np.isin(on, off[off != 0]) & (on != off) & (on != 0))
    if len(mixed):
        doubts.append(f"the laser-on frame of {named(numbers[mixed])} is the laser-off frame of another record")
    return doubts


def blank_frames(seen: Seen, numbers: np.ndarray) -> list[str]:
    """Records of which one frame is without anything where the other has light, as where a file has lost a block."""
    blank = np.flatnonzero(seen.blank.any(1))
    if not len(blank):
        return []
    rows = int(seen.blank[blank].max())
    return [
        f"{said(numbers[blank], 'has', 'have')} up to {rows} rows of zeros in one frame and light there in the other"
    ]


def exchanged_frames(seen: Seen, numbers: np.ndarray) -> list[str]:
    """Records whose laser-off frame has the stripe."""
    brighter, darker = seen.change.T
    if np.median(brighter) <= np.median(darker):
        everywhere = len(numbers) >= _FEW and np.median(darker) > max(4 * np.median(brighter), 5e-4)
        sentence = "the laser is in the laser-off frames and not in the laser-on frames: on and off are exchanged"
        return [sentence] if everywhere else []
    wrong = np.flatnonzero((darker > 4 * brighter) & (darker > 0.2 * np.median(brighter)))
    return [f"laser on and laser off are exchanged in {named(numbers[wrong])}"] if len(wrong) else []


def strange_frames(seen: Seen, numbers: np.ndarray, own: np.ndarray) -> list[str]:
    """Records whose frames are not like those before and after: brighter, rougher, or of two different places.

    Args:
        seen: Of all records.
        numbers: Of all records.
        own: The records of one laser.
    """
    if len(own) < _FEW:
        return []
    doubts = []
    for name, values, floor in (
        ("brightness", np.log(seen.level[own] + 1.0), 0.12),
        ("noise", np.log(seen.grain[own] + 0.5), 0.25),
    ):
        wrong: set[int] = set()
        for side in values.T:
            residuals = bend(side)
            wrong |= set(peaks(np.abs(residuals), max(5.0 * scatter(residuals), floor)).tolist())
        if wrong:
            doubts.append(f"the {name} of {named(numbers[own[sorted(wrong)]])} is not that of the records around")
    usual = np.median(seen.unrest[own])
    unlike = own[seen.unrest[own] > max(3.0 * usual, usual + 3.0, 4.0 * scatter(seen.unrest[own]))]
    if len(unlike):
        doubts.append(f"the laser-on and the laser-off frame of {named(numbers[unlike])} do not show the same")
    broken = own[_far_off(seen.lost[own])]
    broken = broken[~np.isin(broken, unlike)]
    if len(broken):
        doubts.append(
            f"the laser-on frame of {said(numbers[broken], 'lacks', 'lack')} light that its laser-off frame has: one "
            "of the two is damaged or of something else in part"
        )
    light = seen.change[own, 0]
    least = np.minimum(np.concatenate([light[1:2], light[:-1]]), np.concatenate([light[1:], light[-2:-1]]))
    gone = own[(light < 0.1 * least) & (least > 0.4 * np.median(light)) & (least > 2e-3)]
    if len(gone):
        doubts.append(f"{said(numbers[gone], 'shows', 'show')} no laser, and the records around do")
    return doubts


def _far_off(lost: np.ndarray) -> np.ndarray:
    """Records at one of whose places something is far above the same of the sweep and of the records around.

    Args:
        lost: As in `Seen`, of one laser, [records, places].
    """
    wrong: set[int] = set()
    for place in lost.T:
        residuals = bend(place)
        # Ten standard deviations, of which 4 of 5 residuals keep 1.28 at most; levels are whole numbers.
        usual = float(np.median(place))
        limit = max(8.0 * scatter(residuals), 4.0, usual)
        # The neighbours of a record that is far too low are no higher than usual themselves.
        high = np.where(place - usual > limit, np.maximum(residuals, 0.0), 0.0)
        wrong |= set(peaks(high, limit).tolist())
    return np.array(sorted(wrong), int)
