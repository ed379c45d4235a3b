"""Outlines of rooms of any shape: exact without noise, honest sigmas with it, and what is in the walls."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxscan
from jaxscan.errors import MeasurementError
from jaxscan.measurement import find_openings, measure_outline

from .rooms import AT, CUPBOARD, DOOR, HEIGHT, L_SHAPE, WINDOW, seen_room


LENGTHS = [float(np.linalg.norm(b - a)) for a, b in zip(np.array(L_SHAPE), np.roll(L_SHAPE, -1, 0), strict=True)]
SLANTED = ((0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (3.5, 4.5), (0.0, 4.5))


def in_order(room, corners):
    """Lengths of the outline, beginning at the corner of the truth that is nearest the lower left of the plan."""
    points = np.array(corners)
    found = [each.value for each in room.lengths(1.0)[0]]
    truth = [float(np.linalg.norm(b - a)) for a, b in zip(points, np.roll(points, -1, 0), strict=True)]
    shifts = [np.roll(truth, -i) for i in range(len(truth))]
    return found, min(shifts, key=lambda each: np.abs(each - found).max() if len(found) == len(each) else np.inf)


@pytest.mark.parametrize("corners", [L_SHAPE, SLANTED, L_SHAPE[:2] + ((6.0, 5.0), (0.0, 5.0))])
def test_without_noise_it_is_exact(corners):
    room = measure_outline(seen_room(corners, noise=0.0))
    found, truth = in_order(room, corners)
    # Float32 points at 5 m, averaged over thousands.
    np.testing.assert_allclose(found, truth, atol=2e-5)
    points = np.array(corners)
    after = np.roll(points, -1, 0)
    area = 0.5 * abs(np.sum(points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]))
    assert room.floor_area().value == pytest.approx(area, abs=1e-4)
    assert room.volume().value == pytest.approx(area * HEIGHT, abs=5e-4)
    assert room.height().value == pytest.approx(HEIGHT, abs=1e-5)
    for i, length in enumerate(found):
        assert room.wall_area(0, i).value == pytest.approx(length * HEIGHT, abs=2e-4)
    assert room.closed


@pytest.mark.more
def test_sigmas_are_honest():
    """Lengths, areas and the volume of 8 draws: 9 numbers each."""
    whitened = []
    for seed in range(8):
        room = measure_outline(seen_room(grid=(180, 60), noise=4e-3, seed=seed))
        _, truth = in_order(room, L_SHAPE)
        estimates = [*room.lengths(1.0)[0], room.height(), room.floor_area(), room.volume()]
        truths = [*truth, HEIGHT, 6.0 * 2.5 + 3.5 * 2.5, HEIGHT * (6.0 * 2.5 + 3.5 * 2.5)]
        whitened += [(one.value - true) / one.sigma for one, true in zip(estimates, truths, strict=True)]
        assert all(one.sigma == one.sigma_random for one in estimates)
    # 72 numbers, of which those of one draw share walls: as about 45 independent ones, whose root mean square lies
    # within 0.79 ... 1.21 in 95 % of cases; residuals cut at 2.5 sigma cost another few per cent.
    assert 0.75 < np.sqrt(np.mean(np.square(whitened))) < 1.3


def test_what_is_hardly_seen_is_behind_an_opening():
    """From the far end of the L most of its other arm is hidden: the wall that hides it goes on, with a gap in it."""
    cloud = seen_room(at=np.array([5.2, 1.2, 1.3]))
    room = measure_outline(cloud)
    np.testing.assert_allclose([each.value for each in room.lengths()[0]], [6.0, 2.5, 6.0, 2.5], atol=1e-3)
    (one,) = (each for loop in find_openings(cloud, room) for side in loop for each in side)
    assert one.kind == "opening" and one.width.value == pytest.approx(3.5, abs=4 * one.width.sigma)


def test_a_corner_that_nobody_saw_bounds_nothing():
    """So coarse that a wall at a slant is not found: those beside it meet far from all that was seen."""
    room = measure_outline(seen_room(grid=(120, 50), noise=4e-3))
    assert len(room.loops[0]) == 4 and not room.closed and room.floor_area() is None
    assert sum(each is None for each in room.lengths()[0]) == 2


def test_a_side_without_a_wall_is_open():
    cloud = seen_room(L_SHAPE[:2] + ((6.0, 5.0), (0.0, 5.0)))
    p = cloud.xyz @ np.array([np.cos(0.4), -np.sin(0.4), 0.0])
    # As if a wall of glass were at x = 6: nothing came back from there, nor from beyond 4.2 m.
    cloud.valid = p < 2.5
    room = measure_outline(cloud)
    open_sides = [side.name for side in room.loops[0] if not side.seen]
    assert len(open_sides) == 1 and not room.closed
    assert room.floor_area() is None and room.volume() is None
    lengths = room.lengths()[0]
    # The open side and its two neighbours end where nobody saw a corner.
    assert sum(each is None for each in lengths) == 3
    (known,) = (each for each in lengths if each is not None)
    assert known.value == pytest.approx(5.0, abs=1e-3) and np.isfinite(known.sigma)


@pytest.fixture(scope="module")
def furnished():
    cloud = seen_room(niches=(DOOR, WINDOW), boxes=(CUPBOARD,))
    room = measure_outline(cloud)
    return room, find_openings(cloud, room)


def test_furniture_is_not_the_wall(furnished):
    found, truth = in_order(furnished[0], L_SHAPE)
    np.testing.assert_allclose(found, truth, atol=1e-3)


def test_door_and_window(furnished):
    room, openings = furnished
    found = {one.kind: one for loop in openings for side in loop for one in side}
    assert set(found) == {"door", "window"}
    for kind, truth in (("door", DOOR), ("window", WINDOW)):
        one = found[kind]
        for end, true in zip((one.left, one.right, one.bottom, one.top), truth[1:5], strict=True):
            # An even distribution reaches 1.73 sigma; the bottom of the door is the floor.
            assert abs(end.value - true) < 1.8 * end.sigma + 2e-3
            assert end.sigma < 0.03
        assert one.depth_m == pytest.approx(truth[5], abs=5e-3)
        number = [side.name for side in room.loops[0]].index(one.side)
        assert room.lengths()[0][number].value == pytest.approx(LENGTHS[truth[0]], abs=1e-3)


def test_a_window_that_sends_nothing_back():
    cloud = seen_room(niches=(WINDOW,))
    deep = seen_room(niches=((*WINDOW[:5], 5.0),), noise=0.0)
    cloud.valid = np.abs(np.linalg.norm(deep.xyz, axis=-1) - np.linalg.norm(cloud.xyz, axis=-1)) < 1.0
    (one,) = (each for loop in find_openings(cloud, measure_outline(cloud)) for side in loop for each in side)
    assert one.kind == "window" and one.depth_m is None
    assert abs(one.width.value - 1.4) < 3 * one.width.sigma and abs(one.height.value - 1.2) < 3 * one.height.sigma


def test_refusals():
    cloud = seen_room()
    cloud.valid = cloud.xyz[..., 2] > -0.5
    with pytest.raises(MeasurementError, match="No floor"):
        measure_outline(cloud)
    cloud = seen_room()
    # One wall and the floor before it.
    ahead = cloud.xyz @ np.array([np.cos(0.4), -np.sin(0.4), 0.0])
    cloud.valid = (np.abs(cloud.xyz @ np.array([np.sin(0.4), np.cos(0.4), 0.0]) + AT[1]) < 0.02) & (ahead < 3.0)
    cloud.valid |= (cloud.xyz[..., 2] < -1.2) & (np.linalg.norm(cloud.xyz, axis=-1) < 3.0)
    with pytest.raises(MeasurementError, match="wall"):
        measure_outline(cloud)
    cloud.valid[:] = False
    with pytest.raises(MeasurementError, match="no valid points"):
        measure_outline(cloud)


def repeated(cloud, times):
    """The cloud with every profile taken several times, as a sweep at several exposures gives it."""
    many = SimpleNamespace(**{name: np.repeat(values, times, 0) for name, values in vars(cloud).items()})
    noise = 2e-4 * np.random.default_rng(1).normal(size=many.xyz.shape)
    many.xyz = (many.xyz + noise).astype(np.float32)
    return many


def one_row(cloud, sigma):
    """The points as a text gives them: nobody knows which are of one profile."""
    p = cloud.xyz[cloud.valid][None]
    known = {"sigma_random": np.full(p.shape[:2], sigma, np.float32), "valid": np.ones(p.shape[:2], bool)}
    return SimpleNamespace(xyz=p, laser=np.zeros(1, np.int32), angle=np.zeros(1), **known)


def test_profiles_are_no_walls(box_room):
    """Three profiles at one angle are enough for a plane, on which hundreds of points lie; rooms go on behind it."""
    rare = box_room((3.2, 3.8, 2.4), grid=(20, 256), noise=2e-4, elevation=60.0)
    with pytest.raises(MeasurementError, match=r"No two .* has the points of one profile"):
        measure_outline(repeated(rare, 3))
    with pytest.raises(MeasurementError, match=r"No two .* has 2\d % of the points behind it"):
        measure_outline(repeated(rare, 5))


def test_a_profile_beside_walls_is_said(box_room):
    room = measure_outline(repeated(box_room((3.2, 3.8, 2.4), grid=(36, 256), noise=2e-4, elevation=60.0), 3))
    (remark,) = room.remarks
    number, side = next((i, side) for i, side in enumerate(room.loops[0]) if remark.startswith(side.name))
    assert "is no wall" in remark and not side.seen and room.lengths()[0][number] is None and not room.closed


@pytest.mark.parametrize(("profiles", "lines"), [(15, 256), (24, 256)])
def test_the_outline_holds_the_points(profiles, lines, box_room):
    """Without a grid two profiles are taken for walls, in whose corner the scanner stands."""
    rare = box_room((3.2, 3.8, 2.4), grid=(profiles, lines), noise=2e-4, elevation=60.0)
    with pytest.raises(MeasurementError, match=r"No two .*\(\d\d % of the points lie outside of them"):
        measure_outline(one_row(rare, 1e-3))


@pytest.mark.parametrize("top", [2.05, HEIGHT])
def test_a_glass_wall_or_an_open_door_is_no_contradiction(top):
    """Nearly a fifth of the points is seen through it."""
    corners = ((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0))
    cloud = seen_room(corners, at=np.array([3.9, 2.0, 1.3]), niches=((1, 1.0, 3.0, 0.0, top, 8.0),))
    room = measure_outline(cloud)
    assert room.remarks == () and room.closed and all(side.seen for side in room.loops[0])
    found, truth = in_order(room, corners)
    np.testing.assert_allclose(found, truth, atol=1e-3)
    ahead = cloud.xyz @ np.array([np.cos(0.4), -np.sin(0.4), 0.0])
    assert 0.15 < np.mean(ahead > 1.2) < 0.2


@pytest.mark.parametrize("side", [-1, 1])
def test_points_beyond_floor_and_ceiling(side):
    """A quarter of the points is deeper than the floor, or above the ceiling, in no order."""
    cloud = seen_room(elevation=75.0)
    p, farther = cloud.xyz, np.random.default_rng(0).uniform(1.2, 2.0, cloud.xyz.shape[:2])
    beyond = (np.abs(p[..., 2] - side * HEIGHT / 2) < 0.02) & (np.linalg.norm(p[..., :2], axis=-1) < 1.5)
    assert 0.21 < beyond.mean() < 0.3
    cloud.xyz = np.where(beyond[..., None], farther[..., None] * p, p).astype(np.float32)
    if side < 0:
        with pytest.raises(MeasurementError, match=r"2\d % of the points lie below .* no floor"):
            measure_outline(cloud)
        return
    room = measure_outline(cloud)
    assert room.ceiling is None and room.height() is None and room.volume() is None
    assert len(room.remarks) == 1 and "no ceiling: 2" in room.remarks[0]
    assert room.floor_area() is not None


def test_the_part_of_the_calibration_is_that_of_other_lengths(tiny):
    """A length of the outline and one of `measure_room` across the same walls have the same uncertainty."""
    cloud, scanner = jaxscan.load_cloud(tiny.cloud), jaxscan.load_scanner(tiny.calibration)
    box, room = jaxscan.measure_room(cloud, scanner=scanner), measure_outline(cloud, scanner=scanner)
    assert room.height().value == pytest.approx(box.height.value_m, abs=2e-3)
    # Not at the same place of floor and ceiling.
    assert room.height().sigma_systematic == pytest.approx(box.height.sigma_systematic_m, rel=0.3)
    for length in room.lengths()[0]:
        assert length is None or length.sigma_systematic > 0
