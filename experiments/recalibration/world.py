"""Exact stripes of sweeps through known rooms, and exact sightings of features: noise, roughness, faults, drifts.

Pixels come from the simulator's lens, sheet and table, and from the surfaces of a room in its own frame; nothing of
`geometry` is used.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d  # type: ignore[import-untyped]

from experiments.exact_rig import IdealRig
from jaxscan.recalibration import SweepStripes, Tracks
from jaxscan.simulation import Motion, RoomSpec, SimulationConfig, distort, make_rig, rodrigues, undistort
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.scene import Scene, build_scene, furnish
from jaxscan.simulation.scene.textures import Material


BOX = ("wall x0", "wall x1", "wall y0", "wall y1", "floor", "ceiling")
"""Surfaces 0 to 5."""
_WAVES = 48
_PLASTER = Material(((0.7, 0.7, 0.7),))


@dataclass(frozen=True)
class Box:
    """Six planes `normal . p = distance`; normals look into the room."""

    normal: np.ndarray
    distance: np.ndarray

    def corner(self, point: np.ndarray, metres: float = 0.15) -> np.ndarray:
        """Nearness of points [n, 3] to a second wall: 1 in the corner; its sign says on which of both they are."""
        gap = np.abs(point @ self.normal.T - self.distance)
        order = np.argsort(gap, axis=1)
        second = np.take_along_axis(gap, order[:, 1:2], 1)[:, 0]
        return np.where(order[:, 0] < order[:, 1], 1.0, -1.0) * np.exp(-second / metres)


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles; the last entry of each array is for rays that hit nothing."""

    scene: Scene
    normal: np.ndarray
    distance: np.ndarray
    surface: np.ndarray

    def cast(self, eye: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest hits of rays [n, 3]: lengths of the ray, and facets."""
        return self.scene.cast(eye, ray)

    def blocked(self, source: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Whether something stands between sources and points, each [n, 3]."""
        far, _ = self.scene.cast(source, point - source)
        return far < 1 - 2e-3


@dataclass(frozen=True)
class RoomSurfaces:
    """All that a stripe can lie on."""

    box: Box
    facets: Facets | None
    """None: the empty box."""
    rough_m: float
    rough_length_m: float

    def rough(self, point: np.ndarray, surface: np.ndarray) -> np.ndarray:
        """Height of the surface over its plane at points [n, 3]: a sum of waves, so that no grid shows [m]."""
        height = np.zeros(len(point))
        for number in np.unique(surface[surface >= 0]):
            mine = surface == number
            random = np.random.default_rng([int(number), 86])
            wave = random.standard_normal((3, _WAVES)) / self.rough_length_m
            phase = random.uniform(0, 2 * np.pi, _WAVES)
            height[mine] = np.cos(point[mine] @ wave + phase).sum(1) * np.sqrt(2 / _WAVES)
        return self.rough_m * height


def box_of(room: RoomSpec) -> Box:
    """The walls, floor and ceiling of a room."""
    normal, distance = np.zeros((6, 3)), np.zeros(6)
    for axis, size in enumerate(room.size_m):
        normal[2 * axis, axis], normal[2 * axis + 1, axis] = 1.0, -1.0
        distance[2 * axis + 1] = -size
    return Box(normal, distance)


@lru_cache(maxsize=4)
def facets_of(room: RoomSpec, extras: Callable[[Mesh], None] | None) -> Facets:
    """The facets of a furnished room; the last few are kept."""
    mesh = furnish(room)
    if extras is not None:
        extras(mesh)
    corners = np.concatenate(mesh.triangles)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance = np.einsum("ij,ij->i", normal, corners[:, 0])
    surface = len(BOX) + np.repeat(np.arange(len(mesh.triangles)), [len(part) for part in mesh.triangles])
    for number, (own, at) in enumerate(zip(*vars(box_of(room)).values(), strict=True)):
        sense = normal @ own
        surface[(np.abs(sense) > 1 - 1e-9) & (np.abs(distance * sense - at) < 1e-9)] = number
    mirror = np.array([part.material.mirror > 0 for part in mesh.surfaces])
    surface[np.repeat(mirror, [len(part) for part in mesh.triangles])] = -1
    scene = build_scene(mesh, np.array(room.size_m) / 2, 1.0, shadows=False)
    last = np.array([[0.0, 0.0, 1.0]])
    return Facets(scene, np.concatenate([normal, last]), np.append(distance, 0.0), np.append(surface, -1))


def stepped(room: RoomSpec, depth_m: float) -> Callable[[Mesh], None]:
    """Half of the wall x0 stands out by a step: two planes that a coarse tolerance takes for one."""
    _, y, z = room.size_m

    def add(mesh: Mesh) -> None:
        mesh.box((depth_m / 2, 0.75 * y, 0), (depth_m, 0.5 * y, z), _PLASTER)

    return add


def curved(room: RoomSpec, sagitta_m: float) -> Callable[[Mesh], None]:
    """The wall y1 bulges into the room as a part of a cylinder, in facets of a two hundredth of its length."""
    x, y, z = room.size_m

    def add(mesh: Mesh) -> None:
        along = np.linspace(0, x, 201)
        out = y - 1e-4 - sagitta_m * (1 - (2 * along / x - 1) ** 2)
        for a, b, low, high in zip(along[:-1], along[1:], out[:-1], out[1:], strict=True):
            mesh.quad(np.array([a, low, 0]), np.array([b - a, high - low, 0]), np.array([0, 0, z]), _PLASTER)

    return add


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
        u, _ = _distorted_rays(self.config, xy)
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
            return _distorted_rays(self.config, at)[1] - v, d * (m[:, 0] * x + m[:, 1] * y + m[:, 2]) - h * self._slope(
                at
            )

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
            y = y - (_distorted_rays(self.config, np.stack([x, y], -1))[1] - v) / camera.fy
            x = x - (self._slope(np.stack([x, y], -1)) - d / depth) / n[0]
        return np.stack([x, y], -1)


def _turned(rotation: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Rays (x, y, 1) in the room's frame."""
    return np.einsum("nij,nj->ni", rotation, np.column_stack([xy, np.ones(len(xy))]))


def _distorted_rays(config: SimulationConfig, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return distort(config.camera, xy[:, 0], xy[:, 1])


@dataclass(frozen=True)
class Noise:
    """Errors of stripe centres."""

    px: float = 0.1
    """Standard deviation of a centre [px], and the stated one."""
    shared_lines: int = 7
    """Lines over which smoothing has averaged the noise of rows."""
    neighbours: float = 0.0
    """Correlation between neighbouring profiles; nobody states it [1]."""
    pull_px: float = 0.0
    """Shift in a corner of the room, as light that comes back from the other wall has it [px]."""
    pull_m: float = 0.15
    """Distance from the corner at which it has fallen to 1 / e [m]."""
    stray: float = 0.0
    """Share of centres that are anywhere within 20 px [1]."""


UNKIND = Noise(px=0.08, shared_lines=9, neighbours=0.2, pull_px=0.05, pull_m=0.08, stray=1e-3)
"""Somewhat worse than stripes that were extracted from rendered sweeps of `configs/unkind.toml`: errors of 0.06 to
0.09 px as stated, shared by 9 lines, correlated by 0.04 at most between profiles, pulled by 0.03 px within 6 cm of a
corner, and 0.1 % of strays."""


@dataclass(frozen=True)
class Sweeping:
    """How a sweep is taken."""

    steps: int = 360
    turn_deg: float = 360.0
    """Turn by the journal; beyond 360 it overlaps."""
    line_stride: int = 1
    """Only every n-th image row has a centre."""
    furniture: bool | None = None
    """None: as the configuration has it."""
    extras: Callable[[Mesh], None] | None = None
    """Adds surfaces to the room: see `stepped` and `curved`."""
    rough_m: float = 0.0
    """Roughness of all surfaces, a standard deviation [m]."""
    rough_length_m: float = 0.05
    """Distance at which its correlation has fallen to 0.6 [m]."""
    lost: tuple[int, float] | None = None
    """Record from which on the table stands elsewhere, and by how much [deg]."""
    wander_deg: float = 0.0
    """Standard deviation of independent errors of the steps [deg]."""
    station: int = 0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Angles by which the rig leans about its own x and y."""
    noise: Noise = Noise()


class TrueSweep(NamedTuple):
    """The truth of a sweep."""

    surface: np.ndarray
    """Surface of each centre [profiles, lines]: -1 none; 0 ... 5 walls x0, x1, y0, y1, floor, ceiling; more: others."""
    point: np.ndarray
    """Room coordinates [profiles, lines, 3]; m."""
    centre: np.ndarray
    """Without noise [px]."""
    angle: np.ndarray
    """Where the table truly stood [records]; rad, before its own errors of gain and harmonics."""


def sweep_of(config: SimulationConfig, seed: int, how: Sweeping = Sweeping()) -> SweepStripes:
    """Stripes of a sweep of the configuration's room; `seed` draws noise and roughness."""
    return true_sweep(config, seed, how)[0]


def true_sweep(config: SimulationConfig, seed: int, how: Sweeping = Sweeping()) -> tuple[SweepStripes, TrueSweep]:
    """As `sweep_of`, with the truth."""
    journal = np.deg2rad(how.turn_deg) * np.arange(how.steps) / how.steps
    random = np.random.default_rng([seed, 83])
    angle = journal + np.deg2rad(how.wander_deg) * random.standard_normal(how.steps)
    if how.lost is not None:
        angle[how.lost[0] :] += np.deg2rad(how.lost[1])
    room = _room(config, how)
    height, lasers = config.camera.height, len(config.laser)
    shape = (how.steps * lasers, height)
    truth = TrueSweep(np.full(shape, -1), np.zeros((*shape, 3)), np.zeros(shape), angle)
    near_corner = np.zeros(shape)
    rig, place = IdealRig(config), room_from_rig(config, how.tilt_deg)
    # So many profiles at once that arrays stay in the cache of the processor.
    block = max(1, 200_000 * how.line_stride // height)
    for laser in range(lasers):
        for first in range(0, how.steps, block):
            part = np.arange(first, min(first + block, how.steps))
            found = Crossings(rig, room, place, laser, np.arange(0, height, how.line_stride)).solve(angle[part])
            at = np.ix_(part * lasers + laser, np.arange(0, height, how.line_stride))
            truth.centre[at], truth.point[at], truth.surface[at], near_corner[at] = found
    valid = truth.surface >= 0
    noise = how.noise
    error = noise.px * _noise(shape, noise, random) + noise.pull_px * near_corner
    stray = random.random(shape) < noise.stray
    error[stray] += random.uniform(-20, 20, int(stray.sum()))
    stripes = SweepStripes(
        name=f"simulated {seed}",
        centre=np.where(valid, truth.centre + error, 0.0),
        sigma=np.full(shape, noise.px),
        shared_lines=np.full(shape, float(noise.shared_lines)),
        valid=valid,
        record=np.repeat(np.arange(how.steps), lasers),
        laser=np.tile(np.arange(lasers), how.steps),
        angle=journal,
        stripe_axis=config.laser[0].stripe_axis,
        station=how.station,
    )
    return stripes, truth


def moved(config: SimulationConfig, rig_m: tuple[float, float, float], yaw_deg: float) -> SimulationConfig:
    """The same rig at another place in its room."""
    assert config.room is not None
    room = config.room.model_copy(update={"rig_m": rig_m, "yaw_deg": yaw_deg})
    return config.model_copy(update={"room": room})


def turn_laser(config: SimulationConfig, degrees: float, seed: int) -> SimulationConfig:
    """The first sheet turned about its laser by an angle, in a random direction."""
    random = np.random.default_rng([seed, 84])
    laser = config.laser[0]
    normal, _ = laser.plane()
    origin = make_rig(config).sheets[0].origin
    way = random.standard_normal(3)
    way -= (way @ normal) * normal
    turned = rodrigues(way / np.linalg.norm(way), np.deg2rad(degrees)) @ normal
    update = {"a": None, "b": None, "c_mm": None, "baseline_m": None, "crossing_m": None}
    update |= {"normal": tuple(turned), "distance_m": float(turned @ origin), "origin_m": tuple(origin)}
    return config.model_copy(update={"laser": (laser.model_copy(update=update), *config.laser[1:])})


def shift_axis(config: SimulationConfig, metres: float, seed: int) -> SimulationConfig:
    """The axis shifted across itself, in a random direction; the rig keeps its place in the room."""
    random = np.random.default_rng([seed, 85])
    rig = make_rig(config)
    way = random.standard_normal(3)
    way -= (way @ rig.direction) * rig.direction
    point = rig.point + metres * way / np.linalg.norm(way)
    update = {"tr": None, "direction": tuple(rig.direction), "point_m": tuple(point)}
    return config.model_copy(update={"turntable": config.turntable.model_copy(update=update)})


def _room(config: SimulationConfig, how: Sweeping) -> RoomSurfaces:
    assert config.room is not None
    furniture = config.room.furniture if how.furniture is None else how.furniture
    spec = config.room.model_copy(update={"furniture": furniture})
    simple = not furniture and how.extras is None and spec.mirror is None
    facets = None if simple else facets_of(spec, how.extras)
    return RoomSurfaces(box_of(spec), facets, how.rough_m, how.rough_length_m)


def _noise(shape: tuple[int, int], noise: Noise, random: np.random.Generator) -> np.ndarray:
    """Unit variance, correlated along lines as a mean over rows is, and from profile to profile."""
    field = random.standard_normal(shape, np.float32).astype(np.float64)
    if noise.shared_lines > 1:
        field = uniform_filter1d(field, noise.shared_lines, axis=1, mode="wrap") * np.sqrt(noise.shared_lines)
    rho = noise.neighbours
    for profile in range(1, len(field)) if rho else ():
        field[profile] = rho * field[profile - 1] + np.sqrt(1 - rho * rho) * field[profile]
    return field


FEATURES, KEY_IMAGES, NOISE_PX, START_M = 150, 90, 0.15, 0.02
"""Features, images in which they are looked for, noise of a sighting, and error of first values."""
_MARGIN_PX = 12.0
_FEWEST = 3


def features_of(config: SimulationConfig, truth: TrueSweep, seed: int) -> Tracks:
    """Features on walls, floor and ceiling, where they are seen in key images of a sweep."""
    random, rig = np.random.default_rng([seed, 89]), IdealRig(config)
    walls = np.flatnonzero((truth.surface.ravel() >= 0) & (truth.surface.ravel() < 6))
    point = truth.point.reshape(-1, 3)[random.choice(walls, FEATURES, replace=False)]
    records = np.unique(np.linspace(0, len(truth.angle), KEY_IMAGES, endpoint=False).astype(int))
    place, frame = room_from_rig(config), make_rig(config).scanner_from_camera
    seen = []
    for record in records:
        back = (place @ frame @ rig.turned(float(truth.angle[record]))).inverse().apply(point)
        ahead = (back[:, 2] > 0.3) & (np.hypot(back[:, 0], back[:, 1]) < back[:, 2])
        q = rig.project(np.where(ahead[:, None], back, [0.0, 0.0, 1.0]))
        track = np.flatnonzero(ahead & rig.inside(q, _MARGIN_PX))
        seen.append(np.column_stack([q[track], np.full(len(track), record), track]))
    found = np.concatenate(seen)
    often = np.bincount(found[:, 3].astype(int), minlength=FEATURES) >= _FEWEST
    found = found[often[found[:, 3].astype(int)]]
    kept, track = np.unique(found[:, 3].astype(int), return_inverse=True)
    start = place.inverse().apply(point[kept])
    return Tracks(
        q=found[:, :2] + NOISE_PX * random.standard_normal((len(found), 2)),
        sigma=np.full(len(found), NOISE_PX),
        sweep=np.zeros(len(found), int),
        record=found[:, 2].astype(int),
        track=track,
        point=start + START_M * random.standard_normal(start.shape),
    )
