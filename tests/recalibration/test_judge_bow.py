"""A sheet that the stored calibration holds flat and walls show bowed is no drift; nor does a drift look like a bow."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.recalibration import RecalibrationSettings
from jaxscan.recalibration.judge import find_drift, loose, with_covariance
from jaxscan.recalibration.judge.drift import departure_of
from jaxscan.recalibration.judge.gain import compare

from .linear_room import adjusted_of, linear_room


TILT = np.radians(0.05)
BOW = {"laser_red_b2": 8e-4, "laser_red_b3": -5e-4}


@pytest.fixture(scope="module")
def room():
    return linear_room(30.0)


def solved(room, seed, move, scanner):
    """The adjustment with the covariance of a scanner as prior; the same errors with every prior."""
    prior = np.asarray(scanner.covariance)
    step, error = room.departure(np.random.default_rng(seed), move, prior)
    after = with_covariance(room.scanner, room.posterior(prior))
    return replace(adjusted_of(after, room.observations, departure=step), prior=scanner), error


def verdict_of(room, seed, **move):
    step = room.moved(**move)
    free, _ = solved(room, seed, step, loose(room.scanner))
    return find_drift(room.scanner, free, lambda prior, _: solved(room, seed, step, prior)[0], RecalibrationSettings())


def bow_is_free(room, verdict):
    at = [room.names.index("laser.red.b2"), room.names.index("laser.red.b3")]
    return bool(np.all(np.diag(verdict.loosened)[at] > 0))


def test_a_bow_that_is_held_is_no_drift(room):
    step = room.moved(**BOW)
    compared = compare(room.prior, room.posterior())
    chances = []
    for seed in range(20):
        # With the sheet held flat the walls' bend is taken for a drift.
        assert departure_of(compared, room.departure(np.random.default_rng(seed), step)[0]).p < 1e-3
        verdict = verdict_of(room, seed, **BOW)
        assert not verdict.drift.drifted and bow_is_free(room, verdict)
        assert "bowed" in verdict.notes[0]
        _, error = solved(room, seed, step, with_covariance(room.scanner, room.prior + verdict.loosened))
        sigma = np.sqrt(np.diag(np.asarray(verdict.adjusted.scanner.covariance)))
        assert np.all(np.abs(error) <= 4.5 * sigma)
        chances.append(verdict.drift.p)
    # Uniform: of 20 the least is below 0.0005 once in a hundred times, and the mean within 3 sigma of a half.
    assert min(chances) > 5e-4 and abs(np.mean(chances) - 0.5) < 3 * np.sqrt(1 / 12 / 20)


@pytest.mark.parametrize("move", [{}, {"laser_red_n1": TILT}, {"axis_d1": TILT}])
def test_a_flat_sheet_stays_held_whatever_moved(room, move):
    verdicts = [verdict_of(room, seed, **move) for seed in range(10)]
    assert not any(bow_is_free(room, verdict) for verdict in verdicts)
    assert all(verdict.drift.drifted == bool(move) for verdict in verdicts)


def test_a_drift_is_found_beside_a_bow(room):
    verdict = verdict_of(room, 1, laser_red_n1=2 * TILT, **BOW)
    assert verdict.drift.drifted and "laser red" in verdict.drift.part
