"""Faults of the pairs of a sweep that a user should know: laser light in the laser-off image, motion."""

from collections.abc import Callable, Sequence

import numpy as np

from jaxscan.geometry import Array
from jaxscan.reconstruction.plan import Plan
from jaxscan.stripes import judge_pairs


_JUDGED_PAIRS = 8
"""Pairs of a sweep that are looked at."""
_LEAK = 0.05
"""Part of the stripe in the laser-off image from which a user should know [1]."""
_UNREST = 2.0
"""Difference beside the laser from which a user should know, in the noise [1]."""


def pair_notes(
    plan: Plan, frames: Callable[[int], tuple[Array | None, Array | None]], numbers: Sequence[int]
) -> tuple[str, ...]:
    """The faults of a sweep's pairs, from some of them all over it; a sentence each.

    Args:
        plan: The sweep.
        frames: Laser-on and laser-off frame of a record.
        numbers: The name of each record.
    """
    sweep = plan.sweep
    lit = np.bincount(sweep.record, minlength=len(sweep))
    alone = np.flatnonzero(lit == 1)
    if len(alone) == 0 or len(sweep.exposures) > 1:
        return ()
    chosen = alone[np.unique(np.linspace(0, len(alone) - 1, _JUDGED_PAIRS).astype(int))]
    pairs = [frames(int(record)) for record in chosen]
    if any(off is None for _, off in pairs):
        return ()
    notes = []
    laser = np.array([sweep.laser[sweep.record == record][0] for record in chosen])
    for index in np.unique(laser):
        own = np.flatnonzero(laser == index)
        on, off = (np.stack(images) for images in zip(*(pairs[i] for i in own), strict=True))
        line = plan.lasers[index]
        found = judge_pairs(on, off, frames=plan.frames, line=line)
        leaking = float(np.median(found.leak))
        if leaking > _LEAK and leaking > 4.0 * float(np.median(found.leak_sigma)):
            notes.append(
                f'the laser "{line.name}" is in the laser-off images too ({100 * leaking:.0f} % of the stripe): wait '
                f"longer after switching it off"
            )
        moving = [str(numbers[i]) for i in chosen[own][found.unrest > _UNREST]]
        if moving:
            notes.append(
                f"something moved, or a lamp changed, between the two images of record "
                f"{', '.join(moving)} ({len(own)} were looked at)"
            )
    return tuple(notes)
