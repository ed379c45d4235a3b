"""A rig, boards and what the rig sees of them, by a forward model in plain NumPy.

Nothing here comes from the package but the board and the containers: projection, turning and
the stripe are written out again, so a wrong sign on one side shows as a misfit.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from jaxscan.geometry import Chessboard
from jaxscan.observation import BoardViews, Observations, StripeViews


@dataclass(frozen=True)
class Rig:
    """The truth."""

    focal: tuple[float, float] = (1201.0, 1202.0)
    centre: tuple[float, float] = (644.0, 507.0)
    lens: tuple[float, ...] = (-0.10, 0.06, 4e-4, -3e-4, 0.0)
    """Of a pinhole k1 k2 p1 p2 k3; four numbers make a fisheye's k1 k2 k3 k4, two a double sphere's xi, alpha."""
    size: tuple[int, int] = (1280, 1024)
    normals: tuple[tuple[float, float, float], ...] = ((0.990, -0.010, 0.140),)
    distances: tuple[float, ...] = (0.200,)
    axis: tuple[float, float, float] = (0.010, -0.9999, 0.012)
    axis_point: tuple[float, float, float] = (0.020, 0.0, -0.150)
    gain: float = 1.0
    harmonics: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    warp: tuple[float, float] = (0.0, 0.0)
    bend: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    """Height [m] beside the bow at coordinates that are +-1 at the outer corners."""
    paper: Callable[[int], Callable[[np.ndarray, np.ndarray], np.ndarray]] | None = None
    """The bend of each placement of a board that is no plate."""
    print_error: Callable[[np.ndarray], np.ndarray] | None = None
    """Shifts [n, 2] of the printed corners [n, 2], m."""
    carries: str = "scanner"
    travel: tuple[float, float, float] = (0.955, 0.05, -0.29)
    """Where a linear stage moves the camera."""
    up: str = "-v"
    wobble: tuple[tuple[float, float, float], ...] = ()
    """Tilt of the axis at each stop of a placement, as a rotation vector [rad]; none where empty."""
    spread: float = 0.2
    """How far above and below the middle boards are held, over their depth [1]."""
    board: Chessboard = field(default_factory=lambda: Chessboard(9, 7, 0.035))

    def wide(self):
        return len(self.lens) != 5

    def normal(self, laser=0):
        n = np.array(self.normals[laser])
        return n / np.linalg.norm(n)

    def direction(self):
        a = np.array(self.axis)
        return a / np.linalg.norm(a)

    def travelling(self):
        t = np.array(self.travel)
        return t / np.linalg.norm(t)

    def foot(self):
        p, a = np.array(self.axis_point), self.direction()
        return p - (p @ a) * a


def rodrigues(vector):
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def project(rig, points):
    if rig.wide():
        return (project_fisheye if len(rig.lens) == 4 else project_double_sphere)(rig, points)
    x = points[..., :2] / points[..., 2:]
    k1, k2, p1, p2, k3 = rig.lens
    r2 = (x**2).sum(-1)
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u, v = x[..., 0], x[..., 1]
    u1 = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    v1 = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    return np.stack([rig.focal[0] * u1 + rig.centre[0], rig.focal[1] * v1 + rig.centre[1]], -1)


def project_fisheye(rig, points):
    radius = np.hypot(points[..., 0], points[..., 1])
    theta = np.arctan2(radius, points[..., 2])
    k1, k2, k3, k4 = rig.lens
    theta_d = theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9
    return rig.centre + np.array(rig.focal) * (theta_d / np.maximum(radius, 1e-300))[..., None] * points[..., :2]


def project_double_sphere(rig, points):
    """By the angle from the centre of the second sphere, whose centre lies xi in front of the first's."""
    xi, alpha = rig.lens
    radius = np.hypot(points[..., 0], points[..., 1])
    theta = np.arctan2(radius, points[..., 2])
    second = np.arctan2(np.sin(theta), xi + np.cos(theta))
    r = np.sin(second) / (alpha + (1 - alpha) * np.cos(second))
    return rig.centre + np.array(rig.focal) * (r / np.maximum(radius, 1e-300))[..., None] * points[..., :2]


def seen_from(rig, rotation, translation, phi):
    """A board pose of angle 0 as the camera sees it at table angle phi, or at position phi [m] of a stage."""
    if rig.carries == "linear":
        return rotation, translation - rig.gain * phi * rig.travelling()
    c1, s1, c2, s2 = rig.harmonics
    theta = (
        rig.gain * phi + c1 * (np.cos(phi) - 1) + s1 * np.sin(phi) + c2 * (np.cos(2 * phi) - 1) + s2 * np.sin(2 * phi)
    )
    theta = theta if rig.carries == "scanner" else -theta
    back = rodrigues(-theta * rig.direction())
    return back @ rotation, back @ (translation - rig.foot()) + rig.foot()


def tilted(rig, rotation, translation, tilt):
    """A board pose as the camera sees it whose axis is tilted about its foot."""
    turn = rodrigues(np.array(tilt))
    return turn @ rotation, turn @ (translation - rig.foot()) + rig.foot()


def scanned(camera, sheet, table, q, phi):
    """Points [n, 3] of a rig given by plain numbers: rays of the pixels, sheet, turn about the axis.

    Args:
        camera: `(focal, centre, lens)` of a pinhole.
        sheet: `(normal, distance)`.
        table: `(direction, foot, gain, harmonics)`.
        q: Pixels [n, 2].
        phi: Angles of the table [n].
    """
    focal, centre, lens = camera
    target = (q - np.array(centre)) / np.array(focal)
    x, lens_only = target, Rig(focal=(1.0, 1.0), centre=(0.0, 0.0), lens=tuple(lens))
    for _ in range(60):
        x = x + target - project(lens_only, np.column_stack([x, np.ones(len(x))]))
    p = np.column_stack([x, np.ones(len(x))])
    normal, distance = sheet
    p = p * (distance / (p @ np.array(normal)))[:, None]
    direction, foot, gain, (c1, s1, c2, s2) = table
    theta = gain * phi + c1 * (np.cos(phi) - 1) + s1 * np.sin(phi) + c2 * (np.cos(2 * phi) - 1) + s2 * np.sin(2 * phi)
    turned = [rodrigues(angle * np.array(direction)) @ (at - foot) + foot for angle, at in zip(theta, p, strict=True)]
    return np.array(turned)


def board_height(rig, x, y):
    columns, rows = rig.board.grid()
    half = np.array([columns - 1, rows - 1]) / 2 * rig.board.square
    a, b = (x - half[0]) / half[0], (y - half[1]) / half[1]
    bow = rig.warp[0] * (1 - a * a) + rig.warp[1] * (1 - b * b)
    return bow if rig.bend is None else bow + rig.bend(a, b)


def stripe_on_board(rig, rotation, translation, laser, count):
    """Points [n, 3] of the board (with its bow and bend) on the sheet, camera frame."""
    n = rig.normal(laser)
    # In board coordinates the sheet is a x + b y + c z = d; walk along y, or along x.
    a, b, c = rotation.T @ n
    d = rig.distances[laser] - n @ translation
    (x0, y0), _, (x1, y1), _ = rig.board.outline()
    if abs(a) > abs(b):
        y = np.linspace(y0, y1, count)
        x, z = np.zeros(count), np.zeros(count)
        for _ in range(60):
            x = (d - b * y - c * z) / a
            z = board_height(rig, x, y)
    else:
        x = np.linspace(x0, x1, count)
        y, z = np.zeros(count), np.zeros(count)
        for _ in range(60):
            y = (d - a * x - c * z) / b
            z = board_height(rig, x, y)
    inside = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    return np.column_stack([x, y, z])[inside] @ rotation.T + translation


def in_reach(rig, points):
    """Whether points lie within 100 degrees of the axis: a wide lens may end soon after."""
    return not rig.wide() or (points[:, 2] > np.cos(np.radians(100)) * np.linalg.norm(points, axis=1)).all()


def hold_ahead(rig, random, middle, tilt_deg):
    """A board in front of the camera, beside the first sheet."""
    z = random.uniform(0.7, 1.3)
    x = rig.distances[0] / rig.normal()[0] - z * rig.normal()[2] / rig.normal()[0] + random.uniform(-0.05, 0.05)
    axis = random.normal(size=3) * np.array([1, 1, 0.3])
    rotation = rodrigues(np.radians(random.uniform(10, tilt_deg)) * axis / np.linalg.norm(axis))
    return rotation, np.array([x, random.uniform(-rig.spread, rig.spread) * z, z]) - rotation @ middle


def hold_around(rig, random, middle, tilt_deg):
    """A board facing the camera anywhere within 97 degrees of its axis, two of three times on the first sheet."""
    n = rig.normal()
    g = np.array([0.0, 0.0, 1.0]) - n[2] * n
    g = g / np.linalg.norm(g)
    tau, distance = np.radians(random.uniform(-90, 90)), random.uniform(0.45, 0.9)
    towards = np.cos(tau) * g + np.sin(tau) * np.cross(n, g)
    place = rig.distances[0] * n + distance * towards
    if random.random() < 1 / 3:
        theta, psi = np.radians(97 * np.sqrt(random.random())), random.uniform(0, 2 * np.pi)
        place = distance * np.array([np.sin(theta) * np.cos(psi), np.sin(theta) * np.sin(psi), np.cos(theta)])
    axis = np.cross([0.0, 0.0, 1.0], place)
    facing = rodrigues(np.arctan2(np.linalg.norm(axis), place[2]) * axis / np.linalg.norm(axis))
    axis = random.normal(size=3) * np.array([1, 1, 0.3])
    rotation = facing @ rodrigues(np.radians(random.uniform(10, tilt_deg)) * axis / np.linalg.norm(axis))
    return rotation, place - rotation @ middle


def observe(rig, *, free=10, placements=2, angles=5, span_deg=20.0, points=60, seed=0, stripes=True, tilt_deg=35.0):
    """Perfect observations: free board views at angle 0, then placements seen from several angles."""
    random = np.random.default_rng(seed)
    views, number = [], 0
    while number < free + placements:
        own, corners = rig, rig.board.corners()
        if rig.paper is not None:
            own = replace(rig, bend=rig.paper(number))
        corners[:, 2] += board_height(own, corners[:, 0], corners[:, 1])
        if rig.print_error is not None:
            corners[:, :2] += rig.print_error(corners[:, :2])
        middle = corners.mean(0)
        turning = number >= free
        # A linear stage goes 0.16 m.
        half = 0.08 if rig.carries == "linear" else np.radians(span_deg / 2)
        stops = np.linspace(-half, half, angles) if turning else np.zeros(1)
        hold = hold_around if rig.wide() else hold_ahead
        rotation, translation = hold(rig, random, middle, tilt_deg)
        poses = [seen_from(rig, rotation, translation, phi) for phi in stops]
        if turning and rig.wobble:
            poses = [tilted(rig, *pose, rig.wobble[(number * angles + stop) % len(rig.wobble)])
                     for stop, pose in enumerate(poses)]  # fmt: skip
        q = [project(rig, corners @ r.T + t) for r, t in poses]
        if all((p > 5).all() and (p < np.array(rig.size) - 6).all() for p in q) and all(
            in_reach(rig, corners @ r.T + t) for r, t in poses
        ):
            views += [(p, phi, number, own, *pose) for p, phi, pose in zip(q, stops, poses, strict=True)]
            number += 1
    rows = []
    for index, (_, _, _, own, r, t) in enumerate(views):
        for laser in range(len(rig.normals)) if stripes else ():
            p = stripe_on_board(own, r, t, laser, points)
            p = p[p[:, 2] > 0.2] if not rig.wide() else p
            s = project(rig, p) if len(p) else np.zeros((0, 2))
            s = s[((s > 0) & (s < np.array(rig.size) - 1)).all(-1)] if len(s) else s
            if len(s):
                rows.append((s, index, laser))
    q = np.zeros((len(rows), points, 2))
    valid = np.zeros((len(rows), points), bool)
    for i, (s, _, _) in enumerate(rows):
        q[i, : len(s)], valid[i, : len(s)] = s, True
    count = len(views)
    return Observations(
        board=rig.board,
        corners=BoardViews(
            q=np.array([v[0] for v in views]),
            sigma=np.full((count, len(corners)), 0.1),
            valid=np.ones((count, len(corners)), bool),
            angle=np.array([v[1] for v in views]),
            placement=np.array([v[2] for v in views], np.int32),
            record=np.arange(count, dtype=np.int32),
        ),
        stripes=StripeViews(
            q=q,
            sigma=np.full(valid.shape, 0.15),
            valid=valid,
            view=np.array([r[1] for r in rows], np.int32),
            laser=np.array([r[2] for r in rows], np.int32),
        ),
        width=rig.size[0],
        height=rig.size[1],
        laser_names=tuple(f"laser{i}" if i else "laser" for i in range(len(rig.normals))),
        up=rig.up,
        carries=rig.carries,
    )


def with_noise(observations, seed, *, corner=1.0, stripe=1.0):
    """The same with Gaussian noise of the stated sigmas, times `corner` and `stripe`."""
    random = np.random.default_rng(1000 + seed)
    c, s = observations.corners, observations.stripes
    corners = replace(c, q=c.q + corner * c.sigma[..., None] * random.normal(size=c.q.shape))
    # Isotropic, so that the part across the stripe has the stated sigma whichever way it runs.
    stripes = replace(s, q=s.q + stripe * s.sigma[..., None] * random.normal(size=s.q.shape))
    return replace(observations, corners=corners, stripes=stripes)


def errors(scanner, rig):
    """Estimate minus truth in the scanner's minimal coordinates, to first order."""
    camera, table = scanner.camera, scanner.turntable
    parts = [camera.fx - rig.focal[0], camera.fy - rig.focal[1], camera.cx - rig.centre[0], camera.cy - rig.centre[1]]
    parts += list(camera.distortion - np.array(rig.lens))
    for laser in range(len(rig.normals)):
        # The truth seen from the estimate's tangent vectors, hence the minus.
        parts += list(-scanner.lasers.basis[laser] @ rig.normal(laser))
        parts += [scanner.lasers.distance[laser] - rig.distances[laser], *scanner.lasers.bow[laser]]
    if rig.carries == "nothing":
        return np.array([float(p) for p in parts])
    if rig.carries == "linear":
        parts += [*(-table.basis @ rig.travelling()), table.gain - rig.gain]
        return np.array([float(p) for p in parts])
    sense = np.sign(table.direction @ rig.direction())
    parts += list(-table.basis @ (sense * rig.direction()))
    parts += list(table.basis @ (table.point - rig.foot()))
    parts += [table.gain - sense * rig.gain, *(table.harmonics - sense * np.array(rig.harmonics))]
    return np.array([float(p) for p in parts])


@pytest.fixture(scope="session")
def world():
    """The generator, as one namespace."""

    class World:
        pass

    for name, value in {
        "Rig": Rig,
        "observe": observe,
        "with_noise": with_noise,
        "errors": errors,
        "project": project,
        "rodrigues": rodrigues,
        "scanned": scanned,
    }.items():
        setattr(World, name, staticmethod(value) if not isinstance(value, type) else value)
    return World
