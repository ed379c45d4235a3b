"""Forward model of a true rig: exact pixels of board points and of the stripe on the board.

Written in NumPy, independent of `geometry` and `calibration` on purpose, so that an error in either
shows.
"""

from collections.abc import Callable

import numpy as np

from jaxscan.simulation import (
    CameraSpec,
    LaserSpec,
    Motion,
    SimulationConfig,
    distort,
    rodrigues,
    turning_axis,
    undistort,
)


NEAREST_M = 0.05
"""Points nearer to the camera than this are not seen."""


class IdealRig:
    """The true rig, as functions of plain arrays."""

    def __init__(self, config: SimulationConfig, lens_px: float = 0.0) -> None:
        self.config = config
        self.flaw = lens_flaw(config.camera, lens_px)
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
        return np.stack(distort(self.config.camera, x, y), -1) + self.flaw(x, y)

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


def lens_flaw(camera: CameraSpec, worth_px: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Shift [n, 2], px, at normalised coordinates: r^8 less the part that the lens model absorbs."""

    def terms(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """r^8, and the shift by a change of each modelled parameter, as [2 n] and [2 n, 9]."""
        r2, zero, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
        pairs = [(x, zero), (zero, y), (one, zero), (zero, one)]
        pairs += [(x * r2**power, y * r2**power) for power in (1, 2, 3)]
        pairs += [(2 * x * y, r2 + 2 * y * y), (r2 + 2 * x * x, 2 * x * y)]
        return np.concatenate([x * r2**4, y * r2**4]), np.stack([np.concatenate(pair) for pair in pairs], -1)

    if worth_px == 0:
        return lambda x, y: np.zeros((len(x), 2))
    width, height = camera.width - 1, camera.height - 1
    u, v = np.meshgrid(np.linspace(0, width, 49), np.linspace(0, height, 33))
    target, basis = terms(*undistort(camera, u.ravel(), v.ravel()))
    taken = np.linalg.lstsq(basis, target, rcond=None)[0]

    def left(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        target, basis = terms(x, y)
        return (target - basis @ taken).reshape(2, -1).T

    ends = undistort(camera, np.array([0.0, width, 0.0, width]), np.array([0.0, 0.0, height, height]))
    scale = worth_px / np.linalg.norm(left(*ends), axis=-1).mean()
    return lambda x, y: scale * left(x, y)
