"""The model of a blurred crossing against pictures drawn by brute force, and against OpenCV's corners."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest

from jaxscan.observation.corner_fit import fit_corners


TILE, TILES, FINE = 36, 6, 15


class Picture(NamedTuple):
    image: np.ndarray
    truth: np.ndarray
    edges: np.ndarray
    start: np.ndarray

    def refine(self, half=10.0, **options):
        return fit_corners(self.image, self.start, self.edges, np.full(len(self.start), half), **options)

    def error(self, found):
        return (found.q - self.truth)[found.valid]


def draw(
    seed, *, blur=(0.7, 1.3), crossing=(50, 130), swell=0.0, light=0.002, stretch=1.0, black=20.0, white=140.0, bend=0.0
):
    """Crossings at random places and angles, one per tile: light gathered at 15 x 15 points of every pixel.

    `swell` [px] is how far ink spreads over every edge, `stretch` how much more the picture is
    blurred along v than along u, `bend` the curvature of both edges [1 / px].
    """
    random = np.random.default_rng(seed)
    at = (np.arange(TILE * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(at, at)
    canvas, truth, edges = np.zeros((TILE * TILES, TILE * TILES)), [], []
    for row in range(TILES):
        for column in range(TILES):
            place = TILE / 2 + random.uniform(-1, 1, 2)
            first = random.uniform(0, 2 * np.pi)
            angles = np.array([first, first + np.radians(random.uniform(*crossing))])
            away = [np.cos(a) * (v - place[1]) - np.sin(a) * (u - place[0]) for a in angles]
            along = [np.cos(a) * (u - place[0]) + np.sin(a) * (v - place[1]) for a in angles]
            away = [d - 0.5 * bend * s**2 for d, s in zip(away, along, strict=True)]
            # Each edge is as wide as a point of the drawing, or an upright one would be off by half of that.
            side = [np.clip(2 * FINE * d, -1, 1) for d in away]
            ink = (1 + side[0] * side[1]) / 2
            for d in away:
                ink = np.maximum(ink, np.clip(FINE * (swell - np.abs(d)) + 0.5, 0, 1) * (swell > 0))
            fine = (white + (black - white) * ink).astype(np.float32)
            fine *= 1 + light * (random.normal() * (u - TILE / 2) + random.normal() * (v - TILE / 2))
            width = FINE * random.uniform(*blur)
            fine = cv2.GaussianBlur(fine, (0, 0), width, sigmaY=stretch * width)
            part = slice(row * TILE, (row + 1) * TILE), slice(column * TILE, (column + 1) * TILE)
            canvas[part] = fine.reshape(TILE, FINE, TILE, FINE).mean((1, 3))
            truth.append(place + (column * TILE, row * TILE))
            edges.append(np.stack([np.cos(angles), np.sin(angles)], -1))
    truth = np.array(truth)
    return Picture(canvas, truth, np.array(edges), truth + random.uniform(-0.5, 0.5, truth.shape))


@pytest.fixture(scope="module")
def clean():
    return draw(0)


def whitened(picture, found):
    return np.sqrt(np.mean((picture.error(found) / found.sigma[found.valid, None]) ** 2))


def test_without_noise_it_errs_by_thousandths_of_a_pixel(clean):
    found = clean.refine()
    assert found.valid.all()
    # The model knows edges that are blurred; that the light, too, is blurred is worth 0.003 px at
    # 0.2 % a pixel. cornerSubPix errs by 0.02 px.
    assert np.sqrt(np.mean(clean.error(found) ** 2)) < 0.004
    assert found.sigma.max() < 0.005
    even = draw(0, light=0.0)
    # The drawing's own points: 1/15 px, of which hundreds along an edge average.
    assert np.abs(even.error(even.refine())).max() < 0.0005


@pytest.mark.parametrize("crossing", [(30, 40), (140, 150)])
def test_edges_that_cross_at_a_slant(crossing):
    picture = draw(1, crossing=crossing, light=0.0)
    found = picture.refine()
    # Three terms of the series leave a rest, which is the same on opposite sides; cornerSubPix errs by 0.013 px.
    assert found.valid.all() and np.sqrt(np.mean(picture.error(found) ** 2)) < 0.003


def test_edges_that_a_lens_bends_move_no_corner_where_the_bend_is_known():
    """A fisheye of 240 px focal length bends edges by 1 / 400 px; crossings at a right angle, about."""
    picture = draw(7, light=0.0, crossing=(70, 110), bend=0.0025)
    straight = picture.refine()
    bent = picture.refine(bend=np.full((len(picture.truth), 2), 0.0025))
    assert straight.valid.all() and np.sqrt(np.mean(picture.error(straight) ** 2)) > 0.02
    assert bent.valid.all() and np.sqrt(np.mean(picture.error(bent) ** 2)) < 0.003


def test_what_is_the_same_on_opposite_sides_moves_little():
    """Swollen ink, unequal blur, a bent grey scale: model errors of 10 % of the contrast and more."""
    for picture in (draw(2, swell=0.3, light=0.0), draw(3, stretch=1.6, light=0.0)):
        found = picture.refine()
        error = picture.error(found)
        assert found.valid.all()
        # The pixels of the window do not lie symmetrically, so a part is left, of which sigma knows.
        assert np.sqrt(np.mean(error**2)) < 0.01 and whitened(picture, found) < 1.0
    bent = draw(5, light=0.0)
    bent = bent._replace(image=255 * (bent.image / 255) ** 0.45)
    assert np.sqrt(np.mean(bent.error(bent.refine()) ** 2)) < 0.01


def test_sigma_is_that_of_the_noise(clean):
    random = np.random.default_rng(6)
    errors, ratios, simple = [], [], []
    for _ in range(8):
        noisy = clean._replace(image=np.rint(clean.image + 3.0 * random.normal(size=clean.image.shape)))
        found = noisy.refine()
        assert found.valid.all()
        errors.append(noisy.error(found))
        ratios.append(whitened(noisy, found))
        start = noisy.start[:, None].astype(np.float32)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
        grey = np.clip(noisy.image, 0, 255).astype(np.uint8)
        simple.append(cv2.cornerSubPix(grey, start, (9, 9), (-1, -1), criteria).reshape(-1, 2) - noisy.truth)
    # 576 errors: their root mean square is known to 3 %; the sigma has a floor for model errors.
    assert 0.87 < np.sqrt(np.mean(np.square(ratios))) < 1.1
    # No bias: the mean of 288 corners against its own standard error.
    error = np.concatenate(errors)
    assert np.abs(error.mean(0)).max() < 4 * error.std() / np.sqrt(len(error))
    assert error.std() < 0.6 * np.std(np.concatenate(simple))


def test_noise_that_neighbours_share_is_seen(clean):
    """Demosaicing and JPEG make one error of several pixels'; taken as white it would be 1.34 and 1.14 sigma."""
    random = np.random.default_rng(7)
    mosaic, packed = [], []
    for _ in range(8):
        raw = np.clip(np.rint(clean.image + 2 * random.normal(size=clean.image.shape)), 0, 255).astype(np.uint8)
        grey = clean._replace(image=cv2.cvtColor(raw, cv2.COLOR_BayerRGGB2GRAY))
        mosaic.append(whitened(grey, grey.refine()))
        bits = cv2.imencode(".jpg", raw, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        jpeg = clean._replace(image=cv2.imdecode(bits, cv2.IMREAD_GRAYSCALE))
        packed.append(whitened(jpeg, jpeg.refine()))
    # 576 errors each: known to 3 %.
    assert 0.9 < np.sqrt(np.mean(np.square(mosaic))) < 1.28
    assert 0.85 < np.sqrt(np.mean(np.square(packed))) < 1.1


def test_what_is_no_corner_is_refused(clean):
    image = clean.image.copy()
    random = np.random.default_rng(8)
    tile = lambda number: (slice(number * TILE, (number + 1) * TILE), slice(0, TILE))
    image[tile(0)] = 100.0
    image[tile(1)] = random.uniform(20, 140, (TILE, TILE))
    image[tile(2)] = np.where(np.arange(TILE) < 18, 20.0, 140.0)[None]
    image[tile(3)] = np.where(np.hypot(*np.mgrid[-18:18, -18:18]) < 5, 20.0, 140.0)
    changed = np.array([0, 6, 12, 18])
    found = clean._replace(image=image).refine()
    assert not found.valid[changed].any()
    np.testing.assert_array_equal(found.q[changed], clean.start[changed])
    assert (found.sigma[changed] == 1.0).all()
    others = np.setdiff1d(np.arange(36), changed)
    assert found.valid[others].all()
    # Edges in another direction than expected belong to something else.
    turned = np.stack([clean.edges[:, 0] + clean.edges[:, 1], clean.edges[:, 0] - clean.edges[:, 1]], 1)
    assert not clean._replace(edges=turned).refine().valid.any()
    nothing = fit_corners(image, np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))
    assert nothing.q.shape == (0, 2)


def test_at_the_border_of_the_image(clean):
    """What is cut off does not count; a corner of which too little is left is refused."""
    for cut, kept in ((14, True), (18, False)):
        part = clean._replace(image=clean.image[cut:], truth=clean.truth - (0, cut), start=clean.start - (0, cut))
        found = part.refine()
        assert (found.valid[:6].mean() > 0.9) == kept
        assert np.abs(part.error(found)).max() < 0.01


def test_markers_in_the_squares_are_left_out(clean):
    """Blots 5 px from both edges pull a corner aside unless they are said to be there."""
    u, v = np.meshgrid(np.arange(TILE * TILES), np.arange(TILE * TILES))
    image = clean.image.copy()
    for place, (first, second) in zip(clean.truth, clean.edges, strict=True):
        away = [np.abs(e[0] * (v - place[1]) - e[1] * (u - place[0])) for e in (first, second)]
        side = (u - place[0]) * (first + second)[0] + (v - place[1]) * (first + second)[1] > 0
        near = np.maximum(np.abs(u - place[0]), np.abs(v - place[1])) < 14
        image[near & side & (np.minimum(*away) > 5)] = 80.0
    spoilt = clean._replace(image=image)
    found = spoilt.refine(clear=np.full(36, 4.0))
    assert found.valid.all() and np.abs(spoilt.error(found)).max() < 0.01
    blind = spoilt.refine()
    assert not blind.valid.all() or np.abs(spoilt.error(blind)).max() > 0.02
