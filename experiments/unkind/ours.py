"""jaxscan on a world, through its public functions alone."""

import numpy as np

import jaxscan
from experiments.unkind.figures import sheet_grid
from experiments.unkind.truth import Dimension, Estimate, Rig, Rows, Truth, clocks, passed, ray_grid
from jaxscan.geometry import lit_points, lit_slopes


def board_rows(calibration: jaxscan.Calibration, records: int, lines: int, *, solved: bool) -> Rows:
    """The points of stripes on boards: as the solve kept and weighed them, or all as they were observed."""
    seen, fit = calibration.observations, calibration.fit
    assert seen is not None and fit is not None
    u, sigma = np.zeros((records, lines)), np.ones((records, lines))
    valid = np.zeros((records, lines), bool)
    stripes = seen.stripes
    own = (fit.stripe_sigma, fit.stripe_inlier) if solved else (stripes.sigma, stripes.valid)
    for q, spread, kept, view in zip(stripes.q, *own, stripes.view, strict=True):
        record = int(seen.corners.record[view])
        kept = np.asarray(kept)
        row = np.rint(np.asarray(q)[kept, 1]).astype(int)
        u[record, row], sigma[record, row], valid[record, row] = np.asarray(q)[kept, 0], np.asarray(spread)[kept], True
    return Rows(u, sigma, valid)


def seen_rows(cloud: jaxscan.PointCloud, scanner: jaxscan.Scanner) -> Rows:
    """Centres [px] behind the points of a cloud: projected by the scanner that they were made with."""
    angle, valid = np.asarray(cloud.angle, np.float64)[:, None], np.asarray(cloud.valid)
    u = np.where(valid, jaxscan.pixels(scanner.rig, np.where(valid[..., None], cloud.xyz, 1.0), angle)[..., 0], 0.0)
    rows = np.broadcast_to(np.arange(u.shape[1], dtype=np.float64), u.shape)
    # d range / d u along the row gives the sigma back in pixels.
    p, incidence = lit_points(scanner.rig, np.stack([u, rows], -1), 0)
    slope = (p * lit_slopes(scanner.rig, p, incidence, 0)[..., 0]).sum(-1)
    slope = slope / np.maximum(np.linalg.norm(p, axis=-1), 1e-12)
    sigma = np.asarray(cloud.sigma_random, np.float64) / np.maximum(np.abs(slope), 1e-12)
    return Rows(u, sigma, np.asarray(cloud.valid))


def own_rig(scanner: jaxscan.Scanner, truth: Truth) -> Rig:
    """The calibrated rig as the judge compares it."""
    u, v = ray_grid(truth.size)
    at_u, at_v, _ = sheet_grid(truth)
    rig, table = scanner.rig, scanner.turntable
    points, _ = lit_points(rig, np.stack([at_u, at_v], -1), 0)
    return Rig(
        np.asarray(jaxscan.rays(rig, np.stack([u, v], -1))),
        np.asarray(points),
        np.asarray(table.direction),
        np.asarray(table.point),
    )


def dimensions(cloud: jaxscan.PointCloud, scanner: jaxscan.Scanner, truth: Truth) -> list[Dimension]:
    """Both horizontal dimensions, as `measure_room` finds them."""
    try:
        box = jaxscan.measure_room(cloud, scanner=scanner)
    except jaxscan.MeasurementError as problem:
        print(f"  no room: {problem}")
        return []
    frame = np.asarray(scanner.scanner_from_camera())[:3, :3]
    found = []
    for side in (box.length, box.width):
        if side is None:
            continue
        # Which pair of walls it is, its direction says.
        along = np.abs(truth.wall_normals[::2] @ frame.T @ np.asarray(side.direction))
        found.append(Dimension(side.value_m, side.sigma_m, float(truth.dimensions[along.argmax()])))
    return found


def estimate(folder: str, truth: Truth) -> Estimate:
    """jaxscan on both captures of a world."""
    start = clocks()
    boards = jaxscan.open_capture(f"{folder}/boards")
    calibration = jaxscan.calibrate(boards)
    calibrated = clocks()
    scanner = calibration.scanner
    assert scanner is not None
    sweep = jaxscan.open_capture(f"{folder}/sweep")
    stripes = jaxscan.extract(sweep, scanner).stripes
    cloud = jaxscan.reconstruct(sweep, scanner, stripes=stripes)
    seconds = passed(start, calibrated, clocks())
    rows = Rows(*(np.asarray(part) for part in (stripes.u, stripes.sigma, stripes.valid)))
    rows = rows._replace(u=rows.u.astype(float), sigma=rows.sigma.astype(float))
    return Estimate(
        own_rig(scanner, truth),
        *(board_rows(calibration, len(boards), int(truth.size[1]), solved=solved) for solved in (True, False)),
        rows,
        seen_rows(cloud, scanner),
        dimensions(cloud, scanner, truth),
        seconds,
    )
