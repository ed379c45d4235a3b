"""Walls seen straight on: what is where on the wall is where in the picture."""

import numpy as np
import pytest

import jaxscan
from jaxscan.errors import MeasurementError
from jaxscan.report import with_scale

from ..measurement.rooms import HEIGHT


def test_colours_are_where_they_are_on_the_wall(survey, furnished_cloud):
    """The cloud is painted with its own places along the first wall and above the floor."""
    room = survey.outline
    start, end = (room.corners()[0][i].at for i in (1, 0))
    along = (end - start) / np.linalg.norm(end - start)
    s, z = (survey.p - start) @ along, survey.p[:, 2]
    length = np.linalg.norm(end - start)
    rgb = np.stack([np.clip(255 * s / length, 0, 255), np.clip(255 * z / HEIGHT, 0, 255), np.zeros(len(s))], -1)
    rgb = rgb.astype(np.uint8).reshape(*furnished_cloud.valid.shape, 3)
    picture = jaxscan.draw_orthophotos(survey, rgb, pixel_m=0.01)[0]
    rows, columns = picture.seen.shape
    assert abs(columns * 0.01 - length) <= 0.01 and abs(rows * 0.01 - HEIGHT) <= 0.011
    row, column = np.nonzero(picture.seen)
    found = picture.rgb[row, column].astype(float)
    truth = [255 * (column + 0.5) * 0.01 / length, 255 * (HEIGHT - (row + 0.5) * 0.01) / HEIGHT]
    # A pixel is one level wide; colours are cut to whole numbers, and samples are within half a pixel.
    errors = np.abs(found[:, :2] - np.stack(truth, 1))
    assert np.percentile(errors, 99) < 3.0
    assert picture.seen.mean() > 0.5 and (picture.rgb[~picture.seen] == 255).all()


def test_every_wall_has_a_picture(survey, furnished_cloud):
    pictures = jaxscan.draw_orthophotos(survey, furnished_cloud.rgb, pixel_m=0.02)
    assert [picture.side for picture in pictures] == [side.name for side in survey.outline.loops[0]]
    assert all((picture.rgb[picture.seen] == 128).all() for picture in pictures)


def test_too_fine_a_picture_is_refused(survey, furnished_cloud):
    with pytest.raises(MeasurementError, match="larger pixels"):
        jaxscan.draw_orthophotos(survey, furnished_cloud.rgb, pixel_m=1e-5)


def test_the_scale_does_not_change_the_picture():
    picture = np.random.default_rng(0).integers(0, 255, (120, 400, 3), dtype=np.uint8)
    drawn = with_scale(picture, 0.01, "W1, 10 mm per pixel")
    assert drawn.shape[1:] == (400, 3) and drawn.dtype == np.uint8 and (drawn[:120] == picture).all()
    # Parts of 0.1 m are ten pixels wide: the first is dark from 2 % of the width on.
    strip = drawn[120:]
    row = strip[int(0.35 * len(strip))].mean(-1)
    assert (row[10:17] < 80).all() and (row[20:26] > 200).all()
