"""A true rig as equations: exact pixels of boards and of the stripe on them, noise, and errors of a calibration.

Written in NumPy, independent of `geometry` and `calibration` on purpose, so that an error in either shows.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxscan
from jaxscan.calibration import CalibrationSettings
from jaxscan.errors import ConfigError
from jaxscan.geometry import Scanner
from jaxscan.observation import BoardViews, Observations, StripeViews
from jaxscan.simulation import LaserSpec, Motion, SimulationConfig, distort, rodrigues, true_scanner, turning_axis


NEAREST_M = 0.05
"""Points nearer to the camera than this are not seen."""


class IdealRig:
    """The true rig, as functions of plain arrays."""

    def __init__(self, config: SimulationConfig) -> None:
        self.config = config
        self.direction, self.point = turning_axis(config)
        board = config.boards.board()
        self.outline = board.outline()[[0, 2]]
        corners = board.corners()[:, :2]
        self.middle = (corners.min(0) + corners.max(0)) / 2
        self.half = np.ptp(corners, axis=0) / 2

    def turned(self, phi: float) -> Motion:
        """Camera coordinates at table angle `phi` to those at angle 0."""
        table = self.config.turntable
        c1, s1, c2, s2 = table.harmonics
        wave = c1 * (np.cos(phi) - 1) + s1 * np.sin(phi) + c2 * (np.cos(2 * phi) - 1) + s2 * np.sin(2 * phi)
        theta = (table.gain * phi + wave) * (1 if table.carries == "scanner" else -1)
        rotation = rodrigues(self.direction, theta)
        return Motion(rotation, self.point - rotation @ self.point)

    def project(self, p: np.ndarray) -> np.ndarray:
        """Pixels [n, 2] of points [n, 3] in front of the camera."""
        x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
        return np.stack(distort(self.config.camera, x, y), -1)

    def bowed(self, xy: np.ndarray) -> np.ndarray:
        """Points [n, 3] of the board at (x, y) [n, 2]."""
        kx, ky = (bow / 1000 for bow in self.config.boards.warp_mm)
        a, b = ((xy - self.middle) / self.half).T
        return np.column_stack([xy, kx * (1 - a * a) + ky * (1 - b * b)])

    def beside(self, p: np.ndarray, laser: LaserSpec) -> np.ndarray:
        """Distance [n] of points [n, 3] from a sheet."""
        n, d = laser.plane()
        g = np.array([0.0, 0.0, 1.0]) - n[2] * n
        g = g / np.linalg.norm(g)
        ahead, aside = p @ g, p @ np.cross(n, g)
        tau = np.arctan2(aside, ahead)
        return p @ n - d - np.hypot(ahead, aside) * tau**2 * (laser.bow[0] + laser.bow[1] * tau)

    def inside(self, q: np.ndarray, margin: float) -> np.ndarray:
        """Which pixels are in the image."""
        size = np.array([self.config.camera.width, self.config.camera.height])
        return np.all((q >= margin) & (q <= size - 1 - margin), axis=-1)

    def crossing(self, pose: Motion, laser: LaserSpec) -> np.ndarray:
        """Where the flat sheet meets the flat board: (x, y) [n, 2] on the board, evenly along."""
        n, d = laser.plane()
        a, b, _ = pose.rotation.T @ n
        rest = d - n @ pose.translation
        low, high = self.outline
        if abs(a) > abs(b):
            y = np.linspace(low[1], high[1], 400)
            xy = np.column_stack([(rest - b * y) / a, y])
        else:
            x = np.linspace(low[0], high[0], 400)
            xy = np.column_stack([x, (rest - a * x) / b])
        return xy[((xy >= low) & (xy <= high)).all(-1)]

    def stripe(self, pose: Motion, laser: int, points: int) -> np.ndarray:
        """Pixels [n, 2] where the stripe on the board meets whole rows of the image."""
        spec = self.config.laser[laser]
        xy = self.crossing(pose, spec)
        if len(xy) < 2:
            return np.zeros((0, 2))
        along = 1 if spec.stripe_axis == "rows" else 0
        start = self.project(pose.apply(self.bowed(xy)))
        order = np.argsort(start[:, along])
        rows = np.arange(np.ceil(start[order[0], along]), np.floor(start[order[-1], along]) + 1)
        if len(rows) > points:
            rows = rows[np.linspace(0, len(rows) - 1, points).round().astype(int)]
        xy = np.stack([np.interp(rows, start[order, along], xy[order, i]) for i in range(2)], -1)

        def misses(xy: np.ndarray) -> np.ndarray:
            p = pose.apply(self.bowed(xy))
            return np.stack([self.beside(p, spec), self.project(p)[:, along] - rows], -1)

        # Newton with slopes by differences: each round leaves 1e-6 of the error before.
        step = 1e-6
        for _ in range(5):
            now = misses(xy)
            by_x, by_y = ((misses(xy + step * unit) - now) / step for unit in np.eye(2))
            xy = xy - np.linalg.solve(np.stack([by_x, by_y], -1), now[..., None])[..., 0]
        p = pose.apply(self.bowed(xy))
        q = self.project(p)
        q[:, along] = np.round(q[:, along])
        on_board = ((xy >= self.outline[0]) & (xy <= self.outline[1])).all(-1)
        return q[on_board & self.inside(q, 0.0) & (p[:, 2] > NEAREST_M)]


_MARGIN_PX = 8.0
_TRIES = 5000
# A board seen flatter than this cosine shows its corners badly.
_FACING = 0.35
# The part of the shorter side of the board that a stripe must at least cross.
_CROSSED = 0.5
_ROLL_DEG = 20.0


class BoardPoses(NamedTuple):
    """Poses of the boards, and the table angles at which each is seen."""

    boards: list[Motion]
    """T_cam0_board of every placement: in the camera frame at angle 0."""
    placement: np.ndarray
    """Placement of each view [views]."""
    angle: np.ndarray
    """Table angle of each view [views], rad."""
    lit: np.ndarray
    """Whether the laser is on in a view [views]."""


class IdealBoards(NamedTuple):
    """Observations of boards, in the shapes that a calibration reads."""

    corner_q: np.ndarray
    """[views, corners, 2], px; all corners are seen."""
    angle: np.ndarray
    placement: np.ndarray
    stripe_q: np.ndarray
    """[stripes, points, 2], px; whole rows (columns for a laser with that stripe axis)."""
    stripe_valid: np.ndarray
    stripe_view: np.ndarray
    stripe_laser: np.ndarray


class PosePlan(NamedTuple):
    """Number of poses to draw, and their table angles."""

    free_views: int
    """Boards seen once."""
    placements: int = 0
    """Boards seen at several angles."""
    angles: int = 1
    """Angles of each placement, evenly spread."""
    span_deg: float = 24.0
    """Range of the angles, around 0."""
    lit: int | None = None
    """How many of the free views show a stripe, the last ones; None: all. The others stand anywhere
    in the image. Placements stand across the stripe, which leaves the board where the table has
    turned far."""


def draw_poses(config: SimulationConfig, seed: int, plan: PosePlan) -> BoardPoses:
    """Random poses that show all corners: free views at angle 0, then placements seen while turning."""
    half = plan.span_deg / 2
    turns = np.deg2rad(np.linspace(-half, half, plan.angles)) if plan.angles > 1 else np.zeros(1)
    dark = 0 if plan.lit is None else plan.free_views - plan.lit
    random = np.random.default_rng(seed)
    boards, placement, angle = [], [], []
    for number in range(plan.free_views + plan.placements):
        free = number < plan.free_views
        stops = np.zeros(1) if free else turns
        boards.append(_draw(config, random, stops, crossed=number >= dark))
        placement += [number] * len(stops)
        angle += list(stops)
    views = np.array(placement)
    return BoardPoses(boards, views, np.array(angle), views >= dark)


def ideal_boards(config: SimulationConfig, poses: BoardPoses, *, points: int = 300) -> IdealBoards:
    """Corners and stripes of boards in the given poses.

    Bow of board and sheets and errors of the table are those of `config`: an estimator is not to
    know them.
    """
    rig = IdealRig(config)
    corners = rig.bowed(config.boards.board().corners()[:, :2])
    seen, rows = [], []
    for view, (number, phi, lit) in enumerate(zip(poses.placement, poses.angle, poses.lit, strict=True)):
        pose = rig.turned(phi).inverse() @ poses.boards[number]
        seen.append(rig.project(pose.apply(corners)))
        for laser in range(len(config.laser)) if lit else ():
            q = rig.stripe(pose, laser, points)
            if len(q):
                rows.append((q, view, laser))
    stripes = np.zeros((len(rows), points, 2))
    valid = np.zeros((len(rows), points), bool)
    for row, (q, _, _) in enumerate(rows):
        stripes[row, : len(q)], valid[row, : len(q)] = q, True
    return IdealBoards(
        corner_q=np.array(seen),
        angle=poses.angle,
        placement=poses.placement.astype(np.int32),
        stripe_q=stripes,
        stripe_valid=valid,
        stripe_view=np.array([view for _, view, _ in rows], np.int32),
        stripe_laser=np.array([laser for _, _, laser in rows], np.int32),
    )


def add_noise(
    ideal: IdealBoards,
    random: np.random.Generator,
    *,
    corner_px: float = 0.1,
    stripe_px: float = 0.15,
    correlation: float = 0.0,
) -> IdealBoards:
    """The same with Gaussian noise.

    Args:
        corner_px: Standard deviation of each coordinate of a corner [px].
        stripe_px: Standard deviation across the stripe [px].
        correlation: Between neighbouring points of a stripe, falling off as its powers: n points
            are worth n (1 - correlation) / (1 + correlation), a quarter of them at 0.6 [1].
    """
    corner_q = ideal.corner_q + corner_px * random.normal(size=ideal.corner_q.shape)
    white = random.normal(size=ideal.stripe_valid.shape)
    noise = white.copy()
    for point in range(1, white.shape[1]):
        noise[:, point] = correlation * noise[:, point - 1] + np.sqrt(1 - correlation**2) * white[:, point]
    return ideal._replace(corner_q=corner_q, stripe_q=ideal.stripe_q + stripe_px * _beside(ideal, noise))


def _beside(ideal: IdealBoards, shift: np.ndarray) -> np.ndarray:
    """Shifts across the stripes as shifts of whole rows' sub-pixel coordinate [stripes, points, 2]."""
    moved = np.zeros_like(ideal.stripe_q)
    for row, (q, valid) in enumerate(zip(ideal.stripe_q, ideal.stripe_valid, strict=True)):
        q = q[valid]
        if len(q) < 2:
            continue
        along = int(np.all(q[:, 1] == np.round(q[:, 1])))
        # A stripe that leans on its rows moves farther along them than across itself.
        lean = np.gradient(q[:, 1 - along]) / np.gradient(q[:, along])
        moved[row, valid, 1 - along] = shift[row, valid] * np.hypot(1.0, lean)
    return moved


def _draw(config: SimulationConfig, random: np.random.Generator, stops: np.ndarray, *, crossed: bool) -> Motion:
    """T_cam0_board of a board that is wholly seen at every stop."""
    rig, spec = IdealRig(config), config.boards
    corners = np.column_stack([spec.board().corners()[:, :2], np.zeros(len(spec.board().corners()))])
    middle = np.append(rig.middle, 0.0)
    size = np.ptp(rig.outline, axis=0)
    for _ in range(_TRIES):
        z = float(np.exp(random.uniform(*np.log(spec.range_m))))
        laser = config.laser[int(random.integers(len(config.laser)))]
        n, d = laser.plane()
        x = random.uniform(-0.45, 0.45) * z * config.camera.width / config.camera.fx
        y = random.uniform(-0.45, 0.45) * z * config.camera.height / config.camera.fy
        if crossed and laser.stripe_axis == "rows":
            x = (d - n[2] * z - n[1] * y) / n[0] + random.uniform(-0.3, 0.3) * size[0]
        elif crossed:
            y = (d - n[2] * z - n[0] * x) / n[1] + random.uniform(-0.3, 0.3) * size[1]
        way = random.uniform(0, 2 * np.pi)
        tilt, roll = np.deg2rad([random.uniform(*spec.tilt_deg), random.uniform(-_ROLL_DEG, _ROLL_DEG)])
        rotation = rodrigues(np.array([np.cos(way), np.sin(way), 0.0]), tilt)
        rotation = rotation @ rodrigues(np.array([0.0, 0.0, 1.0]), roll)
        pose = Motion(rotation, np.array([x, y, z]) - rotation @ middle)
        if crossed and not _crosses(rig, pose, laser):
            continue
        if all(_shows(rig, rig.turned(phi).inverse() @ pose, corners) for phi in stops):
            return pose
    raise ConfigError(
        f"No pose of the board ({spec.columns} x {spec.rows}, {spec.square_mm} mm) was found within "
        f"{list(spec.range_m)} m that the camera sees whole at {len(stops)} table angle(s): change [boards] range_m."
    )


def _shows(rig: IdealRig, pose: Motion, corners: np.ndarray) -> bool:
    p = pose.apply(corners)
    middle = p.mean(0)
    facing = pose.rotation[:, 2] @ middle > _FACING * np.linalg.norm(middle)
    # Beyond the field of view the lens model folds back into the image.
    camera = rig.config.camera
    reach = 0.7 * np.hypot(camera.width / camera.fx, camera.height / camera.fy)
    ahead = (p[:, 2] > NEAREST_M) & (np.hypot(p[:, 0], p[:, 1]) < reach * p[:, 2])
    return bool(facing and ahead.all() and rig.inside(rig.project(p), _MARGIN_PX).all())


def _crosses(rig: IdealRig, pose: Motion, laser: LaserSpec) -> bool:
    xy = rig.crossing(pose, laser)
    return len(xy) > 1 and bool(np.linalg.norm(xy[-1] - xy[0]) >= _CROSSED * np.ptp(rig.outline, axis=0).min())


CORNER_PX, STRIPE_PX = 0.1, 0.15
CORRELATIONS = {"white": 0.0, "correlated": 0.6}
"""Noise along the stripe: between neighbouring points; at 0.6, n points are worth n / 4."""
SETTINGS = CalibrationSettings(judge=False)
"""The tests of the models take longer than the solve and are not looked at here."""
REFERENCE = Path(__file__).resolve().parents[1] / "configs" / "reference.toml"


def reference() -> SimulationConfig:
    """The rig that the targets refer to."""
    return jaxscan.load_simulation(REFERENCE)


def drawn(config: SimulationConfig, random: np.random.Generator) -> SimulationConfig:
    """The rig with values drawn from the priors where a calibration knows nothing else.

    Gain and harmonics of the table, and the ratio of the focal lengths: with their true values at the prior's mean in
    every trial, errors would be smaller than stated.
    """
    priors = SETTINGS.priors
    harmonics = {
        "gain": 1.0 + priors["gain"] * random.normal(),
        "harmonics": tuple(priors["harmonics"] * random.normal(size=4)),
    }
    camera = config.camera.model_copy(update={"fy": config.camera.fx / (1.0 + priors["aspect"] * random.normal())})
    return config.model_copy(update={"turntable": config.turntable.model_copy(update=harmonics), "camera": camera})


def observations(ideal: IdealBoards, config: SimulationConfig) -> Observations:
    """Ideal boards as `calibrate_observations` takes them, with the sigmas that a detector would state."""
    views, corners = ideal.corner_q.shape[:2]
    return Observations(
        board=config.boards.board(),
        corners=BoardViews(
            q=ideal.corner_q,
            sigma=np.full((views, corners), CORNER_PX),
            valid=np.ones((views, corners), bool),
            angle=ideal.angle,
            placement=ideal.placement,
            record=np.arange(views, dtype=np.int32),
        ),
        stripes=StripeViews(
            q=ideal.stripe_q,
            sigma=np.full(ideal.stripe_valid.shape, STRIPE_PX),
            valid=ideal.stripe_valid,
            view=ideal.stripe_view,
            laser=ideal.stripe_laser,
        ),
        width=config.camera.width,
        height=config.camera.height,
        laser_names=tuple(laser.name for laser in config.laser),
        up=config.camera.up,
        carries=config.turntable.carries,
    )


def errors(scanner: Scanner, config: SimulationConfig) -> np.ndarray:
    """Estimate minus truth in the scanner's minimal coordinates, to first order."""
    camera, true = config.camera, true_scanner(config)
    lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
    parts = [*(np.asarray(scanner.camera.parameters()) - np.array([camera.fx, camera.fy, *camera.centre(), *lens]))]
    for laser in range(len(config.laser)):
        # The truth as seen from the estimate's tangent vectors, hence the minus.
        parts += list(-scanner.lasers.basis[laser] @ true.lasers.normal[laser])
        parts += [scanner.lasers.distance[laser] - true.lasers.distance[laser]]
        parts += list(scanner.lasers.bow[laser] - true.lasers.bow[laser])
    table, axis = scanner.turntable, true.turntable
    parts += list(-table.basis @ axis.direction) + list(table.basis @ (table.point - axis.point))
    parts += [table.gain - axis.gain, *(table.harmonics - axis.harmonics)]
    return np.array(parts, float)


def to_true_tangents(scanner: Scanner, config: SimulationConfig) -> np.ndarray:
    """Matrix from coordinates in the estimate's tangent vectors to those in the truth's.

    The estimate's own may stand at a right angle to those of the next one: they are drawn beside
    the coordinate axis that a direction is farthest from, and of an upright axis that is a toss-up.
    """
    true, names = true_scanner(config), list(scanner.parameter_names())
    turned = np.eye(len(names))
    pairs = [("axis.d1", scanner.turntable.basis, true.turntable.basis)]
    pairs += [("axis.p1", scanner.turntable.basis, true.turntable.basis)]
    for index, name in enumerate(scanner.laser_names):
        pairs += [(f"laser.{name}.n1", scanner.lasers.basis[index], true.lasers.basis[index])]
    for first, own, wanted in pairs:
        at = slice(names.index(first), names.index(first) + 2)
        turned[at, at] = np.asarray(wanted) @ np.asarray(own).T
    return turned
