"""The test for drift and the part that moved, on a linear adjustment with a known truth."""

import numpy as np
import pytest

from jaxscan.recalibration.judge.drift import (
    Explanation,
    compare,
    departure_of,
    describe_move,
    explain,
    loosened_prior,
    loosening,
    moved_parameters,
    parts_of,
    scale_slopes,
    with_prior,
)

from .linear_room import linear_room


TILT = np.radians(0.05)


@pytest.fixture(scope="module")
def room():
    return linear_room()


@pytest.fixture(scope="module")
def compared(room):
    return compare(room.prior, room.posterior())


def departure(room, compared, random, move=0.0):
    return departure_of(compared, room.departure(random, move)[0])


def test_without_drift_p_is_uniform(room, compared):
    random = np.random.default_rng(1)
    p = np.sort([departure(room, compared, random).p for _ in range(200)])
    uniform = (np.arange(200) + 0.5) / 200
    # Kolmogorov's distance that uniform numbers exceed once in a hundred times.
    assert np.abs(p - uniform).max() < 1.63 / np.sqrt(200)


def test_directions_without_gain_do_not_count(room, compared):
    found = departure(room, compared, np.random.default_rng(2))
    # 21 parameters are free.
    assert 10 <= len(found.value) == np.count_nonzero(compared.ratio < 0.999) <= 17


@pytest.mark.parametrize(
    ("points", "move", "part"),
    [
        (10.0, {"laser_red_n1": TILT}, "laser red"),
        (10.0, {"laser_red_n2": -TILT}, "laser red"),
        (10.0, {"axis_d1": TILT}, "axis"),
        (10.0, {"gain": 3e-3}, "table's angles"),
        # Walls say little of the place of the axis: that takes a thousand times the points of the small sweep.
        (1000.0, {"axis_p1": 5e-4}, "axis"),
    ],
)
def test_a_part_that_moved_is_found_and_its_move_removed(points, move, part):
    room = linear_room(points)
    compared = compare(room.prior, room.posterior())
    random, step = np.random.default_rng(3), room.moved(**move)
    places = [room.names.index(name.replace("_", ".")) for name in move]
    size = []
    for _ in range(20):
        state = random.bit_generator.state
        seen = departure(room, compared, random, step)
        assert seen.p < 1e-3
        found = explain(seen, room.scanner)
        assert part in [each.name for some in (found.parts, *found.others) for each in some]
        assert found.p > 1e-4
        added = loosened_prior(found, seen, room.scanner, scale_known=False)
        # The same errors again, solved with the loosened prior.
        random.bit_generator.state = state
        _, error = room.departure(random, step, room.prior + added)
        after = room.posterior(room.prior + added)
        size.append(error[places] / np.sqrt(np.diag(after)[places]))
    size = np.array(size)
    # 20 trials with one fixed move: a root mean square of 1.6 comes about once in a thousand times.
    assert np.abs(size).max() < 4.0 and np.sqrt(np.mean(size**2)) < 1.6


def test_parts_that_look_alike_are_all_loosened_and_the_scale_is_not_set_free():
    """Sheet and axis at distances that grew by different shares: either may be the one that moved."""
    room = linear_room(1000.0)
    compared = compare(room.prior, room.posterior())
    random, step = np.random.default_rng(4), room.moved(laser_red_d=1e-3)
    seen = departure(room, compared, random, step)
    found = explain(seen, room.scanner)
    assert {part.name for some in (found.parts, *found.others) for part in some} == {"laser red", "axis"}
    added = loosened_prior(found, seen, room.scanner, scale_known=False)
    slope = scale_slopes(room.scanner, room.observations)[0]
    sigma = [float(np.sqrt(slope @ room.posterior(prior) @ slope)) for prior in (room.prior, room.prior + added)]
    # The sheet stands 0.165 m from the camera and the axis 0.212 m: a millimetre of either is about 1 / 200.
    assert sigma[0] < 3e-4 and 2e-3 < sigma[1] < 1e-2
    _, error = room.departure(random, step, room.prior + added)
    assert abs(slope @ error) < 2.0 * sigma[1]


def test_where_sheet_and_axis_both_moved_the_scale_is_freed_by_no_more_than_they_did():
    room = linear_room(1000.0)
    step = room.moved(laser_red_n1=TILT, axis_d1=2 * TILT, axis_p1=1e-3)
    seen = departure(room, compare(room.prior, room.posterior()), np.random.default_rng(8), step)
    found = Explanation(parts_of(room.scanner)[:2], 0.5)
    slope = scale_slopes(room.scanner, room.observations)[0]
    added = loosened_prior(found, seen, room.scanner, scale_known=False)
    sigma = float(np.sqrt(slope @ room.posterior(room.prior + added) @ slope))
    # By up to a millimetre or so of 165 and 212 mm; the tolerances of both parts would leave 2.6 %.
    assert 1e-3 < sigma < 7e-3


def test_a_departure_that_no_part_explains_is_told(room, compared):
    """The lens changed its distortion, which is no part's move."""
    found = explain(departure(room, compared, np.random.default_rng(5), room.moved(k1=0.02)), room.scanner)
    assert found.parts == parts_of(room.scanner) and found.p < 1e-3


def test_a_solve_with_a_loose_prior_tells_what_a_tight_one_would(room):
    random = np.random.default_rng(6)
    loose = room.prior + 0.01 * loosening(parts_of(room.scanner), room.scanner)
    state = random.bit_generator.state
    step, _ = room.departure(random, 0.0, loose)
    random.bit_generator.state = state
    wanted, _ = room.departure(random)
    found, back = with_prior(compare(loose, room.posterior(loose)), step, room.prior)
    sigma = np.where(np.diag(room.prior) > 0, np.sqrt(np.diag(room.prior)), 1.0)
    # Conditions of 1e8 leave half of the digits.
    np.testing.assert_allclose(back / sigma, wanted / sigma, atol=1e-5)
    np.testing.assert_allclose(np.sort(found.ratio), np.sort(compare(room.prior, room.posterior()).ratio), rtol=1e-4)


def test_held_parameters_stay_held(room):
    names = room.names
    added = loosening(parts_of(room.scanner), room.scanner)
    for name in ("laser.red.b2", "laser.red.b3"):
        assert not added[names.index(name)].any()
    focus = added[np.ix_([names.index("fx"), names.index("fy")], [names.index("fx"), names.index("fy")])]
    # The height scale hangs on the ratio of the focal lengths.
    ratio = np.array([1 / float(room.scanner.camera.fx), -1 / float(room.scanner.camera.fy)])
    assert np.sqrt(ratio @ focus @ ratio) < 5e-5 and np.sqrt(focus[0, 0]) > 5.0


@pytest.mark.parametrize("loosened", [False, True])
def test_moved_parameters_are_told_in_sigmas_of_chance(room, loosened):
    part = parts_of(room.scanner)[0]
    added = loosening([part], room.scanner) * float(loosened)
    both = compare(room.prior + added, room.posterior(room.prior + added))
    random = np.random.default_rng(7)
    rows = []
    for _ in range(200):
        step, _ = room.departure(random, 0.0, room.prior + added)
        rows.append([each.sigmas for each in moved_parameters(room.scanner, step, both, added)])
    rms = np.sqrt(np.mean(np.square(rows), axis=0))
    some = rms[rms > 0]
    # 200 normal numbers: their root mean square is within 16 % of 1, but once in a thousand times.
    assert len(some) > 10 and np.all(np.abs(some - 1.0) < 0.2)


def test_moves_are_told_in_units_of_people(room):
    part = parts_of(room.scanner)[0]
    step, covariance = room.moved(laser_red_n1=TILT, laser_red_d=2e-4), np.diag(1e-10 * np.ones(len(room.names)))
    assert describe_move(part, room.names, step, covariance) == "0.05000 ± 0.00057 degrees, 0.200 ± 0.010 mm"
