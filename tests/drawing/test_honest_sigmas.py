"""Plans of rooms that a rig scanned which is not quite as its calibration says: lengths lie within their sigmas."""

import numpy as np
import pytest

import jaxscan

from ..measurement.rooms import CUPBOARD, DOOR, HEIGHT, L_SHAPE, WINDOW
from .scanned import scanned_room


BOX = ((0.0, 0.0), (5.4, 0.0), (5.4, 4.2), (0.0, 4.2))
SEEDS = 8
ROOMS = [(BOX, {}), (L_SHAPE, {}), (L_SHAPE, {"niches": (DOOR, WINDOW), "boxes": (CUPBOARD,)})]


def whitened(estimate, truth):
    return (estimate.value - truth) / estimate.sigma


@pytest.mark.slow
def test_lengths_and_openings_lie_within_their_sigmas():
    """Three rooms, eight draws each of calibration, noise and place."""
    lengths, levels, ends, widths, found = [], [], [], [], 0
    for number, (corners, more) in enumerate(ROOMS):
        points = np.array(corners)
        truth = np.linalg.norm(np.roll(points, -1, 0) - points, axis=1)
        area = 0.5 * abs(np.sum(points[:, 0] * np.roll(points[:, 1], -1) - np.roll(points[:, 0], -1) * points[:, 1]))
        for seed in range(SEEDS):
            cloud, rig = scanned_room(corners, seed=seed + number * SEEDS, **more)
            survey = jaxscan.survey_room(cloud, scanner=rig)
            room = survey.outline
            estimates = room.lengths(1.0)[0]
            values = np.array([one.value for one in estimates])
            shifts = [np.roll(truth, -k) for k in range(len(truth))]
            ordered = min(shifts, key=lambda each: float(np.abs(each - values).max()))
            lengths += [whitened(one, true) for one, true in zip(estimates, ordered, strict=True)]
            levels += [whitened(room.height(), HEIGHT), whitened(room.floor_area(), area)]
            levels.append(whitened(room.volume(), area * HEIGHT))
            for one in (each for loop in survey.openings for side in loop for each in side):
                # Nothing is found where nothing is.
                assert one.kind in {"door", "window"} and more
                true = DOOR if one.kind == "door" else WINDOW
                named = zip(("left", "right", "bottom", "top"), true[1:5], strict=True)
                ends += [whitened(getattr(one, name), edge) for name, edge in named]
                widths += [whitened(one.width, true[2] - true[1]), whitened(one.height, true[4] - true[3])]
                found += 1
    assert found == 2 * SEEDS
    size, others = np.abs(lengths), np.abs(levels)
    # 128 lengths. Those of one draw share its calibration and are as about two: of 48 independent normal numbers 0.55
    # to 0.82 lie within one sigma, 0.87 within two or more, in 95 % of cases.
    assert 0.53 < np.mean(size < 1.0) < 0.85 and np.mean(size < 2.0) > 0.87 and (size < 4.0).all()
    assert 0.78 < np.sqrt(np.mean(size**2)) < 1.25
    # Height, area and volume of a draw share its scale: as about 30 independent numbers.
    assert 0.72 < np.sqrt(np.mean(others**2)) < 1.3 and (others < 4.0).all()
    # An even distribution has the standard deviation width / sqrt(12), and ends at 1.73 of them; noise adds a little.
    assert np.abs(ends).max() < 2.0 and 0.6 < np.sqrt(np.mean(np.square(ends))) < 1.3
    assert np.abs(widths).max() < 2.5 and 0.6 < np.sqrt(np.mean(np.square(widths))) < 1.3
