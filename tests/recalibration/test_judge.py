"""Gains, unobserved directions, hold-out, closure and refusal, on adjustments that were made up."""

import numpy as np
import pytest

from jaxscan.errors import CalibrationError
from jaxscan.leastsq import chance_of
from jaxscan.recalibration import Drift, HoldOut, Surfaces, Tracks
from jaxscan.recalibration.judge import closure_of, describe_surface, gains_of, hold_out, refuse_result, unobserved
from jaxscan.recalibration.judge.drift import compare, scale_slopes, scales_of
from jaxscan.recalibration.result import LengthGain

from .linear_room import adjusted_of, linear_room, with_held
from .small_room import observe, stored, truth_scanner, with_covariance


@pytest.fixture(scope="module")
def room():
    return linear_room()


def test_the_chance_of_a_chi_squared():
    # Closed forms: exp(-x / 2) for two degrees of freedom; 0.0455 beyond two sigmas for one.
    assert chance_of(3.0, 2) == pytest.approx(np.exp(-1.5))
    assert chance_of(4.0, 1) == pytest.approx(0.04550026)
    assert chance_of(0.0, 0) == 1.0
    assert 0.0 < chance_of(300.0, 10) < 1e-50


def test_covariances_are_compared_direction_by_direction():
    prior = np.diag([4.0, 0.0, 1e-8])
    found = compare(prior, np.diag([1.0, 0.0, 1e-8 / 9]))
    np.testing.assert_allclose(found.factor, [2.0, 3.0], rtol=1e-9)
    np.testing.assert_allclose(
        (found.direction * (1.0 - found.ratio)) @ found.direction.T, np.diag([3.0, 0.0, 1e-8 * 8 / 9]), atol=1e-15
    )


def test_scales_are_those_of_a_stretched_room(room):
    """Steps that scale all lengths of the rig scale the room: their radial and height scale is the share."""
    scanner = room.scanner
    slope = scale_slopes(scanner, room.observations)
    share = 1e-4
    basis, point = np.asarray(scanner.turntable.basis), np.asarray(scanner.turntable.point)
    step = room.moved(laser_red_d=share * float(scanner.lasers.distance[0]))
    step[[room.names.index("axis.p1"), room.names.index("axis.p2")]] = share * (basis @ point)
    # Exact but for the numbers' rounding in 64 bit.
    np.testing.assert_allclose(slope @ step, [share, share], rtol=1e-6)


def test_walls_leave_both_scales_to_the_stored_calibration(room):
    both = compare(room.prior, room.posterior())
    scales = scales_of(both, scale_slopes(room.scanner, room.observations))
    assert np.all(scales.factor < 1.3) and np.all(scales.after <= scales.before)
    told = unobserved(both, scales, room.names)
    assert told[0].startswith("radial scale: planes look the same") and told[1].startswith("height scale")
    gains = gains_of(both, scales, room.names)
    assert [gain.name for gain in gains[:2]] == ["radial scale", "height scale"]
    factors = [gain.factor for gain in gains[2:]]
    assert factors == sorted(factors) and factors[-1] > 10.0


def test_a_known_length_gives_the_radial_scale(room):
    slope = scale_slopes(room.scanner, room.observations)
    known = room._replace(information=room.information + np.outer(slope[0], slope[0]) / 2e-5**2)
    both = compare(room.prior, known.posterior())
    scales = scales_of(both, slope)
    assert scales.factor[0] > 3.0 and scales.after[0] < 2.1e-5
    assert not any(line.startswith("radial") for line in unobserved(both, scales, room.names))


def test_planes_that_were_held_out_judge(room):
    truth = truth_scanner()
    observations = observe(truth)
    before = with_held(room.scanner, room.moved(laser_red_n1=2e-3, cx=3.0))
    adjusted = adjusted_of(room.scanner, observations)
    asked = []

    def fit(some):
        asked.append(np.unique(some.points.surface[np.isfinite(some.points.sigma)]).tolist())
        return adjusted_of(truth, some)

    good = hold_out(adjusted, before, fit)
    assert good is not None and good.better and sorted(asked[0] + asked[1]) == [0, 1, 2, 3]
    # Exact stripes of flat walls; the stored calibration bends them by millimetres.
    assert max(good.after_mm) < 1e-3 < 0.5 < min(good.before_mm)
    bad = hold_out(adjusted, truth, lambda some: adjusted_of(before, some))
    assert bad is not None and not bad.better


def test_one_plane_cannot_be_held_out(room):
    observations = room.observations.only([0])
    assert hold_out(adjusted_of(room.scanner, observations), room.scanner, lambda some: None) is None


def test_half_of_the_planes_may_leave_something_open(room):
    """All planes have an adjustment; that those of one half have none is no fault of the captures."""

    def fit(some):
        raise CalibrationError("The captures contradict each other, so no adjustment fits them.")

    adjusted = adjusted_of(room.scanner, observe(truth_scanner()))
    assert hold_out(adjusted, room.scanner, fit) is None


def test_the_gap_of_an_overlap_is_measured():
    from experiments.recalibration.world import Noise, Sweeping, true_sweep

    from .small_room import config

    sweep = true_sweep(
        config(), 1, Sweeping(steps=130, turn_deg=390.0, line_stride=48, furniture=False, noise=Noise(px=0.0))
    )
    truth = truth_scanner()
    observations = observe(truth, sweep_truth=sweep)
    wrong = with_held(stored(truth, np.random.default_rng(1)), np.zeros(len(truth.parameter_names())))
    names = wrong.parameter_names()
    gain = np.zeros(len(names))
    gain[names.index("gain")] = 1e-3
    before = with_held(linear_room().scanner, gain)
    found = closure_of(adjusted_of(truth, observations), before)
    # 0.001 of a full turn at 2.5 m; the room's planes see it to a few per cent, through their wrong places.
    assert found is not None and found.source == "overlap"
    assert found.before_mm == pytest.approx(2.5 * 2 * np.pi, rel=0.05)
    assert found.after_mm < 1e-3 < found.sigma_mm


def test_without_overlap_only_the_sigma_of_the_gap_is_told(room):
    """A table whose gain is 1.0001 is no table that leaves a gap: nothing shows one."""
    names = room.names
    step = room.moved(gain=-1e-4)
    adjusted = adjusted_of(room.scanner, room.observations)
    found = closure_of(adjusted, with_held(room.scanner, step))
    assert found is not None and found.source == "model"
    assert found.before_mm is None and found.after_mm is None
    assert found.sigma_mm == pytest.approx(np.sqrt(room.prior[names.index("gain"), names.index("gain")]) * 5e3 * np.pi)


def length(before, after):
    return LengthGain("red", "across the sweep", 2.0, 1.5, before, after)


GAINED = (length(1.0, 0.5), length(1.0, 1.0))


def refused(room, *, drifted=False, part="", held_out=None, gained=True, lengths=GAINED, **changes):
    adjusted = adjusted_of(changes.pop("scanner", room.scanner), room.observations, **changes)
    both = compare(room.prior, room.posterior() if gained else 0.99 * room.prior)
    drift = Drift(30.0, 10, 1e-4 if drifted else 0.5, drifted, part)
    return refuse_result(adjusted, both, drift, held_out, lengths)


def test_a_good_adjustment_is_not_refused(room):
    assert refused(room) == ""
    assert refused(room, held_out=HoldOut((1.0, 1.0), (0.5, 2.0), better=True)) == ""


def test_refusals_say_why(room):
    assert "did not settle in 5 steps" in refused(room, converged=False)
    assert "became less flat (1.00 mm before, 2.00 mm after)" in refused(
        room, held_out=HoldOut((1.0, 1.0), (2.0, 2.0), better=False)
    )
    assert "known 1.01 times as well" in refused(room, gained=False)
    assert refused(room, gained=False, drifted=True) == ""
    lost = with_covariance(room.scanner, 1e4 * room.prior)
    assert "drifted" in refused(room, drifted=True, scanner=lost) and refused(room, scanner=lost) == ""
    bent = refused(room, drifted=True, part="axis and table's angles")
    assert "only if the axis and table's angles changed" in bent and "a wall that is curved" in bent
    assert refused(room, drifted=True, part="laser red or table's angles") == ""
    error = np.zeros(len(room.observations.points.q))
    error[room.observations.points.surface == 2] = 0.02
    said = refused(room, cost=9.0 * len(error), point_error=error)
    assert "3.0 times as large as stated" in said and describe_surface(room.observations.surfaces, 2) in said
    one = room._replace(observations=room.observations.only([0]))
    assert "face 1 direction, expected at least 2" in refused(one)
    for text in (said, refused(one)):
        assert "\n" not in text


def test_an_update_that_gains_no_length_is_refused(room):
    few = (length(1.0, 0.97), length(2.0, 1.99))
    assert "the best of the typical lengths is known 1.03 times as well" in refused(room, lengths=few)
    worse = (length(1.0, 0.5), length(1.0, 1.03))
    assert "1.5 m across the sweep would be known worse (± 1.03 mm, before ± 1.00 mm)" in refused(room, lengths=worse)
    # Where a part moved its share of the prior is given up, so a length may well be known worse.
    assert refused(room, lengths=worse, drifted=True) == refused(room, lengths=few, drifted=True) == ""


def test_walls_that_took_up_the_misfit_are_refused(room):
    """The shape of walls, and the learned noise, leave residuals of the size that was learned."""
    assert refused(room, wall_m=3e-3, uneven_m=3e-3) == ""
    said = refused(room, wall_m=3e-3, uneven_m=4.1e-3)
    assert "the walls are uneven by 5.1 mm (expected at most 5 times and 5 mm)" in said
    assert refused(room, misfit=24.0) == ""
    assert "residuals are 5.1 times as large as stated" in refused(room, misfit=26.0)


def tracked(room, count, turn):
    """One plane, and points that are tracked over a turn."""
    angle = room.observations.angles[0]
    ends = np.array([0, int(np.argmin(np.abs(angle - angle[0] - turn)))])
    record, track = np.tile(ends, count), np.repeat(np.arange(count), 2)
    ones = np.ones(2 * count)
    tracks = Tracks(np.zeros((2 * count, 2)), ones, np.zeros(2 * count, int), record, track, np.zeros((count, 3)))
    return room._replace(observations=room.observations.only([0])._replace(tracks=tracks))


def test_a_few_targets_do_not_stand_for_walls(room):
    kept = lambda count: {"track_kept": np.ones(2 * count, bool)}
    assert refused(tracked(room, 20, 2.0), **kept(20)) == ""
    assert "face 1 direction" in refused(tracked(room, 19, 2.0), **kept(19))
    assert "face 1 direction" in refused(tracked(room, 20, 1.0), **kept(20))
    assert "face 1 direction" in refused(tracked(room, 20, 2.0), track_kept=np.zeros(40, bool))


def test_scales_are_of_the_room_with_corrected_angles(room):
    """A journal of half the turn tells the same scales, once its angles are put right."""
    angle = room.observations.angles[0]
    folded = room.observations._replace(angles=(angle / 2,))
    found = scale_slopes(room.scanner, folded, (angle / 2,))
    np.testing.assert_allclose(found, scale_slopes(room.scanner, room.observations))
    assert not np.allclose(found, scale_slopes(room.scanner, folded), rtol=0.1)


def test_surfaces_are_told_by_where_they_are(room):
    words = [describe_surface(room.observations.surfaces, k) for k in range(4)]
    assert all(word.startswith("the wall at") for word in words)
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.6, 0.8]])
    surfaces = Surfaces(normal, np.array([-1.2, 1.3, 2.0]), normal)
    assert [describe_surface(surfaces, k) for k in range(3)] == [
        "the floor at 1.20 m",
        "the ceiling at 1.30 m",
        "an inclined plane at 2.00 m",
    ]


def test_a_scale_that_became_better_known_is_not_told_as_unchanged(room):
    """Sentences agree with the gains: of a scale that hung on a parameter that walls see, only the rest is stored."""
    both = compare(room.prior, room.posterior())
    slope = scale_slopes(room.scanner, room.observations)
    scales = scales_of(both, slope)
    told = unobserved(both, scales._replace(before=6.0 * scales.after, factor=np.ones(2)), room.names)
    assert told[0].endswith(
        f"the {1e6 * scales.after[0]:.0f} ppm that are left of its sigma are the stored calibration's"
    )
    told = unobserved(both, scales._replace(before=1.2 * scales.after, factor=np.ones(2)), room.names)
    assert told[0].endswith(f"the stored calibration alone holds it, to {1e6 * scales.after[0]:.0f} ppm")
