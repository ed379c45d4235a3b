"""A recalibration from end to end: exact stripes of a known room with noise, and stored calibrations that are wrong."""

from functools import lru_cache

import jax
import numpy as np
import pytest

from experiments.recalibration.world import Noise, Sweeping, sweep_of, true_sweep, turn_laser
from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError, GivenError
from jaxscan.recalibration import (
    Given,
    KnownLength,
    MeasuredLength,
    RecalibrationSettings,
    Start,
    Surfaces,
    Tracks,
    recalibrate,
)
from jaxscan.recalibration.lengths import _between_centres, check_lengths, found_lengths, lost_lengths, place_lengths

from .linear_room import GOOD
from .small_room import SIGMA, config, exact_sweep, observe, stored, truth_scanner, with_covariance


SETTINGS = RecalibrationSettings(points=5_000)


def calibration_of(scanner):
    return Calibration(scanner.camera, scanner, scanner.parameter_names(), np.asarray(scanner.covariance))


def good():
    return calibration_of(with_covariance(truth_scanner(), np.diag(GOOD**2)))


# Noise that is independent from line to line, and no more lines than are used.
HOW = Sweeping(steps=180, line_stride=24, furniture=False, noise=Noise(px=0.1, shared_lines=1))


@lru_cache(maxsize=4)
def sweep(laser_deg=0.0):
    return sweep_of(turn_laser(config(), laser_deg, 3) if laser_deg else config(), 5, HOW)


@pytest.fixture(scope="module")
def poor():
    """From a poor calibration, with the calls of progress."""
    calls = []
    calibration = calibration_of(stored(truth_scanner(), np.random.default_rng(11)))
    result = recalibrate([sweep()], calibration, SETTINGS, progress=lambda done, total: calls.append((done, total)))
    return calibration, result, calls


@pytest.fixture(scope="module")
def drifted():
    """From a good calibration whose laser has turned by 0.05 degrees since."""
    return recalibrate([sweep(0.05)], good(), SETTINGS)


@pytest.mark.more
def test_a_poor_calibration_becomes_better(poor):
    calibration, result, _ = poor
    assert result.updated and not result.refused and result.hold_out is not None and result.hold_out.better
    assert not result.drift.drifted and result.drift.p > 1e-3
    error = truth_scanner().departure(result.scanner)
    before = truth_scanner().departure(calibration.scanner)
    sigma = np.sqrt(np.diag(np.asarray(result.scanner.covariance)))
    free = sigma > 0
    # 21 normal numbers, partly alike: none beyond 4 sigmas, which happens once in a thousand times.
    assert np.abs(error[free] / sigma[free]).max() < 4.0
    gain = result.scanner.parameter_names().index("gain")
    assert abs(error[gain]) < 0.2 * abs(before[gain]) and sigma[gain] < 0.2 * np.sqrt(
        calibration.covariance[gain, gain]
    )
    assert [each.name for each in result.gains[:2]] == ["radial scale", "height scale"]
    assert result.gains[-1].factor > 20.0
    assert any(line.startswith("height scale") for line in result.unobserved)


@pytest.mark.more
def test_the_stored_calibration_is_not_touched(poor):
    calibration, result, _ = poor
    assert result.adjusted.prior is calibration.scanner and result.scanner is not calibration.scanner
    again = stored(truth_scanner(), np.random.default_rng(11))
    np.testing.assert_array_equal(calibration.scanner.covariance, again.covariance)


def test_walls_become_flat_in_the_panorama(poor):
    _, result, _ = poor
    (panorama,) = result.panoramas
    assert panorama.seen.mean() > 0.02 and panorama.before.shape == panorama.after.shape
    before, after = (np.sqrt(np.mean(image[panorama.seen] ** 2)) for image in (panorama.before, panorama.after))
    assert after < 0.8 * before


def test_progress_ends_at_its_end(poor):
    calls = poor[2]
    assert calls == [(k, len(calls)) for k in range(1, len(calls) + 1)]


@pytest.mark.more
def test_a_laser_that_turned_is_found_and_put_right(drifted):
    assert drifted.updated and drifted.drift.drifted and drifted.drift.p < 1e-3
    assert "laser red" in drifted.drift.part and "degrees" in drifted.drift.size
    from jaxscan.simulation.sweep import true_scanner

    truth = true_scanner(turn_laser(config(), 0.05, 3))
    error, names = truth.departure(drifted.scanner), truth.parameter_names()
    places = [names.index(f"laser.red.{name}") for name in ("n1", "n2", "d")]
    sigma = np.sqrt(np.diag(np.asarray(drifted.scanner.covariance)))[places]
    # Three numbers within 3.3 sigmas: 997 times in a thousand.
    assert np.abs(error[places] / sigma).max() < 3.3
    assert max(drifted.hold_out.after_mm) < 0.7 * max(drifted.hold_out.before_mm)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"centre": np.zeros((360, 700))}, "has stripes on 700 rows, the calibration is for images of 2048 x 1638 px"),
        ({"laser": np.ones(180, int)}, "has 2 lasers, the calibration 1"),
        ({"valid": np.zeros((180, 1638), bool)}, "found no plane|no plane"),
    ],
)
def test_sweeps_that_cannot_be_used_are_refused_in_one_line(change, said):
    with pytest.raises(CalibrationError, match=said) as problem:
        recalibrate([sweep()._replace(**change)], good(), SETTINGS)
    assert "\n" not in str(problem.value)


def test_what_is_missing_is_told():
    with pytest.raises(CalibrationError, match="No sweep was given"):
        recalibrate([], good())
    with pytest.raises(CalibrationError, match="found 3 poses, expected one for each of 1"):
        recalibrate([sweep()], good(), SETTINGS, Given(stations=np.tile(np.eye(4), (3, 1, 1))))


@pytest.mark.timeout(600)
def test_one_wall_updates_nothing():
    seen, truth = true_sweep(config(), 5, HOW)
    calibration = good()
    result = recalibrate([seen._replace(valid=seen.valid & (truth.surface == 0))], calibration, SETTINGS)
    assert not result.updated and result.scanner is calibration.scanner
    assert "the planes found face 1 direction, expected at least 2" in result.refused and "\n" not in result.refused


def test_a_sweep_of_another_rig_is_refused():
    """Its laser stands 3 degrees elsewhere."""
    other = true_sweep(turn_laser(config(), 3.0, 3), 5, HOW)[0]
    with pytest.raises(CalibrationError, match="found no plane, expected flat walls") as problem:
        recalibrate([other], good(), SETTINGS)
    assert "\n" not in str(problem.value)


def test_known_lengths_find_their_walls():
    scanner = truth_scanner()
    observed = observe(scanner)
    start = Start(scanner, np.eye(4)[None])
    ends = [observed.surfaces.centre[k] for k in (0, 1)]
    near = MeasuredLength(3.82, 1e-3, ends[0] + 0.02, ends[1], "across")
    assert place_lengths([near], observed, start) == ((3.82, 1e-3, "surfaces", 0, 1),)
    normal = observed.surfaces.normal[0]
    beside = observed.surfaces.centre[int(np.argmin(np.abs(observed.surfaces.normal @ normal)))]
    for change, said in (
        ({"first": np.array([0.0, 0.0, 9.0])}, "across: no surface within"),
        ({"first": ends[1]}, "both ends are on one"),
        ({"first": "marker 7"}, "one end is a target"),
        ({"first": "marker 7", "second": "marker 8"}, "no target is called marker 7; found none"),
        ({"first": ends[0] + 0.2 * normal}, "across: found an end 20 cm off the plane"),
        ({"second": beside}, "across: its ends lie on walls at 90 degrees to each other"),
    ):
        with pytest.raises(CalibrationError, match=said):
            place_lengths([near._replace(**change)], observed, start)


def test_a_length_is_that_between_the_points_of_the_user():
    """Walls 3 mrad from parallel are 3 mm farther apart a metre aside."""
    normal = np.array([[1.0, 0.0, 0.0], [np.cos(3e-3), np.sin(3e-3), 0.0]])
    centre = np.array([[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]])
    surfaces = Surfaces(normal, (normal * centre).sum(1), centre)
    aside = MeasuredLength(4.003, 1e-3, np.array([2.0, 1.0, 0.0]), np.array([-2.003, 1.0, 0.0]))
    assert _between_centres(aside, surfaces, (0, 1)) == pytest.approx(4.0, abs=2e-5)


def test_a_length_on_a_wall_that_is_not_flat_is_told():
    lengths = [KnownLength(3.82, 1e-3, "surfaces", 0, 1), KnownLength(2.5, 1e-3, "surfaces", 2, 3)]
    (said,) = lost_lengths([*lengths, KnownLength(1.0, 1e-3, "tracks", 0, 1)], [1, 2, 3])
    assert said.startswith("known length 1 (3.82 m) is left out")


def facing_walls(observed, sweeps, scanner):
    """Two walls that face each other as a known length, true to 1 mm."""
    pairs = np.argwhere(np.triu(np.abs(observed.surfaces.normal @ observed.surfaces.normal.T) > 0.99, 1))
    known = KnownLength(1.0, 1e-3, "surfaces", *pairs[0].tolist())
    (found,) = found_lengths(observed._replace(lengths=(known,)), sweeps, scanner)
    return known._replace(metres=found.found_m)


def test_a_length_that_the_stored_calibration_contradicts_is_refused():
    truth, sweeps = truth_scanner(), [exact_sweep()[0]]
    good = with_covariance(truth, np.diag(GOOD**2))
    observed = observe(truth)
    known = facing_walls(observed, sweeps, truth)
    a, b = observed.surfaces.normal[known.first], observed.surfaces.normal[known.second]
    exact = abs(observed.surfaces.distance[known.first] - np.sign(a @ b) * observed.surfaces.distance[known.second])
    assert known.metres == pytest.approx(exact, abs=1e-6)
    given = lambda metres: observed._replace(lengths=(known._replace(metres=metres),))
    poor = with_covariance(truth, np.diag((5 * SIGMA) ** 2))
    assert check_lengths(given(exact + 2e-3), sweeps, good, good) == []
    with pytest.raises(CalibrationError, match=r"known length 1: found .* if the rig was knocked") as problem:
        check_lengths(given(exact - 0.54), sweeps, good, good)
    assert "\n" not in str(problem.value)
    # A length that a good calibration contradicts may be true if the rig was knocked: it is told.
    (note,) = check_lengths(given(exact + 0.05), sweeps, good, poor)
    assert note.endswith("if the rig was not knocked, measure it again")
    assert check_lengths(given(exact + 0.05), sweeps, poor, poor) == []


@pytest.mark.more
@pytest.mark.parametrize(
    ("laser_deg", "said"),
    [
        (0.0, "found 3.820. m by the stored calibration, expected 3.7200 m .* the sweeps show no drift"),
        (0.05, "found 3.82.. m by these sweeps, expected 3.7(200|199) m within"),
    ],
)
def test_a_wrong_length_does_not_bend_the_calibration(laser_deg, said):
    """By 0.1 m; a rig that was knocked in any way would explain it."""
    surfaces = observe(truth_scanner()).surfaces
    pairs = np.argwhere(np.triu(np.abs(surfaces.normal @ surfaces.normal.T) > 0.99, 1))
    given = Given(lengths=(MeasuredLength(3.72, 1e-3, *(surfaces.centre[k] for k in pairs[0])),))
    with pytest.raises(GivenError, match=f"known length 1: {said}"):
        recalibrate([sweep(laser_deg)], good(), SETTINGS, given)


def test_a_length_between_targets_is_compared_too():
    truth, sweeps = truth_scanner(), [exact_sweep()[0]]
    observed = observe(truth)
    point = np.array([[2.0, 0.3, 0.1], [1.9, -0.4, 0.2]])
    rows = [(k, record, pixel) for k in range(2) for record, pixel in sightings_of(truth, sweeps[0].angle, point[k])]
    assert len(rows) > 12
    track, record = (np.array([row[k] for row in rows]) for k in range(2))
    q, none = np.array([row[2] for row in rows]), np.zeros(len(rows), int)
    tracks = Tracks(q, np.full(len(q), 0.05), none, record, track, point, ("marker 1 corner 1", "marker 2 corner 1"))
    exact = float(np.linalg.norm(point[0] - point[1]))
    good = with_covariance(truth, np.diag(GOOD**2))
    given = lambda metres: observed._replace(tracks=tracks, lengths=(KnownLength(metres, 1e-4, "tracks", 0, 1),))
    (found,) = found_lengths(given(exact), sweeps, truth)
    assert found.found_m == pytest.approx(exact, abs=1e-5)
    assert check_lengths(given(exact), sweeps, good, good) == []
    with pytest.raises(CalibrationError, match="known length 1: found"):
        check_lengths(given(exact + 0.2), sweeps, good, good)


def sightings_of(scanner, angles, point):
    """Record and pixel of every image that sees a point of the room."""
    with jax.enable_x64(True):
        poses = np.asarray(jax.vmap(scanner.pose)(np.asarray(angles, np.float64)))
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], point - poses[:, :3, 3])
        seen = np.flatnonzero((local[:, 2] > 0.3) & (np.hypot(*local[:, :2].T) < 0.4 * local[:, 2]))
        pixels = np.asarray(jax.vmap(scanner.camera.project)(local[seen]))
    return list(zip(seen.tolist(), pixels, strict=True))
