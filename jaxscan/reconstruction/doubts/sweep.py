"""All doubts about a reconstructed sweep."""

from collections.abc import Sequence

import numpy as np

from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.doubts.frames import blank_frames, exchanged_frames, repeated_frames, strange_frames
from jaxscan.reconstruction.doubts.header import header_doubts
from jaxscan.reconstruction.doubts.outliers import groups_of
from jaxscan.reconstruction.doubts.profiles import profile_doubts
from jaxscan.reconstruction.doubts.seen import Seen
from jaxscan.reconstruction.doubts.turning import turning_doubts
from jaxscan.reconstruction.plan import Plan


def sweep_doubts(
    plan: Plan, cloud: PointCloud, seen: Seen, numbers: Sequence[int], off_images: np.ndarray | None = None
) -> tuple[str, ...]:
    """Contradictions between a part of a sweep and the rest of it, a sentence each; none for a healthy one.

    Args:
        plan: The sweep and its scanner.
        cloud: The sweep's cloud.
        seen: Statistics of its frames.
        numbers: The name of each record.
        off_images: A number for each record's laser-off image, int [records], the same where records name the same
            image; None if each record has its own.
    """
    sweep, number = plan.sweep, np.asarray(numbers)
    doubts = repeated_frames(seen, number, off_images) + exchanged_frames(seen, number)
    doubts += blank_frames(seen, number)
    lit: list[tuple[int, ...]] = [()] * len(sweep)
    for record, laser in zip(sweep.record.tolist(), sweep.laser.tolist(), strict=True):
        lit[record] = (*lit[record], laser)
    for own in groups_of(lit):
        doubts += strange_frames(seen, number, own)
        doubts += turning_doubts(seen, number, sweep.angles, own, plan.scanner)
    return tuple(doubts + profile_doubts(cloud, number) + header_doubts(sweep, seen, plan.scanner))
