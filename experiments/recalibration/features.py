"""Exact sightings of points of the room in laser-off images, as tracked features."""

import numpy as np

from experiments.recalibration.crossings import room_from_rig
from experiments.recalibration.world import TrueSweep
from experiments.worlds.ideal_rig import IdealRig
from jaxscan.recalibration import Tracks
from jaxscan.simulation import SimulationConfig, make_rig


POINTS, KEYS, NOISE_PX, START_M = 150, 90, 0.15, 0.02
"""Features, images in which they are looked for, noise of a sighting, and error of first values."""
_MARGIN_PX = 12.0
_FEWEST = 3


def features_of(config: SimulationConfig, truth: TrueSweep, seed: int) -> Tracks:
    """Features on walls, floor and ceiling, where they are seen in key images of a sweep.

    Args:
        config: The true rig and its room.
        truth: Of the sweep: points that its stripes met are visible from the rig.
        seed: Of points and noise.
    """
    random, rig = np.random.default_rng([seed, 89]), IdealRig(config)
    walls = np.flatnonzero((truth.surface.ravel() >= 0) & (truth.surface.ravel() < 6))
    point = truth.point.reshape(-1, 3)[random.choice(walls, POINTS, replace=False)]
    records = np.unique(np.linspace(0, len(truth.angle), KEYS, endpoint=False).astype(int))
    place, frame = room_from_rig(config), make_rig(config).scanner_from_camera
    seen = []
    for record in records:
        back = (place @ frame @ rig.turned(float(truth.angle[record]))).inverse().apply(point)
        ahead = (back[:, 2] > 0.3) & (np.hypot(back[:, 0], back[:, 1]) < back[:, 2])
        q = rig.project(np.where(ahead[:, None], back, [0.0, 0.0, 1.0]))
        track = np.flatnonzero(ahead & rig.inside(q, _MARGIN_PX))
        seen.append(np.column_stack([q[track], np.full(len(track), record), track]))
    found = np.concatenate(seen)
    often = np.bincount(found[:, 3].astype(int), minlength=POINTS) >= _FEWEST
    found = found[often[found[:, 3].astype(int)]]
    kept, track = np.unique(found[:, 3].astype(int), return_inverse=True)
    start = place.inverse().apply(point[kept])
    return Tracks(
        q=found[:, :2] + NOISE_PX * random.standard_normal((len(found), 2)),
        sigma=np.full(len(found), NOISE_PX),
        sweep=np.zeros(len(found), int),
        record=found[:, 2].astype(int),
        track=track,
        point=start + START_M * random.standard_normal(start.shape),
    )
