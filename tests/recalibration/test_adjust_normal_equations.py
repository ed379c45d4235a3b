"""The adjustment's normal equations against a dense least squares, and derivatives against differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.leastsq import covariance_of, solve_arrow
from jaxscan.recalibration import KnownLength, RecalibrationSettings, Start, Tracks
from jaxscan.recalibration.adjust.prepare import prepare
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, length_values, linearise, step_of, unknowns_of
from jaxscan.recalibration.triangulate import triangulate_points
from tests.recalibration.small_room import SIGMA, exact_sweep, observe, stored, truth_scanner, with_covariance


pytestmark = pytest.mark.more


SEED = 11


@pytest.fixture(scope="module")
def everything():
    """Two stations, two lengths, features, and one angle per image: all kinds of unknowns."""
    random = np.random.default_rng(SEED)
    scanner = stored(truth_scanner(), random)
    every = observe(scanner, 0.1 * random.standard_normal((exact_sweep()[1].surface >= 0).sum()))
    some = every.points.take(np.sort(random.choice(len(every.points.q), 400, replace=False)))
    some = some._replace(sweep=np.arange(400) % 2)
    # Features beside stripes, seen again a few records later; in front of the camera of either station.
    count, angle = 60, every.angles[0]
    seen = every.points.take(random.choice(np.flatnonzero(every.points.record < 80), 20, replace=False))
    point, _ = triangulate_points(scanner, seen.q, seen.laser, angle[seen.record])
    tracks = Tracks(
        q=np.tile(seen.q, (3, 1)) + random.uniform(-50, 50, (count, 2)),
        sigma=np.full(count, 0.3),
        sweep=np.repeat([0, 1, 0], 20),
        record=np.tile(seen.record, 3) + np.repeat([0, 1, 3], 20),
        track=np.tile(np.arange(20), 3),
        point=point,
    )
    lengths = (KnownLength(3.0, 1e-3, "surfaces", 0, 1), KnownLength(1.0, 1e-3, "tracks", 2, 3))
    observations = every._replace(
        points=some, angles=(angle, angle), station=np.array([0, 1]), tracks=tracks, lengths=lengths
    )
    stations = np.stack([np.eye(4), np.eye(4)])
    stations[1, :3, 3] = 2e-3, 1e-3, 0.0
    settings = RecalibrationSettings(closed=True)
    with jax.enable_x64(True):
        prepared = prepare(scanner, Start(scanner, stations), observations, settings)
        weights = np.zeros(len(prepared.room.point_weight)), np.zeros(len(prepared.room.sighting_weight))
        weights[0][:400], weights[1][:count] = random.uniform(1, 10, 400), 3.0
        room = eqx.tree_at(lambda r: (r.point_weight, r.sighting_weight), prepared.room, weights)
        room = jax.tree.map(jnp.asarray, room)
        y = jax.tree.map(lambda a: jnp.asarray(0.1 * random.standard_normal(a.shape)), prepared.y)
        at = jax.tree.map(np.asarray, linearise(room, y))
    return room, y, at


def dense(room, y, at):
    """Residuals, and their derivatives by all unknowns in one row: scanner, stations, angles, places."""
    scanner, stations, angles = room.counts
    begin, wide = scanner + stations, scanner + stations + angles
    surfaces, count = len(room.places.offset), wide + 3 * len(y.locals)
    values, rows = [], []
    for part, sight, weight, first, each in (
        (at.points.rows, room.points, room.point_weight, 0, 1),
        (at.sightings, room.sightings, room.sighting_weight, surfaces, 2),
    ):
        for k in np.flatnonzero(np.repeat(np.asarray(weight), each)):
            row, w = np.zeros(count), float(weight[k // each])
            row[:scanner] = part.scanner[k]
            if sight.station[k // each]:
                row[scanner:begin] = part.station[k]
            if sight.angle[k // each] < angles:
                row[begin + int(sight.angle[k // each])] = part.angle[k]
            place = wide + 3 * (first + int(sight.local[k // each]))
            row[place : place + 3] = part.local[k]
            rows.append(w * row)
            values.append(w * part.value[k])
    lengths = np.zeros((len(room.lengths.metres), count))
    lengths[:, wide:] = jax.jacfwd(lambda x: length_values(room, x))(y.locals).reshape(len(lengths), -1)
    known = np.eye(count)[:scanner]
    told = np.asarray(room.linear_rows) @ known
    of_angles = np.eye(count)[begin:wide] * ANGLE_SCALE
    weight = np.asarray(room.lengths.weight)
    size = ANGLE_SCALE * np.asarray(y.angles)
    rows += [lengths * weight[:, None], known, told, np.asarray(room.stop)[:, None] * of_angles]
    values += [np.asarray(length_values(room, y.locals)) * weight, y.scanner]
    values += [np.asarray(room.linear_rows @ y.scanner - room.linear_values)]
    values += [room.stop * size]
    return np.concatenate([np.atleast_1d(value) for value in values]), np.vstack(rows)


@pytest.mark.more
def test_derivatives_are_those_of_differences(everything):
    room, y, at = everything
    random = np.random.default_rng(SEED)
    way = jax.tree.map(lambda a: jnp.asarray(random.standard_normal(a.shape)), y)
    ends = [linearise(room, jax.tree.map(lambda a, b, e=e: a + e * b, y, way)) for e in (1e-4, -1e-4)]
    steps, first = np.concatenate([np.zeros(6), way.stations]).reshape(2, 6), len(room.places.offset)
    for name, sight, offset, each in (("points", room.points, 0, 1), ("sightings", room.sightings, first, 2)):
        rows = [getattr(end, name) for end in (at, *ends)]
        own, ahead, behind = (part.rows if name == "points" else part for part in rows)
        station, angle, local = (np.repeat(np.asarray(a), each) for a in (sight.station, sight.angle, sight.local))
        expected = own.scanner @ np.asarray(way.scanner) + (own.station * steps[station]).sum(1)
        expected += own.angle * np.append(way.angles, 0.0)[angle] + (
            own.local * np.asarray(way.locals)[offset + local]
        ).sum(1)
        found = (np.asarray(ahead.value) - np.asarray(behind.value)) / 2e-4
        # Two steps of Newton end at the predicted centre only from nearby.
        near = np.abs(own.value) < 2.0 if name == "points" else np.full(len(local), True)
        assert near.sum() > 50
        # What is left of 2 px after two steps, over the 150 px of the stripe's parallax.
        np.testing.assert_allclose(found[near], expected[near], atol=1e-3 * np.abs(expected[near]).max())


def test_step_and_covariance_are_those_of_a_dense_least_squares(everything):
    room, y, at = everything
    residual, jacobian = dense(room, y, at)
    used = np.abs(jacobian).max(0) > 0
    # Those of scanner, second station, angles (of 40 images and more) and places.
    assert used.sum() > 21 + 6 + 40 + 12
    size = np.linalg.norm(jacobian[:, used], axis=0)
    expected = np.linalg.lstsq(jacobian[:, used] / size, residual, rcond=None)[0]
    covariance = covariance_of(at.arrow)
    found = step_of(room, at.arrow, covariance)
    found = np.concatenate([np.ravel(part) for part in found])[used] * size
    # Normal equations of a condition of 1e10 lose as many digits.
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    in_jax = jax.jit(solve_arrow)(jax.tree.map(jnp.asarray, at.arrow))
    jitted = np.concatenate([np.ravel(part) for part in unknowns_of(room, *in_jax)])
    np.testing.assert_allclose(jitted[used] * size, expected, atol=1e-4 * np.abs(expected).max())
    inverse = np.linalg.inv((jacobian[:, used] / size).T @ (jacobian[:, used] / size)) / np.outer(size, size)
    free = np.flatnonzero(used[: len(y.scanner)])
    own = inverse[: len(free), : len(free)]
    np.testing.assert_allclose(covariance.shared[np.ix_(free, free)], own, rtol=1e-3, atol=1e-6)


def test_four_upright_walls_leave_three_directions_to_the_prior():
    # Radial scale and height scale, as all planes; and one more, because no floor and no ceiling is seen here.
    scanner = truth_scanner()
    sigma = SIGMA.copy()
    observations = observe(scanner, 0.0)
    prior = with_covariance(scanner, np.diag(sigma**2))
    with jax.enable_x64(True):
        prepared = prepare(prior, Start(prior, np.eye(4)[None]), observations, RecalibrationSettings())
        weight = np.zeros(len(prepared.room.point_weight))
        # So precise, 1e-4 px, that all that planes show at all is known far better than before.
        weight[: len(observations.points.q)] = 1e4
        room = eqx.tree_at(lambda r: r.point_weight, prepared.room, weight)
        at = jax.tree.map(np.asarray, linearise(room, prepared.y))
    information = covariance_of(at.arrow).information
    free = np.flatnonzero(np.abs(prepared.room.root).max(0) > 0)
    values = np.linalg.eigvalsh(information[np.ix_(free, free)])
    assert len(values) == 21
    # The prior's own information is 1 in every direction.
    np.testing.assert_allclose(values[:3], 1.0, atol=1e-3)
    assert values[3] > 10.0
