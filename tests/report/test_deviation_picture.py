"""Maps of deviations: a recess does not set the scale, and what lies beyond it is marked and counted."""

import dataclasses
import io

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from jaxscan.measurement import DeviationMap
from jaxscan.report import deviation_picture
from jaxscan.report.drawing import GREEN, ORANGE
from jaxscan.report.pictures import deviation_reach


def wall(recess=0.0, share=0.3, scatter=2e-4):
    """20 x 20 cells, flat but for their scatter, of which a share lies deeper by a recess [m]."""
    deviation = scatter * np.random.default_rng(0).normal(size=(20, 20))
    deviation[:, : round(20 * share)] -= recess
    seen = np.ones(deviation.shape, bool)
    seen[0, 0] = False
    zero = np.zeros(3)
    return DeviationMap(
        deviation, np.full(seen.shape, 1e-4), np.full(seen.shape, 9), seen, 0.05, zero, zero, zero, zero, 0.0, 0.0, 0.0
    )


@pytest.mark.parametrize("recess", [0.0, 0.04])
def test_a_recess_does_not_set_the_scale(recess):
    """With 30 % of recess the median of |d| is the flat part's 71st percentile: 1.07 sigma, 5 x 1.48 x 1.07 = 7.9.

    280 cells tell that percentile to 5 %.
    """
    assert 3 * 2e-4 < deviation_reach(wall(recess)) < 1.15 * 7.9 * 2e-4


def test_the_scale_ends_with_the_largest_deviation():
    """An even slope from -1 to 1 mm, and a wall without any deviation."""
    slope = np.tile(np.linspace(-1e-3, 1e-3, 20), (20, 1))
    assert deviation_reach(dataclasses.replace(wall(), deviation_m=slope)) == 1e-3
    assert deviation_reach(dataclasses.replace(wall(), deviation_m=0.0 * slope)) == 1e-5


def drawn(recess):
    return imread(io.BytesIO(deviation_picture(wall(recess))))


def area_of(picture, colour):
    """Share of the pixels that have a colour, to the last levels."""
    return (np.abs(picture[..., :3] - to_rgb(colour)) < 0.01).all(-1).mean()


def test_what_lies_beyond_the_scale_has_its_colour():
    flat, deep = (drawn(recess) for recess in (0.0, 0.04))
    # 30 % of the left map, which is a quarter of the picture or more.
    assert area_of(flat, GREEN) < 0.001 and area_of(deep, GREEN) > 0.05
    raised = drawn(-0.04)
    assert area_of(deep, ORANGE) < 0.002 and area_of(raised, ORANGE) > 0.05
