"""Mitsuba 3 as the eye and the light of a room: rays, the lamps' light, the laser's, and the true stripes.

The lamps' light does not depend on where the camera stands: it is traced once per room, on a grid on every surface
(Mitsuba's path tracer, next event estimation, five bounces), and looked up in every frame. Of the laser's light, that
which comes back from other surfaces is traced from the sheet: paths of up to three bounces, joined to the camera's
points by shadow rays (bidirectional path tracing with the light's paths shared by all pixels)."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d  # type: ignore[import-untyped]

from experiments.unkind.scene import FINE, Patch, Rig, Room, Round, look, to_pixels
from experiments.unkind.truth import TrueStripes, empty, with_parts


LIBRARIES = [Path(f"/usr/lib/x86_64-linux-gnu/libLLVM-{n}.so") for n in (19, 20, 18, 17, 16)]
VARIANT = "llvm_ad_rgb"
TEXEL_M = 0.08
PATHS = 512
LEAST_R2 = 0.12**2
"""Squared distance below which light from other surfaces grows no more [m^2]: the grid of pixels could not show it."""


def load() -> Any:
    """Mitsuba with the variant that runs on all cores; LLVM 15 crashes in it."""
    found = next((path for path in LIBRARIES if path.exists()), None)
    if found is not None:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(found))
    import mitsuba as mi

    mi.set_variant(VARIANT)
    return mi


class Hits(NamedTuple):
    """First surfaces on n rays; room frame."""

    far: np.ndarray
    """Distance along the ray, inf without a hit [n]."""
    p: np.ndarray
    normal: np.ndarray
    uv: np.ndarray
    shape: np.ndarray
    """Number of the surface [n], -1 without a hit."""
    albedo: np.ndarray


class Light(NamedTuple):
    """Points that send light on: [n, 3], [n, 3], and their flux [n]."""

    p: np.ndarray
    normal: np.ndarray
    flux: np.ndarray


class Tracer:
    """A room, perhaps with a board in it that can be moved."""

    def __init__(self, room: Room, seed: int, board: Patch | None = None) -> None:
        """Build Mitsuba's scene."""
        self.mi, self.room, self.seed = load(), room, seed
        scene: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 6, "hide_emitters": True}}
        self.patches = [*room.patches, *([board] if board is not None else [])]
        for k, patch in enumerate(self.patches):
            scene[f"patch{k:03d}"] = self._patch(patch)
        for k, one in enumerate(room.rounds):
            scene[f"round{k:03d}"] = self._round(one)
        for k, (centre, half) in enumerate(room.lamps):
            scene[f"zlamp{k}"] = self._lamp(centre, half)
        self.scene = self.mi.load_dict(scene)
        self.surfaces: list[Patch | Round] = [*self.patches, *room.rounds]
        names = {f"patch{k:03d}": k for k in range(len(self.patches))}
        names |= {f"round{k:03d}": len(self.patches) + k for k in range(len(room.rounds))}
        self.board = len(self.patches) - 1 if board is not None else -1
        self.number = np.full(4096, -1)
        for shape in self.scene.shapes():
            self.number[self._id(self.mi.ShapePtr(shape))] = names.get(shape.id(), -1)
        self.maps: list[np.ndarray] = []

    def _id(self, pointer: Any) -> np.ndarray:
        import drjit as dr

        return np.array(dr.reinterpret_array(self.mi.UInt32, pointer)).astype(int)

    def _patch(self, patch: Patch) -> dict[str, Any]:
        bitmap = self.mi.Bitmap(np.ascontiguousarray(patch.paint[..., None], np.float32))
        paint = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}
        return {
            "type": "rectangle",
            "to_world": self.mi.ScalarTransform4f(placed(patch)),
            "bsdf": {"type": "diffuse", "reflectance": paint},
        }

    def _round(self, one: Round) -> dict[str, Any]:
        grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(one.reflectance)] * 3}}
        if one.kind == "sphere":
            return {"type": "sphere", "center": one.centre.tolist(), "radius": float(one.radius), "bsdf": grey}
        top = one.centre + np.array([0.0, 0.0, one.height])
        ends = {"p0": one.centre.tolist(), "p1": top.tolist()}
        return {"type": "cylinder", **ends, "radius": float(one.radius), "bsdf": grey}

    def _lamp(self, centre: np.ndarray, half: float) -> dict[str, Any]:
        down = np.diag([half, -half, -1.0, 1.0])
        down[:3, 3] = centre
        glow = {"type": "area", "radiance": {"type": "rgb", "value": [10.0] * 3}}
        return {"type": "rectangle", "to_world": self.mi.ScalarTransform4f(down), "emitter": glow}

    def move_board(self, board: Patch) -> None:
        """Put the board elsewhere; its paint stays."""
        params = self.mi.traverse(self.scene)
        params[f"patch{self.board:03d}.to_world"] = self.mi.Transform4f(placed(board))
        params.update()
        self.patches[self.board] = self.surfaces[self.board] = board

    def _rays(self, origin: np.ndarray, way: np.ndarray) -> Any:
        far = np.broadcast_to(np.asarray(origin, np.float32), way.shape)
        columns = (np.ascontiguousarray(part.T, np.float32) for part in (far, way))
        return self.mi.Ray3f(*(kind(c) for kind, c in zip((self.mi.Point3f, self.mi.Vector3f), columns, strict=True)))

    def cast(self, origin: np.ndarray, way: np.ndarray) -> Hits:
        """First surfaces on rays from [3] or [n, 3] along [n, 3]."""
        import drjit as dr

        # Mitsuba ends the process where there is no ray.
        if not len(way):
            three = np.zeros((0, 3))
            return Hits(np.zeros(0), three, three, np.zeros((0, 2)), np.zeros(0, int), np.zeros(0))
        at = self.scene.ray_intersect(self._rays(origin, way))
        albedo = at.bsdf().eval_diffuse_reflectance(at).x
        shape = dr.reinterpret_array(self.mi.UInt32, at.shape)
        dr.eval(at.t, at.p, at.n, at.uv, albedo, shape)
        number = np.where(np.isfinite(np.array(at.t)), self.number[np.array(shape).astype(int)], -1)
        return Hits(np.array(at.t), np.array(at.p).T, np.array(at.n).T, np.array(at.uv).T, number, np.array(albedo))

    def sees(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether nothing stands between points a [3] or [n, 3] and b [n, 3], bool [n]."""
        way = (b - a).astype(np.float32)
        if not len(way):
            return np.zeros(0, bool)
        ray = self._rays(a, way)
        ray.maxt = self.mi.Float(np.float32(1 - 2e-3))
        return ~np.array(self.scene.ray_test(ray))

    def lamp_light(self, p: np.ndarray, normal: np.ndarray, paths: int = PATHS) -> np.ndarray:
        """Irradiance of surfaces at points [n, 3] by path tracing, float [n]."""
        import drjit as dr

        mi = self.mi
        total, done = np.zeros(len(p)), 0
        each = max(1, min(paths, 1_500_000 // len(p)))
        while done < paths:
            start = np.repeat(p + 2e-3 * normal, each, 0)
            ray = self._rays(start, np.repeat(-normal, each, 0))
            at = self.scene.ray_intersect(ray)
            albedo = at.bsdf().eval_diffuse_reflectance(at).x
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(self.seed * 1000 + done, len(start))
            light, _, _ = self.scene.integrator().sample(self.scene, sampler, mi.RayDifferential3f(ray))
            value = np.pi * light.x / dr.maximum(albedo, 1e-3)
            total += np.array(value).reshape(-1, each).sum(1)
            done += each
        return total / done

    def bake(self) -> None:
        """Trace the lamps' light on a grid on every surface but the board."""
        places = []
        for k, surface in enumerate(self.surfaces):
            places.append((np.zeros((0, 3)), np.zeros((0, 3)), (0, 0)) if k == self.board else texels(surface))
        light = self.lamp_light(np.concatenate([one[0] for one in places]), np.concatenate([one[1] for one in places]))
        ends = np.cumsum([len(one[0]) for one in places])[:-1]
        self.maps = [part.reshape(one[2]) for part, one in zip(np.split(light, ends), places, strict=True)]

    def painted(self, origin: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The surfaces that rays meet, as of `cast`: number, albedo and uv alone."""
        import drjit as dr

        at = self.scene.ray_intersect(self._rays(origin, way))
        albedo, shape = at.bsdf().eval_diffuse_reflectance(at).x, dr.reinterpret_array(self.mi.UInt32, at.shape)
        dr.eval(at.uv, albedo, shape)
        # Number 0 of the registry is no shape.
        return self.number[np.array(shape)], np.array(albedo), np.array(at.uv).T

    def ambient(self, shape: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Irradiance by the lamps at places on surfaces [n], from the grids; on the board 0."""
        out = np.zeros(len(shape), np.float32)
        for number in np.unique(shape):
            if number >= 0 and number != self.board:
                chosen = np.flatnonzero(shape == number)
                out[chosen] = bilinear(self.maps[number], uv[chosen])
        return out

    def bounced(self, first: Light, rng: np.random.Generator) -> Light:
        """The light's points on its first surfaces, and those of two further bounces, two ways from each point."""
        found, now = [first], first
        for ways in (2, 1):
            way = cosine_ways(np.repeat(now.normal, ways, 0), rng)
            start = np.repeat(now.p + 1e-3 * now.normal, ways, 0)
            hits = self.cast(start, way)
            flux = np.repeat(now.flux, ways) / ways * hits.albedo
            ok = hits.shape >= 0
            now = Light(hits.p[ok], hits.normal[ok], flux[ok])
            found.append(now)
        return Light(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def gather(self, light: Light, p: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Irradiance at points [n, 3] from points that send light on, float [n]."""
        out = np.zeros(len(p))
        p, normal = p.astype(np.float32), normal.astype(np.float32)
        light = Light(*(part.astype(np.float32) for part in light))
        for part in np.array_split(np.arange(len(p)), max(1, len(p) * len(light.p) // 500_000)):
            cross = p[part] @ light.p.T
            r2 = np.maximum((p[part] ** 2).sum(1)[:, None] + (light.p**2).sum(1) - 2 * cross, np.float32(1e-6))
            there = p[part] @ light.normal.T - (light.p * light.normal).sum(1)
            here = normal[part] @ light.p.T - (p[part] * normal[part]).sum(1)[:, None]
            share = np.maximum(there, 0) * np.maximum(here, 0) / (np.pi * r2 * np.maximum(r2, LEAST_R2)) * light.flux
            i, j = np.nonzero(share > 0)
            free = self.sees(p[part][i] + 1e-3 * normal[part][i], light.p[j] + 1e-3 * light.normal[j])
            out[part] = np.bincount(i, share[i, j] * free, len(part))
        return out


def placed(patch: Patch) -> np.ndarray:
    """Motion and stretch [4, 4] of Mitsuba's rectangle, whose corners are at -1 and 1."""
    motion = np.eye(4)
    motion[:3, 0], motion[:3, 1], motion[:3, 2] = patch.along / 2, patch.up / 2, patch.normal()
    motion[:3, 3] = patch.origin + (patch.along + patch.up) / 2
    return motion


def texels(surface: Patch | Round) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Points and normals [n, 3] of the grid of a surface, and its shape (v, u)."""
    if isinstance(surface, Patch):
        lengths = [np.linalg.norm(edge) for edge in (surface.along, surface.up)]
        columns, rows = (int(np.clip(np.ceil(length / TEXEL_M), 3, 60)) for length in lengths)
        v, u = (part.ravel()[:, None] for part in np.mgrid[0.5:rows, 0.5:columns])
        p = surface.origin + u / columns * surface.along + v / rows * surface.up
        return p, np.broadcast_to(surface.normal(), p.shape), (rows, columns)
    rows, columns = 16, 24
    v, u = (part.ravel() for part in np.mgrid[0.5:rows, 0.5:columns])
    angle = 2 * np.pi * u / columns
    if surface.kind == "sphere":
        pole = np.pi * v / rows
        normal = np.stack([np.cos(angle) * np.sin(pole), np.sin(angle) * np.sin(pole), np.cos(pole)], -1)
        return surface.centre + surface.radius * normal, normal, (rows, columns)
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    height = np.zeros_like(normal)
    height[:, 2] = surface.height * v / rows
    return surface.centre + surface.radius * normal + height, normal, (rows, columns)


def bilinear(grid: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Values of a grid over the unit square at uv [n, 2], held at its border."""
    rows, columns = grid.shape
    grid = grid.astype(np.float32)
    x, y = np.clip(uv[:, 0] * columns - 0.5, 0, columns - 1), np.clip(uv[:, 1] * rows - 0.5, 0, rows - 1)
    c, r = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
    f, g = x - c, y - r
    upper = (1 - f) * grid[r, c] + f * grid[r, c + 1]
    return (1 - g) * upper + g * ((1 - f) * grid[r + 1, c] + f * grid[r + 1, c + 1])


def cosine_ways(normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Directions [n, 3] about normals with the density of the cosine."""
    way = rng.standard_normal(normal.shape)
    way = normal + way / np.linalg.norm(way, axis=1, keepdims=True)
    return way / np.linalg.norm(way, axis=1, keepdims=True)


WAIST_M, SPREAD_RAD = 0.0008, 0.0021
"""Standard deviation of the sheet at its source, and its growth: 0.9 px wide at every distance."""
APERTURE_M = 0.0015
SIDE = 2 * FINE
"""Rays per pixel along u; `FINE` along v, each row of them shifted by a part of a sample."""
MARGIN = 8
"""Columns beside the stripe to which the lens may spread its light."""
CROSSINGS = 3
"""Crossings of sheet and surfaces that are kept of a row, the brightest first."""


class Shot(NamedTuple):
    """The rig at one angle of the table in its room."""

    rig: Rig
    tracer: Tracer
    pose: np.ndarray
    """T_room_cam [4, 4]."""

    def turned(self, way: np.ndarray) -> np.ndarray:
        """Directions of the camera's frame in that of the room."""
        return way @ self.pose[:3, :3].T.astype(way.dtype)

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Unit directions [n, 3] of pixels, room frame."""
        way = look(self.rig.lens, u, v) @ self.pose[:3, :3].T
        return way / np.linalg.norm(way, axis=-1, keepdims=True)

    def cast(self, u: np.ndarray, v: np.ndarray) -> Hits:
        """First surfaces that pixels see."""
        return self.tracer.cast(self.pose[:3, 3], self.rays(u, v))

    def local(self, p: np.ndarray) -> np.ndarray:
        """Points in the camera's frame."""
        return (p - self.pose[:3, 3]) @ self.pose[:3, :3]

    def beside(self, p: np.ndarray) -> np.ndarray:
        """Signed distance of points of the room from the middle of the sheet [m]."""
        return self.local(p) @ self.rig.normal - self.rig.distance


def fan(rig: Rig, local: np.ndarray) -> np.ndarray:
    """Uneven power of the fan in the direction of points in the camera's frame, 0.5 to 1.3."""
    way = local - rig.source
    angle = np.arctan2(way[:, 1], way[:, 2])
    return 0.9 + 0.3 * np.sin(5.3 * angle + 0.7) + 0.1 * np.sin(17.0 * angle)


def thickness(away: np.ndarray) -> np.ndarray:
    """Standard deviation of the sheet [m] at distances from its source."""
    return np.hypot(WAIST_M, SPREAD_RAD * away)


def lit(shot: Shot, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
    """Direct irradiance [n] (power of the fan per radian is 1), and the visible part of the laser [n]."""
    local = shot.local(hits.p)
    way = shot.rig.source - local
    away = np.linalg.norm(way, axis=1)
    facing = (way / away[:, None] @ shot.pose[:3, :3].T * hits.normal).sum(1)
    width = thickness(away)
    seen = np.zeros(len(local))
    near = (hits.shape >= 0) & (facing > 0)
    upright = np.array([0.0, 1.0, 0.0])
    for step in (-1.0, 0.0, 1.0):
        source = shot.rig.source + step * APERTURE_M * np.cross(shot.rig.normal, upright)
        source = shot.pose[:3, :3] @ source + shot.pose[:3, 3]
        seen[near] += shot.tracer.sees(source, hits.p[near] + 1e-3 * hits.normal[near]) / 3
    profile = np.exp(-0.5 * (shot.beside(hits.p) / width) ** 2) / (np.sqrt(2 * np.pi) * width)
    return fan(shot.rig, local) / away * profile * np.maximum(facing, 0) * seen, seen


class Direct(NamedTuple):
    """Direct light of the laser on the sensor, before the lens."""

    fine: np.ndarray
    """Albedo times irradiance, float32 [FINE rows, FINE part of the columns]."""
    columns: slice
    """Which columns of pixels `fine` holds."""
    shadow: np.ndarray
    """Visible part of the laser on every pixel; 1 beyond the band [rows, columns]."""


def direct(shot: Shot, middle: Hits) -> Direct:
    """The direct light; `middle` has the surfaces that the pixels' middles see."""
    rows, columns = shot.rig.height, shot.rig.width
    shadow = np.ones((rows, columns))
    v, u = np.nonzero(band(shot, middle))
    if not len(u):
        return Direct(np.zeros((FINE * rows, FINE), np.float32), slice(0, 1), shadow)
    first, last = max(int(u.min()) - MARGIN, 0), min(int(u.max()) + MARGIN + 1, columns)
    fine = np.zeros((FINE * rows, FINE * (last - first)), np.float32)
    along = (np.arange(FINE) + 0.5) / FINE - 0.5
    across = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    # Each of the rows of rays is shifted, so that an upright edge of ink falls between them.
    shifted = across[None, :] + (np.arange(FINE)[:, None] - (FINE - 1) / 2) / (FINE * SIDE)
    at_u = (u[:, None, None] + shifted).ravel()
    at_v = np.broadcast_to(v[:, None, None] + along[:, None], (len(v), FINE, SIDE)).ravel()
    hits = shot.cast(at_u, at_v)
    light, seen = lit(shot, hits)
    glow = (light * hits.albedo).reshape(len(u), FINE, FINE, 2).mean(3)
    target = np.arange(FINE)
    fine[(FINE * v)[:, None, None] + target[:, None], (FINE * (u - first))[:, None, None] + target[None, :]] = glow
    shadow[v, u] = seen.reshape(len(u), -1).min(1)
    return Direct(fine, slice(first, last), shadow)


def band(shot: Shot, middle: Hits) -> np.ndarray:
    """Pixels near the stripe, bool [rows, columns]."""
    rows, columns = shot.rig.height, shot.rig.width
    beside = np.where(middle.shape >= 0, shot.beside(middle.p), np.inf).reshape(rows, columns)
    reach = 4.5 * thickness(np.linalg.norm(shot.local(middle.p) - shot.rig.source, axis=1)).reshape(rows, columns)
    near = np.abs(beside) < reach
    jump = (beside[:, :-1] < 0) != (beside[:, 1:] < 0)
    near[:, :-1] |= jump
    near[:, 1:] |= jump
    grown = near.copy()
    for shift in range(1, 3):
        grown[:, shift:] |= near[:, :-shift]
        grown[:, :-shift] |= near[:, shift:]
    grown[1:] |= grown[:-1].copy()
    grown[:-1] |= grown[1:].copy()
    return grown


def light_points(shot: Shot, rng: np.random.Generator, count: int = 80) -> Light:
    """Where the sheet falls, with the flux that is sent on: equal steps of the fan's angle, jittered."""
    rig = shot.rig
    # Downwards in the sheet is y without its part along the normal; forwards is across.
    down = np.array([0.0, 1.0, 0.0]) - rig.normal * rig.normal[1]
    down /= np.linalg.norm(down)
    ahead = np.cross(down, rig.normal)
    ahead *= np.sign(ahead[2])
    half = np.radians(50.0)
    angle = (np.arange(count) + rng.random(count)) / count * 2 * half - half
    way = np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * down
    turn = shot.pose[:3, :3]
    hits = shot.tracer.cast(turn @ rig.source + shot.pose[:3, 3], way @ turn.T)
    ok = hits.shape >= 0
    power = fan(rig, shot.local(hits.p)) * 2 * half / count
    return Light(hits.p[ok], hits.normal[ok], (power * hits.albedo)[ok])


class Crossings(NamedTuple):
    """Where the middle of the sheet meets surfaces, in any order [n]."""

    u: np.ndarray
    row: np.ndarray
    p: np.ndarray
    normal: np.ndarray
    shape: np.ndarray


def crossings(shot: Shot, middle: Hits) -> Crossings:
    """The true centres: along the middle of every row, a quarter of a pixel between rays, then linearly."""
    v, u = np.nonzero(band(shot, middle))
    at_u = (u[:, None] + (np.arange(4) / 4 - 0.375)).ravel()
    at_v = np.repeat(v, 4)
    hits = shot.cast(at_u, at_v.astype(float))
    side = np.where(hits.shape >= 0, shot.beside(hits.p), np.nan)
    pair = (np.diff(at_v) == 0) & (np.abs(np.diff(at_u) - 0.25) < 1e-6)
    change = (side[:-1] < 0) != (side[1:] < 0)
    far = np.linalg.norm(np.diff(hits.p, axis=0), axis=1)
    first = np.flatnonzero(pair & change & np.isfinite(side[:-1]) & np.isfinite(side[1:]) & (far < 0.015))
    # A jump of depth is no crossing: there the sheet meets nothing.
    share = side[first] / (side[first] - side[first + 1])
    centre = at_u[first] + 0.25 * share
    again = shot.cast(centre, at_v[first].astype(float))
    real = np.abs(shot.beside(again.p)) < 1e-4
    return Crossings(centre[real], at_v[first][real], again.p[real], again.normal[real], again.shape[real])


CONTRAST_PX = 4.0
BESIDE_PX, ALONG_ROWS = 4, 2
"""Reach within which an edge counts."""
OFF_PLANE = 0.004
"""Distance from the tangent plane that counts as an edge, as a part of the distance from the camera."""


def stripes(shot: Shot, middle: Hits, laser: Direct, ambient: np.ndarray) -> TrueStripes:
    """The true stripes [rows, crossings] of one record.

    Args:
        laser: The laser's direct light behind the lens [DN].
        ambient: The room's light on every pixel [DN].
    """
    rows, columns = shot.rig.height, shot.rig.width
    found = crossings(shot, middle)
    peak, width = _profile(laser.fine, found.u - laser.columns.start, found.row)
    beside = ambient[found.row, np.clip(np.rint(found.u).astype(int), 0, columns - 1)]
    edge = _edges(shot, middle, laser.shadow, found)
    on_board = found.shape == shot.tracer.board if shot.tracer.board >= 0 else np.zeros(len(found.u), bool)
    contrast = np.full(len(found.u), np.nan)
    contrast[on_board] = print_contrast(shot, found.u[on_board], found.row[on_board])
    out = TrueStripes(*(grid[0] for grid in empty(1, rows)))
    order = np.lexsort((-peak, found.row))
    row = found.row[order]
    rank = np.arange(len(row)) - np.searchsorted(row, row, side="left")
    keep = (rank < CROSSINGS) & (peak[order] > 0.05)
    at, chosen = (row[keep], rank[keep]), order[keep]
    values = (found.u, peak, width, beside, edge, found.shape, contrast)
    for grid, value in zip(out, values, strict=True):
        grid[at] = value[chosen]
    pixels = np.zeros((rows, columns))
    pixels[:, laser.columns] = to_pixels(laser.fine, FINE)
    return with_parts(out, pixels)


def _profile(laser: np.ndarray, u: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Peak near each centre and standard deviation of the light there, of the mean over a row's fine lines."""
    lines = laser.reshape(-1, FINE, laser.shape[1]).mean(1)
    reach = 4 * FINE
    centre = np.rint((u + 0.5) * FINE - 0.5).astype(int)
    at = np.clip(centre[:, None] + np.arange(-reach, reach + 1), 0, laser.shape[1] - 1)
    value = lines[row[:, None], at]
    near = value[:, reach - FINE : reach + FINE + 1].max(1)
    place = (at + 0.5) / FINE - 0.5
    total = np.maximum(value.sum(1), 1e-9)
    mean = (value * place).sum(1) / total
    return near, np.sqrt(np.maximum((value * (place - mean[:, None]) ** 2).sum(1) / total, 0.0))


def _edges(shot: Shot, middle: Hits, shadow: np.ndarray, found: Crossings) -> np.ndarray:
    """Whether a jump, a crease, a shadow or the image's border is near a centre."""
    rows, columns = shot.rig.height, shot.rig.width
    p = middle.p.reshape(rows, columns, 3)
    hit = (middle.shape >= 0).reshape(rows, columns)
    at = np.rint(found.u).astype(int)
    edge = (at < BESIDE_PX) | (at >= columns - BESIDE_PX) | (found.row < ALONG_ROWS) | (found.row >= rows - ALONG_ROWS)
    limit = OFF_PLANE * np.linalg.norm(found.p - shot.pose[:3, 3], axis=1)
    for dv in range(-ALONG_ROWS, ALONG_ROWS + 1):
        for du in range(-BESIDE_PX, BESIDE_PX + 1):
            v, u = np.clip(found.row + dv, 0, rows - 1), np.clip(at + du, 0, columns - 1)
            off = np.abs(((p[v, u] - found.p) * found.normal).sum(1))
            edge |= (off > limit) | ~hit[v, u] | (shadow[v, u] < 0.999)
    return edge


def print_contrast(shot: Shot, u: np.ndarray, row: np.ndarray) -> np.ndarray:
    """(max - min) / (max + min) of the surface's paint within 4 px along the row, behind a blur of 0.75 px."""
    steps = np.arange(-CONTRAST_PX - 2, CONTRAST_PX + 2.01, 0.25)
    lines = []
    for dv in (-0.5, 0.0, 0.5):
        hits = shot.cast((u[:, None] + steps).ravel(), np.repeat(row + dv, len(steps)))
        lines.append(np.where(hits.shape == shot.tracer.board, hits.albedo, np.nan).reshape(len(u), len(steps)))
    level = np.mean(lines, axis=0)
    level[~np.isfinite(level).any(1)] = 1.0
    # Beside the board nothing is known of the print; its border is an edge anyway.
    level = np.where(np.isfinite(level), level, np.nanmax(level, axis=1, keepdims=True))
    level = gaussian_filter1d(level, 0.75 / 0.25, axis=1, mode="nearest")[:, 8:-8]
    high, low = level.max(1), level.min(1)
    return (high - low) / (high + low)
