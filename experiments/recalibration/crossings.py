"""Where the rows of images meet the laser's sheet and the room: pixels with the simulator's lens, sheet and table."""

import numpy as np

from experiments.recalibration.surfaces import RoomSurfaces
from experiments.worlds.ideal_rig import IdealRig
from jaxscan.simulation import Motion, SimulationConfig, distort, make_rig, rodrigues, undistort


def room_from_rig(config: SimulationConfig, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> Motion:
    """Scanner coordinates to the room's, of a rig that leans about its own x and y."""
    assert config.room is not None
    lean = [rodrigues(axis, np.deg2rad(tilt)) for axis, tilt in zip(np.eye(3), tilt_deg, strict=False)]
    yaw = rodrigues(np.array([0.0, 0.0, 1.0]), np.deg2rad(config.room.yaw_deg))
    return Motion(yaw @ lean[0] @ lean[1], np.array(config.room.rig_m))


class Crossings:
    """Where the rows of the camera's images meet one sheet and the room."""

    def __init__(self, rig: IdealRig, room: RoomSurfaces, place: Motion, laser: int, rows: np.ndarray) -> None:
        """`place` carries scanner coordinates to the room's."""
        self.rig, self.room, self.rows = rig, room, rows.astype(float)
        self.config, self.spec = rig.config, rig.config.laser[laser]
        if self.spec.stripe_axis != "rows" or self.config.camera.wide:
            raise ValueError("Only lasers with upright stripes in pinhole cameras.")
        true = make_rig(self.config)
        self.sheet, self.place = true.sheets[laser], place @ true.scanner_from_camera
        camera = self.config.camera
        self.row_y = undistort(camera, np.full(len(rows), camera.width / 2), self.rows)[1]

    def solve(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Centres, points, surfaces and nearness to a corner [angles, rows]."""
        poses = [self.place @ self.rig.turned(float(phi)) for phi in angles]
        rotation, eye = np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses])
        shape, n = (len(angles), len(self.rows)), len(self.rows)
        rotation, eye = np.repeat(rotation, n, 0), np.repeat(eye, n, 0)
        v = np.tile(self.rows, len(angles))
        source = eye + np.einsum("nij,j->ni", rotation, self.sheet.origin)
        xy, wall = self._box(rotation, eye, v)
        normal, distance = self.room.box.normal[wall], self.room.box.distance[wall]
        surface = wall
        if self.room.facets is not None:
            xy, surface, normal, distance = self._first_facet(rotation, eye, v, xy)
        for _ in range(2 if self.room.rough_m else 1):
            rough = self._rough(rotation, eye, xy, surface)
            xy = self._polish(xy, v, self._seen(rotation, eye, normal, distance + rough))
        depth = self.spec.plane()[1] / self._slope(xy)
        point = eye + depth[:, None] * _turned(rotation, xy)
        u, _ = _distorted(self.config, xy)
        ok = (surface >= 0) & (depth > 0.3) & (u > 3) & (u < self.config.camera.width - 4) & np.isfinite(u)
        leg = np.einsum("nji,nj->ni", rotation, point - source)
        ok &= np.abs(self.sheet.angle(leg)) < np.deg2rad(self.spec.fan_deg / 2)
        facing = np.abs(np.einsum("ni,ni->n", normal, point - source)) / np.linalg.norm(point - source, axis=1)
        ok &= facing > 0.05
        if self.room.facets is not None:
            ok &= ~self.room.facets.blocked(source, point)
        corner = self.room.box.corner(point)
        return (
            np.where(ok, u, 0.0).reshape(shape),
            np.where(ok[:, None], point, 0.0).reshape(*shape, 3),
            np.where(ok, surface, -1).reshape(shape),
            np.where(ok, corner, 0.0).reshape(shape),
        )

    def _seen(self, rotation, eye, normal, distance) -> tuple[np.ndarray, np.ndarray]:
        """Planes in the camera's frame."""
        return np.einsum("nji,nj->ni", rotation, normal), distance - np.einsum("ni,ni->n", normal, eye)

    def _slope(self, xy: np.ndarray) -> np.ndarray:
        return self.sheet.slope_at(xy[:, 0], xy[:, 1])

    def _start(self, v: np.ndarray, plane: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """First (x, y) on a plane with the flat sheet, and the depth there; inf behind the camera."""
        (m, h), (n, d) = plane, self.spec.plane()
        y = np.interp(v, self.rows, self.row_y)
        below = d * m[:, 0] - h * n[0]
        x = -(d * (m[:, 1] * y + m[:, 2]) - h * (n[1] * y + n[2])) / np.where(np.abs(below) < 1e-12, 1e-12, below)
        slope = n[0] * x + n[1] * y + n[2]
        depth = np.where(slope * d > 0, d / np.where(slope == 0, 1.0, slope), np.inf)
        return np.stack([x, y], -1), depth

    def _box(self, rotation: np.ndarray, eye: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(x, y) where the sheet's line of each row leaves the box, and through which wall."""
        starts, depths, planes = [], [], []
        for normal, distance in zip(self.room.box.normal, self.room.box.distance, strict=True):
            plane = self._seen(rotation, eye, np.broadcast_to(normal, (len(v), 3)), np.full(len(v), distance))
            xy, depth = self._start(v, plane)
            starts, depths, planes = [*starts, xy], [*depths, depth], [*planes, plane]
        order, every = np.argsort(np.array(depths), axis=0), np.arange(len(v))
        found = []
        # The lens bends rows: near a corner the second wall may be the first.
        for wall in order[:2]:
            plane = tuple(np.stack(parts)[wall, every] for parts in zip(*planes, strict=True))
            xy = self._polish(np.stack(starts)[wall, every], v, plane)
            slope = self._slope(xy)
            depth = np.where(slope > 0, self.spec.plane()[1] / np.where(slope == 0, 1, slope), np.inf)
            found.append((xy, np.where(np.isfinite(depth), depth, np.inf), wall))
        (xy, near, wall), (other, far, second) = found
        swap = far < near
        return np.where(swap[:, None], other, xy), np.where(swap, second, wall)

    def _polish(self, xy: np.ndarray, v: np.ndarray, plane: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Newton for the row and for sheet and plane at one depth, with slopes by differences."""
        (m, h), d = plane, self.spec.plane()[1]

        def misses(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            at = np.stack([x, y], -1)
            return _distorted(self.config, at)[1] - v, d * (m[:, 0] * x + m[:, 1] * y + m[:, 2]) - h * self._slope(at)

        x, y, step = xy[:, 0].copy(), xy[:, 1].copy(), 1e-6
        with np.errstate(all="ignore"):
            for _ in range(4):
                row, cross = misses(x, y)
                (row_x, cross_x), (row_y, cross_y) = misses(x + step, y), misses(x, y + step)
                a, b, c, e = (
                    (p - q) / step for p, q in ((row_x, row), (row_y, row), (cross_x, cross), (cross_y, cross))
                )
                det = a * e - b * c
                # Beyond the image the lens may fold: such points are dropped later.
                x = np.clip(x - (e * row - b * cross) / det, -5, 5)
                y = np.clip(y - (a * cross - c * row) / det, -5, 5)
        return np.nan_to_num(np.stack([x, y], -1), nan=5.0)

    def _rough(self, rotation: np.ndarray, eye: np.ndarray, xy: np.ndarray, surface: np.ndarray) -> np.ndarray:
        if not self.room.rough_m:
            return np.zeros(len(xy))
        depth = self.spec.plane()[1] / self._slope(xy)
        return self.room.rough(eye + depth[:, None] * _turned(rotation, xy), surface)

    def _first_facet(
        self, rotation: np.ndarray, eye: np.ndarray, v: np.ndarray, exit_xy: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(x, y), surface and plane of the first facet that the sheet's line of each row runs into."""
        facets, d = self.room.facets, self.spec.plane()[1]
        assert facets is not None

        def farther(depth: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """How much farther the room is than the sheet at a depth of it, and which facet is seen."""
            xy = self._at_depth(depth, v[rows])
            far, facet = facets.cast(eye[rows], _turned(rotation[rows], xy))
            return far - depth, facet

        with np.errstate(all="ignore"):
            last = np.clip(np.nan_to_num(1.03 * d / self._slope(exit_xy), nan=12.0), 0.31, 12.0)
        left, right, todo = np.full(len(v), 0.3), last.copy(), np.arange(len(v))
        before = left.copy()
        # Equal steps in the inverse of depth are equal steps of the pixel.
        for share in np.linspace(0, 1, 40)[1:]:
            depth = 1 / ((1 - share) / 0.3 + share / last[todo])
            behind = farther(depth, todo)[0] < 0
            left[todo[behind]], right[todo[behind]] = before[todo][behind], depth[behind]
            before[todo] = depth
            todo = todo[~behind]
        every = np.arange(len(v))
        for _ in range(14):
            middle = (left + right) / 2
            front = farther(middle, every)[0] >= 0
            left, right = np.where(front, middle, left), np.where(front, right, middle)
        gap, facet = farther(right, every)
        # Where the depth jumps, the sheet runs on behind an edge: nothing is lit there.
        real = (np.abs(gap) < 2e-3 * right) & (facet < len(facets.surface) - 1)
        real[todo] = False
        facet = np.where(real, facet, len(facets.surface) - 1)
        return self._at_depth(right, v), facets.surface[facet], facets.normal[facet], facets.distance[facet]

    def _at_depth(self, depth: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(x, y) on the sheet at a depth, in a row."""
        (n, d), camera = self.spec.plane(), self.config.camera
        y = (v - camera.centre()[1]) / camera.fy
        x = (d / depth - n[1] * y - n[2]) / n[0]
        for _ in range(4):
            y = y - (_distorted(self.config, np.stack([x, y], -1))[1] - v) / camera.fy
            x = x - (self._slope(np.stack([x, y], -1)) - d / depth) / n[0]
        return np.stack([x, y], -1)


def _turned(rotation: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Rays (x, y, 1) in the room's frame."""
    return np.einsum("nij,nj->ni", rotation, np.column_stack([xy, np.ones(len(xy))]))


def _distorted(config: SimulationConfig, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return distort(config.camera, xy[:, 0], xy[:, 1])
