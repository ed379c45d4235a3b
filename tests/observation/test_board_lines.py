"""Rendered boards on which another line is brighter than the laser's."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from jaxscan.geometry import Chessboard
from jaxscan.observation import FoundCorners, SeenRecord
from jaxscan.observation.board_stripes import find_stripes
from jaxscan.stripes import LaserLine, finest_steps, join_levels, split_levels


@dataclass(frozen=True)
class Record:
    i: int = 0
    angle: float | None = None
    placement: int | None = None
    lasers: tuple[int, ...] = (0,)
    on: tuple[str, ...] = ("on",)
    off: tuple[str, ...] = ("off",)


class Source:
    path, records, pixel_format, response, image_size = "boards", (), "mono8", "linear", (480, 384)
    compression = None
    lasers, up, carries, poses = (LaserLine(colour="red"),), "-v", None, None

    def __init__(self, bits=8):
        self.bits = bits

    def frames(self, index):
        raise NotImplementedError


@pytest.fixture(scope="module")
def boards(world):
    """A small camera, and eight boards with the laser's line."""
    rig = world.Rig(
        focal=(450.0, 450.0), centre=(239.5, 191.5), size=(480, 384), board=Chessboard(9, 7, 0.04), distances=(0.2,)
    )
    observed = world.observe(rig, free=8, placements=0, points=300, seed=2)
    assert len(observed.stripes.view) == 8
    return rig, observed


def render(rig, lines, random, light=1.0, bits=8):
    """A pair of frames with lines [(points (u, v), brightness, half width)] on even paper, or in less light on paper
    that is lit unevenly; of more than 8 bits their levels.
    """
    width, height = rig.size
    off = np.full((height, width), 60.0)
    if light < 1:
        off = off * np.linspace(0.6, 1.4, width)
    on = off.copy()
    for q, brightness, half_width in lines:
        order = np.argsort(q[:, 1])
        rows = np.arange(height)
        u = np.interp(rows, q[order, 1], q[order, 0])
        inside = (rows > q[:, 1].min()) & (rows < q[:, 1].max())
        on += inside[:, None] * brightness * np.exp(-0.5 * ((np.arange(width) - u[:, None]) / half_width) ** 2)

    def noisy(image):
        steps = 1 << bits - 8
        seen = light * image + light**0.5 * random.normal(size=image.shape)
        samples = np.clip(np.rint(steps * seen), 0, 256 * steps - 1)
        if bits == 8:
            return samples.astype(np.uint8)
        return np.stack([level for level, _ in split_levels(samples.astype(np.uint16), bits)])

    return noisy(on), noisy(off)


def look(boards, draw, seed, light=1.0, bits=8):
    rig, observed = boards
    random = np.random.default_rng(seed)
    views, truth = [], []
    for view, q in enumerate(observed.corners.q):
        true = observed.stripes.q[view][observed.stripes.valid[view]]
        on, off = render(rig, [(true, 60.0, 1.3), *draw(random, q, true)], random, light, bits)
        corners = FoundCorners(q, np.full(len(q), 0.1), np.ones(len(q), bool))
        grey = off if bits == 8 else (join_levels(off, bits) / finest_steps(bits)).astype(np.float32)
        views.append(SeenRecord(0, Record(view), on, off, grey, corners))
        truth.append(true)
    return find_stripes(views, Source(bits), Source.lasers, rig.board, {}), truth


def beside(stripe, true):
    """Distances across the rows of the points of a stripe from a line [n], px."""
    order = np.argsort(true[:, 1])
    q = stripe.q[stripe.valid]
    return np.abs(q[:, 0] - np.interp(q[:, 1], true[order, 1], true[order, 0]))


def crossing(random, corners, _):
    """A brighter straight line across the whole board, from its upper edge to its lower one."""
    grid = corners.reshape(7, 9, 2)
    top, bottom = (grid[row, 0] + random.uniform(0.1, 0.9) * (grid[row, -1] - grid[row, 0]) for row in (0, -1))
    t = np.linspace(-0.3, 1.3, 100)[:, None]
    return [(top + t * (bottom - top), 150.0, 1.3)]


@pytest.mark.more
def test_a_brighter_line_leaves_the_lasers_line_among_those_found(boards):
    views, truth = look(boards, crossing, 0)
    for view, true in zip(views, truth, strict=True):
        assert len(view.stripes) >= 2
        best = min(view.stripes, key=lambda stripe, true=true: np.median(beside(stripe, true)))
        # Where the lines cross, points of one are drawn to the other.
        assert np.median(beside(best, true)) < 0.1 and best.valid.sum() > 60


def test_an_even_board_gives_one_line_with_all_points(boards):
    views, truth = look(boards, lambda *_: [], 1)
    for view, true in zip(views, truth, strict=True):
        (stripe,) = view.stripes
        assert beside(stripe, true).max() < 0.6
        assert stripe.valid.sum() > 0.95 * (np.ptp(true[:, 1]) * 0.9)


def test_a_faint_line_gains_by_bits(boards):
    """A line of 3 DN on paper of 3 DN, with noise of 0.22 DN: in 8 bits there is their rounding too, 0.29 DN."""
    rms = {}
    for bits in (8, 12):
        views, truth = look(boards, lambda *_: [], 4, light=0.05, bits=bits)
        off = np.concatenate([beside(view.stripes[0], true) for view, true in zip(views, truth, strict=True)])
        sigma = np.concatenate([view.stripes[0].sigma[view.stripes[0].valid] for view in views])
        rms[bits] = np.sqrt(np.mean(off**2))
    # 0.22 over 0.36 DN is 0.61.
    assert rms[12] < 0.7 * rms[8]
    assert 0.9 < np.sqrt(np.mean((off / sigma) ** 2)) < 1.15


def test_pieces_of_other_light_do_not_bend_the_line(boards):
    """Short bright pieces beside the line, on a third of its rows: a path over the rows goes astray on them."""

    def pieces(random, _, true):
        low, high = true[:, 1].min(), true[:, 1].max()
        start = random.uniform(low, low + 0.6 * (high - low))
        v = np.linspace(start, start + 0.33 * (high - low), 50)
        u = np.interp(v, *true[np.argsort(true[:, 1])].T[::-1]) + random.uniform(12, 25)
        return [(np.column_stack([u, v]), 180.0, 1.3)]

    views, truth = look(boards, pieces, 2)
    for view, true in zip(views, truth, strict=True):
        first = view.stripes[0]
        assert beside(first, true).max() < 3.0 and first.valid.sum() > 0.6 * np.ptp(true[:, 1])


def test_few_corners_and_a_strong_lens_do_not_break_the_line(world):
    """Twelve corners make no cubic: the map errs by pixels, and knows it."""
    board = Chessboard(4, 3, 0.09)
    rig = world.Rig(
        focal=(450.0, 450.0), centre=(239.5, 191.5), size=(480, 384), lens=(-0.25, 0.08, 0.0, 0.0, 0.0), board=board
    )
    observed = world.observe(rig, free=8, placements=0, points=300, seed=2)
    views, truth = look((rig, replace(observed)), lambda *_: [], 3)
    for view, true in zip(views, truth, strict=True):
        (stripe,) = view.stripes
        assert stripe.valid.sum() > 0.9 * (np.ptp(true[:, 1]) * 0.9)
