"""First poses of a second station, anywhere in three rooms: how often they are found, refused, or wrong, and how exact.

    python -m experiments.recalibration.first_poses [--rooms demo bare L] [--calibrations true good paper-like]
        [--trials 30] [--seed 1] [--icp]

Places, yaws (any) and tilts (1.5 degrees) are drawn; a place has nothing within half a metre of the axis. Sought: in
the demo's room and in the L all found; in the bare box, which fits itself at 180 degrees, none wrong. A first pose is
right within 5 cm and 1 degree. With `--icp`, Open3D's point-to-plane ICP goes on from there on the same points.
"""

import time
from collections import Counter
from functools import cache, partial

import numpy as np

from experiments.recalibration import world
from experiments.recalibration.kinds import demo, matrix_of
from experiments.recalibration.trial import calibration_of, draw_truth
from experiments.recalibration.world import Sweeping, moved, room_from_rig
from experiments.report import command_line
from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.recalibration import SweepStripes
from jaxscan.recalibration.stations import place_stations
from jaxscan.recalibration.stations.view import look_around
from jaxscan.simulation import SimulationConfig, true_scanner
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.textures import Material


STEPS, TILT_DEG, CLEAR_M = 120, 1.5, 0.5
RIGHT_M, RIGHT_RAD = 0.05, np.radians(1.0)
ICP_M = 0.1
"""Points farther apart than this are no pair for ICP."""


def corner_filled(mesh: Mesh) -> None:
    """A corner of the demo's room walled off: the room is an L."""
    mesh.box((3.4, 4.5, 0.0), (1.6, 1.8, 2.5), Material(((0.7, 0.7, 0.7),)))


ROOMS = {"demo": Sweeping(), "bare": Sweeping(furniture=False), "L": Sweeping(furniture=False, extras=corner_filled)}


def draw_station(
    config: SimulationConfig, how: Sweeping, random: np.random.Generator
) -> tuple[SweepStripes, np.ndarray]:
    """A sweep from a clear place, and T_room_rig."""
    assert config.room is not None
    size = np.array(config.room.size_m)
    while True:
        place = random.uniform([0.6, 0.6, 1.0], [size[0] - 0.6, size[1] - 0.6, 1.4])
        if how.extras is corner_filled and (place[:2] > (2.3, 3.3)).all():
            continue
        rig = moved(config, tuple(float(x) for x in place), float(random.uniform(0, 360)))
        tilt = tuple(float(x) for x in TILT_DEG * random.standard_normal(2))
        taken = Sweeping(
            steps=STEPS, furniture=how.furniture, extras=how.extras, station=how.station, tilt_deg=tilt, line_stride=4
        )
        stripes, truth = world.true_sweep(rig, int(random.integers(1 << 30)), taken)
        beside = truth.point[truth.surface >= 0] - place
        if (np.linalg.norm(beside[:, :2], axis=1) > CLEAR_M).all() and len(beside) > 0.5 * STEPS * 128:
            return stripes, matrix_of(room_from_rig(rig, tilt))


def errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [rad] of two poses."""
    turn = found[:3, :3].T @ true[:3, :3]
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return float(np.linalg.norm((found - true)[:3, 3])), float(
        np.arctan2(np.linalg.norm(skew), (np.trace(turn) - 1) / 2)
    )


def icp(sweeps: list[SweepStripes], scanner: Scanner, first: np.ndarray) -> np.ndarray:
    """Open3D's point-to-plane ICP on the points of both stations, from a first pose."""
    from jaxscan.surface import load_open3d

    o3d = load_open3d()
    clouds = []
    for sweep in sweeps:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(look_around([sweep], scanner).points))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.2, max_nn=30))
        clouds.append(cloud)
    registration = o3d.pipelines.registration
    found = registration.registration_icp(
        clouds[1], clouds[0], ICP_M, first, registration.TransformationEstimationPointToPlane()
    )
    return np.asarray(found.transformation)


@cache
def scanner_of(kind: str, seed: int) -> tuple[SimulationConfig, Scanner]:
    config = draw_truth(demo(), seed)
    if kind == "true":
        return config, true_scanner(config)
    scanner = calibration_of(config, kind, seed).scanner  # type: ignore[arg-type]
    assert scanner is not None
    return config, scanner


def trials(room: str, kind: str, count: int, seed: int, *, with_icp: bool) -> None:
    outcome: Counter[str] = Counter()
    table, seconds, of_icp = [], [], []
    for trial in range(count):
        config, scanner = scanner_of(kind, trial % 3)
        random = np.random.default_rng([seed, trial, list(ROOMS).index(room)])
        drawn = [draw_station(config, ROOMS[room], random) for _ in range(2)]
        sweeps = [stripes._replace(station=k) for k, (stripes, _) in enumerate(drawn)]
        true = np.linalg.inv(drawn[0][1]) @ drawn[1][1]
        started = time.perf_counter()
        try:
            found = place_stations(sweeps, scanner)[1]
        except CalibrationError as problem:
            outcome["refused"] += 1
            print(f"  {room}, {kind}, {trial}: {problem}", flush=True)
            continue
        seconds.append(time.perf_counter() - started)
        shift, turn = errors(found, true)
        right = shift < RIGHT_M and turn < RIGHT_RAD
        outcome["right" if right else "WRONG"] += 1
        if not right:
            print(f"  {room}, {kind}, {trial}: {shift:.3f} m, {np.degrees(turn):.2f} degrees", flush=True)
            continue
        table.append((1e3 * shift, 1e3 * turn))
        if with_icp:
            shift, turn = errors(icp(sweeps, scanner, found), true)
            of_icp.append((1e3 * shift, 1e3 * turn))
    print(f"{room}, {kind}: {dict(outcome)}; median {np.median(seconds) if seconds else 0:.1f} s")
    for name, rows in (("first pose", table), ("ICP from there", of_icp)):
        if rows:
            shift, turn = np.array(rows).T
            print(
                f"  {name}: median {np.median(shift):.2f} mm, {np.median(turn):.2f} mrad; "
                f"worst {shift.max():.2f} mm, {turn.max():.2f} mrad",
                flush=True,
            )


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--calibrations", nargs="+", choices=("true", "good", "paper-like"), default=["true"])
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--icp", action="store_true")
    chosen = parser.parse_args()
    run = partial(trials, count=chosen.trials, seed=chosen.seed, with_icp=chosen.icp)
    for kind in chosen.calibrations:
        for room in chosen.rooms:
            run(room, kind)


if __name__ == "__main__":
    main()
