"""Mitsuba 3 as the eye and the light of a room: rays, the lamps' light, and the laser's light that comes back.

The lamps' light does not depend on where the camera stands: it is traced once per room, on a grid on every surface
(Mitsuba's path tracer, next event estimation, five bounces), and looked up in every frame. Of the laser's light, that
which comes back from other surfaces is traced from the sheet: paths of up to three bounces, joined to the camera's
points by shadow rays (bidirectional path tracing with the light's paths shared by all pixels).
"""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.unkind.world.room import Patch, Room, Round


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
