"""First poses of stations: rooms of boxes whose stripes are exact, seen from known places."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.api import recalibration as module
from jaxscan.api.stages import Stage, Stages
from jaxscan.calibration import Calibration
from jaxscan.errors import CalibrationError, GivenError
from jaxscan.files.capture import Capture
from jaxscan.geometry import invert, poses, transform
from jaxscan.recalibration import RecalibrationSettings, SweepStripes, Tracks, register
from jaxscan.recalibration.stations import place_stations
from tests.recalibration.faces import box, pose, solid, take, wide_rig


pytestmark = pytest.mark.more


SCANNER = wide_rig()
EMPTY = box(0.0, 4.2, 0.0, 5.4, 0.0, 2.5)
FURNITURE = (
    ((0.0, 1.0, 0.0), (0.85, 3.0, 0.75)),  # sofa
    ((3.8, 3.2, 0.0), (4.2, 4.4, 2.0)),  # shelf
    ((1.6, 4.8, 0.0), (2.6, 5.4, 0.8)),  # chest
    ((3.0, 0.0, 0.0), (3.9, 0.6, 1.9)),  # cupboard
    ((0.0, 4.4, 1.2), (0.03, 5.2, 1.8)),  # picture
)
FURNISHED = [*EMPTY, *(face for corners in FURNITURE for face in solid(*corners))]
L_SHAPED = [*EMPTY, *solid((2.6, 3.4, 0.0), (4.2, 5.4, 2.5)), *solid((0.0, 0.6, 0.0), (0.5, 1.8, 0.9))]
PLACES = (pose((2.0, 2.6, 1.2), 50.0), pose((1.4, 3.9, 1.15), 200.0, (1.5, -1.0)), pose((3.2, 1.6, 1.3), -70.0))
# First values: a few centimetres and a degree are asked, and walls that both see give far better.
NEAR_M, NEAR_RAD = 0.01, np.radians(0.2)


def sweep_of(room: list, T: np.ndarray, station: int = 0, seed: int | None = None) -> SweepStripes:
    seed = station if seed is None else seed
    return take(room, SCANNER, steps=120, noise_px=0.1, seed=seed, pose=T, station=station).sweep


def sweeps_of(room: list, places) -> list[SweepStripes]:
    return [sweep_of(room, T, k) for k, T in enumerate(places)]


def calibration() -> Calibration:
    """The rig, each parameter known to 1e-5 of its unit."""
    names, sigma = SCANNER.parameter_names(), np.full(len(SCANNER.parameter_names()), 1e-5)
    scanner = replace(SCANNER, covariance=np.diag(sigma**2))
    return Calibration(scanner.camera, scanner, names, np.asarray(scanner.covariance))


def assert_near(found, truth):
    assert np.linalg.norm(found[:3, 3] - truth[:3, 3]) < NEAR_M
    turn = found[:3, :3].T @ truth[:3, :3]
    assert np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) < NEAR_RAD


@pytest.mark.parametrize("room", [FURNISHED, L_SHAPED], ids=["furnished", "L"])
def test_two_stations_are_placed_by_what_both_see(room):
    first, second = PLACES[0], PLACES[2]
    found = place_stations(sweeps_of(room, (first, second)), SCANNER)
    assert found.shape == (2, 4, 4) and np.array_equal(found[0], np.eye(4))
    assert_near(found[1], np.linalg.inv(first) @ second)


def test_registered_stations_are_where_they_stood_within_their_sigmas():
    """Poses to a tenth of a millimetre, by walls alone; of the solves of a recalibration one or two are left."""
    (first, second), stages = PLACES[:3:2], []
    found = register(
        sweeps_of(FURNISHED, (first, second)),
        calibration(),
        RecalibrationSettings(stations=True),
        progress=lambda done, total: stages.append((done, total)),
    )
    truth = np.linalg.inv(first) @ second
    assert found.converged and stages == [(k, 4) for k in range(1, 5)]
    away = np.linalg.inv(truth) @ found.stations[1]
    step = np.array([*away[:3, 3], away[2, 1], away[0, 2], away[1, 0]])
    known = np.sqrt(np.diag(found.station_covariance[1]))
    assert np.all(known[:3] < 1e-3) and np.all(np.abs(step) < 4 * known)


@pytest.mark.more
def test_three_stations_form_a_tree_and_sweeps_of_one_place_share_its_pose():
    sweeps = sweeps_of(FURNISHED, PLACES)
    again = sweep_of(FURNISHED, PLACES[1], seed=7, station=1)
    found = place_stations([*sweeps, again], SCANNER)
    for T, truth in zip(found[1:], PLACES[1:], strict=True):
        assert_near(T, np.linalg.inv(PLACES[0]) @ truth)


def test_one_station_is_the_room():
    assert np.array_equal(place_stations(sweeps_of(EMPTY, PLACES[:1]), SCANNER), np.eye(4)[None])


@pytest.fixture(scope="module")
def empty():
    """Two stations of an empty box, which fits itself at 180 degrees; and the pose of the second."""
    return sweeps_of(EMPTY, PLACES[:2]), np.linalg.inv(PLACES[0]) @ PLACES[1]


def test_an_empty_box_is_ambiguous(empty):
    with pytest.raises(
        CalibrationError, match=r"^sweep 0, sweep 1: found two places .* 180 degrees apart; leave targets"
    ):
        place_stations(empty[0], SCANNER)


def test_a_first_pose_is_settled_on_the_walls(empty):
    start = empty[1] @ pose((0.2, -0.15, 0.1), 4.0)
    assert_near(place_stations(empty[0], SCANNER, start={1: start})[1], empty[1])


@pytest.fixture(scope="module")
def marks(empty):
    """Marks on two walls, seen as pixels from both stations; one was moved between the sweeps."""
    world = np.array([[4.2, 2.0, 1.0], [4.2, 3.4, 1.5], [2.0, 5.4, 0.9], [1.2, 5.4, 1.6], [0.0, 3.0, 1.2]])
    camera, rows = SCANNER.camera, []
    for station, T in enumerate(PLACES[:2]):
        marks = world + (np.arange(5) == 4)[:, None] * station * np.array([0, 0.6, 0])
        for record, phi in enumerate(empty[0][station].angle):
            x, y, z = transform(invert(poses(SCANNER.rig, phi)), transform(invert(T), marks)).T
            q = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1)
            seen = (z > 0.1) & (np.abs(x) < 0.6 * z) & (np.abs(y) < 0.5 * z)
            rows += [(q[k], station, record, k) for k in np.flatnonzero(seen)]
    q, sweep, record, track = (np.array(column) for column in zip(*rows, strict=True))
    names = tuple(f"marker {k}" for k in range(5))
    return Tracks(q, np.full(len(q), 0.1), sweep, record, track, np.zeros((5, 3)), names)


def test_targets_by_name_place_a_station(empty, marks):
    assert_near(place_stations(empty[0], SCANNER, tracks=marks)[1], empty[1])
    # Without names nobody knows that they are the same.
    with pytest.raises(CalibrationError, match="two places"):
        place_stations(empty[0], SCANNER, tracks=marks._replace(name=()))


class UnreadCapture(Capture):
    """A capture whose images nobody reads."""

    image_size, journal = (640, 512), ()

    def __init__(self):
        pass


def test_targets_are_looked_for_where_walls_leave_a_station_open(empty, marks, monkeypatch):
    """What is looked at is exact; all that follows from it is done as `jaxscan register` does it."""
    known, captures = calibration(), [UnreadCapture() for _ in empty[0]]
    asked = []
    monkeypatch.setattr(module, "with_stops", lambda settings, captures: settings)
    monkeypatch.setattr(module, "_check_captures", lambda *_: None)
    monkeypatch.setattr(module, "plan_sweep", lambda *_: None)
    monkeypatch.setattr(module, "_stages", lambda *_, **__: Stages(None, (Stage(1.0),)))
    monkeypatch.setattr(module, "_swept", lambda *_: (empty[0], []))

    def look(captures, sweeps, *_):
        asked.append([one.name for one in sweeps])
        return seen, ("looked",)

    monkeypatch.setattr(module.recalibration, "observe_features", look)
    seen = marks
    found, notes = module.register(captures, known)
    away = np.linalg.inv(empty[1]) @ found.stations[1]
    sigma_m = np.sqrt(np.diag(found.station_covariance[1])[:3])
    # Walls and marks know it to a millimetre; the covariance says so.
    assert found.converged and np.all(sigma_m < 2e-3) and np.all(np.abs(away[:3, 3]) < 4 * sigma_m)
    assert notes == ("looked",) and asked == [[one.name for one in empty[0]]]
    # Without any, the walls' own refusal stands, with its remedy.
    seen = None
    with pytest.raises(CalibrationError, match=r"two places .* leave targets"):
        module.register(captures, known)


def test_stations_of_two_rooms_are_refused():
    sweeps = [sweep_of(FURNISHED, PLACES[0]), sweep_of(box(0, 3.0, 0, 7.4, 0, 2.9), pose((1.5, 3.0, 1.2), 10.0), 1)]
    with pytest.raises(CalibrationError, match=r"^sweep 0, sweep 1: found no place .* take a sweep between the two"):
        place_stations(sweeps, SCANNER)


def test_a_place_without_walls_is_refused(empty):
    blind = empty[0][0]._replace(valid=np.zeros_like(empty[0][0].valid))
    with pytest.raises(CalibrationError, match=r"^sweep 0: found 0 flat patches, too few"):
        place_stations([blind, empty[0][1]], SCANNER)


def test_numbers_of_stations_have_no_gap(empty):
    with pytest.raises(CalibrationError, match=r"^stations: found the numbers \[0, 2\], expected 0 to 1"):
        place_stations([empty[0][0], empty[0][1]._replace(station=2)], SCANNER)


@pytest.mark.parametrize("off", [pose((0.8, 0, 0), 0), pose((0, 0.8, 0), 0), pose((5, 0, 0), 0), pose((0, 0, 0), 90)])
def test_a_first_pose_that_is_wrong_is_refused(empty, off):
    with pytest.raises(GivenError, match=r"^sweep 1: its given place \(\[\[station\]\] of --known\) is contradicted"):
        place_stations(empty[0], SCANNER, start={1: empty[1] @ off})
