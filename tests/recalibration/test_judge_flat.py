"""Which surfaces are flat after an adjustment."""

import numpy as np
import pytest

from jaxscan.recalibration import Adjusted, RoomObservations, SurfacePoints, Surfaces
from jaxscan.recalibration.judge import flat
from jaxscan.recalibration.triangulate import triangulate_points
from tests.recalibration.faces import Cylinder, Face, Taken, X, Y, box, rig, take
from tests.recalibration.linear_room import adjusted_of


NOISE_PX = 0.1


def adjusted(taken: Taken, walls: list[list[int]], wall_m: float = 3e-4, seed: int = 0) -> Adjusted:
    """As an adjustment would leave it, that took all points on some faces for one wall and has the true scanner."""
    scanner, rng = rig(), np.random.default_rng(seed)
    chosen, surface = [], []
    for number, faces in enumerate(walls):
        profile, line = np.nonzero(np.isin(taken.face, faces))
        some = rng.choice(len(profile), min(len(profile), 4000), replace=False)
        chosen.append(np.stack([profile, line], -1)[some])
        surface.append(np.full(len(some), number))
    profile, line = np.concatenate(chosen).T
    surface = np.concatenate(surface)
    sweep = taken.sweep
    q = np.stack([sweep.centre[profile, line], line.astype(float)], -1)
    zero = np.zeros(len(q), int)
    points = SurfacePoints(q, sweep.sigma[profile, line], zero, profile, line, zero, surface)
    p, _ = triangulate_points(scanner, q, zero, sweep.angle[profile])
    beside, _ = triangulate_points(scanner, q + [0.1, 0.0], zero, sweep.angle[profile])
    normal, centre = np.zeros((len(walls), 3)), np.zeros((len(walls), 3))
    for k in range(len(walls)):
        own = p[surface == k]
        centre[k] = own.mean(0)
        normal[k] = np.linalg.eigh((own - centre[k]).T @ (own - centre[k]))[1][:, 0]
    error = ((p - centre[surface]) * normal[surface]).sum(1)
    stripe = np.abs(((beside - p) * normal[surface]).sum(1)) / 0.1 * NOISE_PX
    surfaces = Surfaces(normal, (normal * centre).sum(1), centre)
    observations = RoomObservations(points, surfaces, (sweep.angle,), np.zeros(1, int), "rows")
    found = {"point_error": error, "point_sigma": np.hypot(stripe, wall_m), "wall_m": wall_m, "inflation": 30.0}
    return adjusted_of(scanner, observations, **found)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.more) for seed in (1, 2))])
def test_flat_walls_are_flat(seed):
    taken = take(box(), rig(), noise_px=NOISE_PX, seed=seed)
    assert flat(adjusted(taken, [[0], [1], [2], [3]], seed=seed)).all()


@pytest.mark.parametrize("edge", [-1.0, 0.3, 1.2])
def test_a_step_of_five_millimetres_is_not_flat(edge):
    wall = [Face(X, -2.0, ((Y, -9.0, edge),)), Face(X, -2.005, ((Y, edge, 9.0),))]
    taken = take([*wall, *box()[1:]], rig(), noise_px=NOISE_PX)
    # The roughness that an adjustment would learn from such a wall does not excuse it.
    assert flat(adjusted(taken, [[0, 1], [2], [3], [4]], wall_m=1.2e-3)).tolist() == [False, True, True, True]


@pytest.mark.parametrize("radius", [5.0, 20.0])
def test_a_curved_wall_is_not_flat(radius):
    bulge = Cylinder((-2.0 + radius, 0.0), radius, ((X, -9.0, -1.9),))
    taken = take([bulge, *box()[1:], Face(X, -4.0)], rig(), noise_px=NOISE_PX)
    assert flat(adjusted(taken, [[0], [1], [2], [3]], wall_m=3e-3)).tolist() == [False, True, True, True]


def test_a_wall_whose_points_were_rejected_is_not_flat():
    result = adjusted(take(box(), rig(), noise_px=NOISE_PX), [[0], [1]])
    result.point_kept[result.observations.points.surface == 1] = np.arange(4000) % 2 == 0
    assert flat(result).tolist() == [True, False]
