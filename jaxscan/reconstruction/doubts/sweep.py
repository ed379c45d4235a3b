"""All doubts about a reconstructed sweep."""

from collections.abc import Sequence

import numpy as np

from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.doubts.frames import exchanged_frames, repeated_frames, strange_frames
from jaxscan.reconstruction.doubts.header import header_doubts
from jaxscan.reconstruction.doubts.outliers import groups_of
from jaxscan.reconstruction.doubts.profiles import profile_doubts
from jaxscan.reconstruction.doubts.seen import Seen
from jaxscan.reconstruction.doubts.turning import turning_doubts
from jaxscan.reconstruction.plan import Plan


def sweep_doubts(plan: Plan, cloud: PointCloud, seen: Seen, numbers: Sequence[int]) -> tuple[str, ...]:
    """Whatever contradicts the rest of a sweep, a sentence each; none for a healthy one.

    Args:
        plan: The sweep and its scanner.
        cloud: The sweep's cloud.
        seen: Statistics of its frames.
        numbers: The name of each record.
    """
    sweep, number = plan.sweep, np.asarray(numbers)
    doubts = repeated_frames(seen, number) + exchanged_frames(seen, number)
    lit: list[tuple[int, ...]] = [()] * len(sweep)
    for record, laser in zip(sweep.record.tolist(), sweep.laser.tolist(), strict=True):
        lit[record] = (*lit[record], laser)
    for own in groups_of(lit):
        doubts += strange_frames(seen, number, own)
        doubts += turning_doubts(seen, number, sweep.angles, own, plan.scanner)
    return tuple(doubts + profile_doubts(cloud, number) + header_doubts(sweep, seen, plan.scanner))
