"""The stripe on rendered boards of black print: drawn aside by every printed edge, and put right."""

import numpy as np
import pytest

from jaxscan.observation import FoundCorners, FoundStripe, select_board_stripe
from jaxscan.observation.ink import ink_shift
from jaxscan.simulation import (
    BoardsSpec,
    CameraSpec,
    LaserSpec,
    RoomSpec,
    SeenBoard,
    SimulationConfig,
    TurntableSpec,
    develop,
    expect_record,
    make_print,
    make_rig,
    make_scene,
)
from jaxscan.simulation.rig import Motion, distort, rodrigues
from jaxscan.stripes import NoiseModel, StripeSettings, extract_stripes


pytestmark = pytest.mark.more


BOARD = BoardsSpec(type="chessboard", columns=9, rows=7, square_mm=40.0, range_m=(0.6, 1.4))
CONFIG = SimulationConfig(
    camera=CameraSpec(width=640, height=512, fx=900, fy=900, cx=320.0, cy=256.0),
    laser=LaserSpec(baseline_m=0.25, crossing_m=1.0, waist_mm=0.8),
    turntable=TurntableSpec(direction=(0.0, -1.0, 0.0), point_m=(0.1, 0.0, -0.05)),
    room=RoomSpec(furniture=False),
    boards=BOARD,
)
TURNS = [(0.3, 0.1, 0.25), (-0.2, 0.5, -0.4), (0.1, -0.3, 0.7)]
"""In their plane too, so that the stripe meets edges at all slants."""
DRAWS = 4


class Stripe:
    """Stripes of all pictures of one kind, points of the board together."""

    def __init__(self, error, sigma, shift, kept, corrected, total):
        self.error, self.sigma, self.shift, self.kept = error, sigma, shift, kept
        self.corrected, self.total = corrected, total


@pytest.fixture(scope="module")
def stripes():
    rig, scene = make_rig(CONFIG), make_scene(CONFIG)
    y, x = np.mgrid[: BOARD.rows + 1, : BOARD.columns + 1]
    picture = np.kron(((x + y) % 2 * 255).astype(np.uint8), np.ones((60, 60), np.uint8))
    board = BOARD.board()
    middle = board.corners().mean(0)
    views = []
    for number, turn in enumerate(TURNS):
        vector = np.array(turn)
        rotation = rodrigues(vector / np.linalg.norm(vector), float(np.linalg.norm(vector)))
        motion = Motion(rotation, np.array([0.0, 0.0, 0.95]) - rotation @ middle)
        expected = expect_record(rig, scene, 0.0, board=SeenBoard(make_print(BOARD, picture), motion.inverse()))
        p = motion.apply(board.corners())
        corners = np.stack(distort(CONFIG.camera, p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]), -1)
        for draw in range(DRAWS):
            seen = develop(expected, CONFIG, np.random.default_rng([number, draw]))
            views.append((seen.on, seen.off, expected.truth.u, corners))
    sensor = CONFIG.sensor
    noise = NoiseModel(read_dn=sensor.read_dn, electrons_per_dn=sensor.electrons_per_dn)
    # As on boards, where the ink is known and corrected: the sigma is that of noise alone.
    settings = StripeSettings(guard_edges=False, learn_width=False)
    on, off = (np.stack([view[k] for view in views]) for k in (0, 1))
    found = extract_stripes(on, off, noise=noise, settings=settings)
    parts = [[] for _ in range(5)]
    kept = 0
    for row, (_, off, truth, corners) in enumerate(views):
        u, sigma, valid, width = (np.asarray(getattr(found, name))[row] for name in ("u", "sigma", "valid", "width"))
        seen = FoundCorners(corners, np.ones(len(corners)), np.ones(len(corners), bool))
        stripe = FoundStripe(u, sigma, width, valid)
        all_points = select_board_stripe(stripe, seen, board)
        line = all_points.q[all_points.valid, 1].astype(int)
        error = u[line].astype(float) - truth[line]
        # Errors of whole pixels are not from ink; the solve rejects them.
        line = line[np.abs(error) < 3.0]
        ink = ink_shift(off, line, u[line].astype(float), width[line].astype(float), CONFIG.sensor.psf_px)
        chosen = select_board_stripe(stripe, seen, board, off=off)
        kept += chosen.valid.sum()
        for part, values in zip(
            parts,
            (u[line] - truth[line], sigma[line], ink.predicted, ink.correction, np.hypot(sigma[line], ink.sigma)),
            strict=True,
        ):
            part.append(np.asarray(values, float))
    error, sigma, shift, correction, total = (np.concatenate(part) for part in parts)
    return Stripe(error, sigma, shift, kept, error - correction, total)


def towards_bright(z, stripes, part):
    """Mean pull towards the brighter side, in standard deviations."""
    return float(np.mean((z * np.sign(stripes.shift))[part]))


@pytest.mark.more
def test_unguarded_every_edge_pulls_by_many_times_the_noise(stripes):
    near = (np.abs(stripes.shift) > 0.1) & (np.abs(stripes.shift) < 0.35)
    assert near.mean() > 0.08
    # Measured: 3.6 standard deviations on average; it is not noise.
    assert towards_bright(stripes.error / stripes.sigma, stripes, near) > 2.5
    assert np.sqrt(np.mean((stripes.error / stripes.sigma) ** 2)) > 1.8


@pytest.mark.more
def test_corrected_it_is_noise_again(stripes):
    use = np.abs(stripes.shift) <= 0.35
    z = stripes.corrected / stripes.total
    # Of 3700 points the mean is known to 0.016; its limit is a tenth of a standard deviation.
    assert abs(z[use].mean()) < 0.1
    assert abs(towards_bright(z, stripes, use)) < 0.1
    assert 0.9 < np.sqrt(np.mean(z[use] ** 2)) < 1.1
    # Close beside an edge, where each point was pulled by several of its standard deviations, a
    # third of one is left.
    near = use & (np.abs(stripes.shift) > 0.1)
    assert abs(towards_bright(z, stripes, near)) < 0.4
    assert np.sqrt(np.mean(z[near] ** 2)) < 1.3


def test_nearly_all_points_are_kept(stripes):
    """Dropping the points that the print could move by 0.05 px would leave three quarters."""
    assert stripes.kept > 0.93 * len(stripes.error)


def test_even_paper_moves_nothing():
    line = np.arange(40, 200)
    random = np.random.default_rng(0)
    centre, width = random.uniform(100, 200, 160), np.full(160, 1.5)
    for level in (8.0, 100.0):
        grey = level + random.normal(size=(256, 320))
        ink = ink_shift(np.clip(np.rint(grey), 0, 255).astype(np.uint8), line, centre, width, 0.8)
        # Noise of 0.6 DN in 8 is worth 0.1 px, of which the correction keeps little.
        assert np.sqrt(np.mean(ink.correction**2)) < (0.06 if level < 10 else 2e-4)


def test_a_stripe_no_wider_than_the_blur_shows_no_print():
    """Light that falls on one spot takes that spot's brightness, wherever the edge is."""
    image = np.where(np.arange(320) < 150, 10.0, 100.0) * np.ones((64, 1))
    line = np.arange(10, 50)
    centre = 150 + np.linspace(-2, 2, 40)
    narrow, wide = (ink_shift(image, line, centre, np.full(40, w), 0.8).predicted for w in (0.8, 2.0))
    np.testing.assert_allclose(narrow, 0.0, atol=1e-6)
    # Brighter on the right: all are drawn to the right, the more the nearer.
    assert wide.min() > 0 and wide.max() > 0.5
