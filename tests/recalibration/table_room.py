"""A box room with furniture, seen by an ideal rig: stripes by intersecting planes, in NumPy alone."""

import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.recalibration import SweepStripes


WIDTH, HEIGHT = 2048, 1638
FX, FY, CX, CY = 2894.462, 2887.338, 1016.814, 817.261
SHEET = np.array([-7.606, -1.685, 1.0]), 1.296203
AXIS, FOOT = np.array([-0.018237, -0.999833, -0.000846]), np.array([-0.009786, 0.000358, -0.212275])
WALLS = np.array(
    [[1.0, 0, 0, 1.97], [-1, 0, 0, 1.85], [0, 1, 0, 3.15], [0, -1, 0, 3.0], [0, 0, 1, 1.3], [0, 0, -1, 1.2]]
)
"""Outward normals and distances from the axis [m] of a room of 3.82 x 6.15 x 2.5 m."""


def paper_scanner(lines=60):
    """The scanner of the paper without distortion; its image has fewer lines, over the same field of view."""
    tall = lines / HEIGHT
    camera = Pinhole(fx=FX, fy=tall * FY, cx=CX, cy=tall * CY, distortion=np.zeros(5), width=WIDTH, height=lines)
    return Scanner.from_parts(camera, LaserSheet.from_plane(*SHEET), Turntable.from_axis(AXIS, FOOT))


def knocked(scanner, rng, size=1.0):
    """A scanner as a poor calibration has it: every coordinate away by as much as such a calibration errs."""
    sigma = {"fx": 8.0, "fy": 8.0, "cx": 8.0, "cy": 8.0, "k1": 0.01, "k2": 0.02, "gain": 3e-4}
    step = np.zeros(len(scanner.parameter_names()))
    for k, name in enumerate(scanner.parameter_names()):
        last = name.split(".")[-1]
        step[k] = sigma.get(
            last, {"n1": 1e-3, "n2": 1e-3, "d": 5e-4, "d1": 1e-3, "d2": 1e-3, "p1": 1e-3, "p2": 1e-3}.get(last, 0.0)
        )
    return scanner.retract(size * step * rng.standard_normal(len(step)))


def box(centre, size):
    """The four upright faces of a piece of furniture: normal, distance, centre, half size; up to the ceiling or not."""
    (x, y, z), (a, b, _) = centre, size
    return [
        (
            np.array(n, float),
            np.dot(n, (x + n[0] * a / 2, y + n[1] * b / 2, z)),
            np.array(centre, float),
            np.array(size) / 2,
        )
        for n in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
    ]


FURNITURE = [
    *box((-1.4, 1.2, -0.6), (0.6, 1.0, 1.2)),
    *box((1.6, -1.8, -0.2), (0.45, 0.8, 2.0)),
    *box((0.3, 2.9, -0.7), (1.2, 0.35, 1.0)),
]


def sweep(scanner, phi, *, true=None, rng=None, noise=0.1, furniture=(), walls=WALLS, yaw=0.3):
    """Stripes of a sweep.

    Args:
        scanner: The true rig, without distortion.
        phi: Angles of the journal [rad].
        true: Angles about the axis to which the table turned [rad]; None: those of the journal.
        rng: For the noise.
        noise: Standard deviation of a centre [px].
    """
    theta = np.asarray(phi if true is None else true, float)
    frame = np.asarray(scanner.scanner_from_camera())
    camera = scanner.camera
    lines = camera.height
    y = (np.arange(lines) - float(camera.cy)) / float(camera.fy)
    n, d = np.asarray(scanner.lasers.normal)[0], float(np.asarray(scanner.lasers.distance)[0])
    turn = theta + yaw
    cos, sin, zero = np.cos(turn), np.sin(turn), np.zeros_like(turn)
    rot = np.stack(
        [np.stack([cos, -sin, zero], -1), np.stack([sin, cos, zero], -1), np.stack([zero, zero, zero + 1], -1)], -2
    )
    best = np.full((len(theta), lines), np.inf)
    where = np.zeros((len(theta), lines))

    def hit(normal, distance):
        """Depth and x/z of the points of one plane."""
        m = normal @ rot @ frame[:3, :3]
        h = distance - normal @ rot @ frame[:3, 3]
        # n0 a + (n1 y + n2) Z = d;  m0 a + (m1 y + m2) Z = h
        a11, a12 = n[0], n[1] * y + n[2]
        a21, a22 = m[:, :1], m[:, 1:2] * y + m[:, 2:3]
        det = a11 * a22 - a12 * a21
        z = (a11 * h[:, None] - a21 * d) / det
        a = (d * a22 - a12 * h[:, None]) / det
        ok = (z > 0.3) & (np.abs(a / z * FX) < WIDTH / 2)
        p = np.stack([a, y * z, z], -1) @ frame[:3, :3].T + frame[:3, 3]
        return z, a / z, ok, np.einsum("rij,rlj->rli", rot, p)

    for *normal, distance in walls:
        z, x, ok, p = hit(np.array(normal), distance)
        inside = np.all(p @ walls[:, :3].T <= walls[:, 3] + 1e-6, axis=-1)
        nearer = ok & inside & (z < best)
        best, where = np.where(nearer, z, best), np.where(nearer, x, where)
    for normal, distance, centre, half in furniture:
        z, x, ok, p = hit(normal, distance)
        inside = np.all(np.abs(p - centre) <= half + 1e-6, axis=-1)
        nearer = ok & inside & (z < best)
        best, where = np.where(nearer, z, best), np.where(nearer, x, where)
    u = FX * where + CX
    if rng is not None:
        u = u + noise * rng.standard_normal(u.shape)
    count = len(theta)
    return SweepStripes(
        "room",
        u.astype(np.float32),
        np.full(u.shape, noise, np.float32),
        np.ones(u.shape, np.float32),
        np.isfinite(best) & (u > 0) & (u < WIDTH - 1),
        np.arange(count),
        np.zeros(count, int),
        np.asarray(phi, float),
        "rows",
    )
