"""Features of a rendered room: followed to hundredths of a pixel round the full turn, with sigmas that are true."""

import numpy as np
import pytest

from jaxscan.recalibration import RecalibrationSettings
from jaxscan.recalibration.tracks import observe_features
from jaxscan.vision import enough_texture, feature_eyes
from tests.vision.painted_room import Rig, paint, pixel, render
from tests.vision.room_capture import Images, stripes_of, true_scanner


pytestmark = pytest.mark.more


RIG = Rig()
ANGLES = np.radians(np.arange(0.0, 390.0, 7.5))
SETTINGS = RecalibrationSettings()


@pytest.fixture(scope="module")
def images():
    rng = np.random.default_rng(1)
    walls = paint(rng, contrast=10.0)
    return [render(RIG, walls, angle, rng, noise=4.0) for angle in ANGLES]


@pytest.fixture(scope="module")
def stored():
    """A scanner that is not the true one."""
    true = true_scanner(RIG)
    names = true.parameter_names()
    step = np.zeros(len(names))
    for name, size in {"fx": 0.1, "cx": -0.2, "gain": 3e-4, "axis.d1": 5e-4, "axis.p1": 3e-4}.items():
        step[names.index(name)] = size
    return true.retract(step)


@pytest.fixture(scope="module")
def tracks(images, stored):
    found, notes = observe_features([Images(images, ANGLES)], [stripes_of(ANGLES)], stored, feature_eyes(), SETTINGS)
    assert notes == ()
    return found


def truth_errors(tracks):
    """Pixels by the renderer's own formulas at the best points, less those that were seen."""
    error = np.zeros_like(tracks.q)
    for number, point in enumerate(tracks.point):
        mine = tracks.track == number
        q, angle = tracks.q[mine], ANGLES[tracks.record[mine]]
        p = frame_of(point)

        def seen(p, angle=angle):
            return np.concatenate([pixel(RIG, p[None], one) for one in angle])

        for _ in range(4):
            gradient = np.stack([(seen(p + d) - seen(p - d)) / 2e-5 for d in 1e-5 * np.eye(3)], -1)
            p = p + np.linalg.lstsq(gradient.reshape(-1, 3), (q - seen(p)).ravel(), rcond=None)[0]
        error[mine] = seen(p) - q
    return error


def frame_of(point):
    """A point of the scanner's frame in the camera's at angle 0."""
    pose = np.asarray(true_scanner(RIG).scanner_from_camera())
    return pose[:3, :3].T @ (point - pose[:3, 3])


@pytest.mark.more
def test_errors_are_as_large_as_their_sigmas_say(tracks):
    error = truth_errors(tracks)
    views = np.bincount(tracks.track)[tracks.track]
    # A point takes three numbers of its track.
    freedom = (2 * views - 3) / (2 * views)
    size = np.sqrt(np.mean(error**2 / (freedom * tracks.sigma**2)[:, None]))
    assert len(tracks.q) > 1000
    # The band that stated and observed noise have to agree in.
    assert 0.9 < size < 1.1
    # Noise of 4 DN and contrasts of 15 DN within pieces of 19 px: the noise over the root of the sum of squared slopes.
    assert np.median(tracks.sigma) < 0.1


@pytest.mark.more
def test_hardly_a_track_is_wrong(tracks):
    size = np.linalg.norm(truth_errors(tracks), axis=1) / tracks.sigma
    worst = np.zeros(len(tracks.point))
    np.maximum.at(worst, tracks.track, size)
    # Six sigmas of one coordinate never happen by chance.
    assert np.mean(worst > 6.0) < 0.01


def test_tracks_go_round_the_full_turn(tracks):
    turn = ANGLES[tracks.record]
    first, last = (np.array([f(turn[tracks.track == k]) for k in range(len(tracks.point))]) for f in (np.min, np.max))
    assert np.count_nonzero(last - first > np.pi) > 20


def test_a_person_walking_by_is_no_track(images, stored, tracks):
    rng = np.random.default_rng(2)
    coat = rng.integers(40, 220, (9, 4)).repeat(10, 0).repeat(10, 1).astype(np.uint8)
    walking = []
    for k, image in enumerate(images):
        image = image.copy()
        # Beside the way of the room's features, which move to the left by some 20 px from image to image.
        left = 60 + 7 * (k % 12)
        image[40:130, left : left + 40] = coat
        walking.append(image)
    found, _ = observe_features([Images(walking, ANGLES)], [stripes_of(ANGLES)], stored, feature_eyes(), SETTINGS)
    left = 60 + 7 * (found.record % 12)
    u, v = found.q.T
    on_coat = (u > left + 3) & (u < left + 37) & (v > 43) & (v < 127)
    assert np.mean(on_coat) < 0.01
    # The coat hides a ninth of every image, and takes its turn with whatever passes behind it.
    assert len(found.q) > 0.15 * len(tracks.q)


def observe(images, scanner, **settings):
    angles = ANGLES[: len(images)]
    return observe_features(
        [Images(images, angles)],
        [stripes_of(angles)],
        scanner,
        feature_eyes(),
        RecalibrationSettings(**settings),
    )


def test_bare_walls_have_no_features(stored):
    rng = np.random.default_rng(4)
    walls = paint(rng, contrast=0.2)
    bare = [render(RIG, walls, angle, rng) for angle in ANGLES[:12]]
    found, notes = observe(bare, stored)
    assert found is None
    assert len(notes) == 1
    assert "too little texture" in notes[0]


def test_texture_is_told_in_words(images):
    enough, reason = enough_texture(images[:4])
    assert enough
    assert "features in an image" in reason
    assert not enough_texture([np.zeros((160, 200), np.uint8)])[0]
    assert not enough_texture([np.zeros((4, 4), np.uint8)])[0]


@pytest.mark.parametrize("count", [1, 12])
def test_black_images_give_a_note(stored, count):
    found, notes = observe([np.zeros((160, 200), np.uint8)] * count, stored, features=True)
    assert found is None
    assert len(notes) == 1


def test_images_of_another_size_give_a_note(images, stored):
    found, notes = observe([image[:100] for image in images[:5]], stored)
    assert found is None
    assert "200 x 100" in notes[0]
    assert "200 x 160" in notes[0]


def test_a_sweep_without_laser_off_images_gives_a_note(images, stored):
    source = Images(images, ANGLES)
    for record in source.records:
        record.off = ()
    found, notes = observe_features([source], [stripes_of(ANGLES)], stored, feature_eyes(), SETTINGS)
    assert found is None
    assert "laser-off" in notes[0]


def test_half_the_steps_per_turn_are_named(images, stored):
    """The journal says twice the angle that the table turned."""
    source = Images(images[:26], ANGLES[:26])
    found, notes = observe_features([source], [stripes_of(2 * ANGLES[:26])], stored, feature_eyes(), SETTINGS)
    assert found is None
    assert "steps per turn" in notes[0] or "overlap" in notes[0]
