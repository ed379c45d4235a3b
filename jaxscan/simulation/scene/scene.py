"""The scene: triangles for ray casting, and the room's light at the points that are hit."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from jaxscan.simulation.rig import Motion, rodrigues
from jaxscan.simulation.scene.caster import Caster
from jaxscan.simulation.scene.edges import Outline
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.room import LAMP_HEIGHT_SHARE, furnish, set_table
from jaxscan.simulation.scene.shadow import LampView
from jaxscan.simulation.settings import SimulationConfig


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles in the scanner frame."""

    caster: Caster
    mesh: Mesh
    surface: np.ndarray
    """Surface of each triangle, int64 [triangles + 1]; the last entry is for rays that hit nothing."""
    normal: np.ndarray
    """Unit normal of each triangle, float32 [triangles + 1, 3]."""
    lamp: np.ndarray
    """Position of the lamp [m]."""
    reach: float
    """Distance at which the lamp's light is of mean strength [m]."""
    shadows: bool
    mirror: np.ndarray
    """Share of the light that each triangle reflects as a mirror, float32 [triangles + 1]."""
    outline: Outline
    """Facets, and the edges between them."""
    lamp_view: LampView

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest hits of rays from one point.

        Args:
            origin: [3], m, or one for each ray.
            directions: [rays, 3], of any length.

        Returns:
            t: float32 [rays]: hit = origin + t direction; inf where nothing is hit.
            triangle: int64 [rays]; the last index of `normal` where nothing is hit.
        """
        t, triangle = self.caster.nearest(origin, directions)
        return t, np.where(triangle < 0, len(self.normal) - 1, triangle)

    def facing(self, eye: np.ndarray) -> np.ndarray:
        """Unit normal of each triangle on the side of a place [3], float32 [triangles + 1, 3]."""
        behind = np.sum(self.outline.normal * (eye - self.outline.corners[:, 0]), -1) < 0
        return np.where(np.append(behind, False)[:, None], -self.normal, self.normal)

    def glass(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """A point and the unit normal of every mirror."""
        ends = np.cumsum([len(part) for part in self.mesh.triangles])
        parts = zip(self.mesh.surfaces, self.mesh.triangles, ends, strict=True)
        return [(part[0, 0], self.normal[end - 1]) for surface, part, end in parts if surface.material.mirror > 0]

    def reflect(
        self, eye: np.ndarray, points: np.ndarray, triangle: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The points seen in mirrors.

        Args:
            eye: Where the camera is [3], m.
            points: Points of mirrors [n, 3].
            triangle: Their triangles [n].

        Returns:
            Distance from the mirror in lengths of the way to it, inf where nothing is, triangle, and points [n, 3].
        """
        ways, normal = points - eye.astype(points.dtype), self.normal[triangle]
        ways = ways - 2 * np.sum(ways * normal, -1, keepdims=True) * normal
        far, behind = self.cast(points + np.float32(1e-4) * ways, ways)
        return far, behind, points + np.where(np.isfinite(far), far, 0)[:, None] * ways

    def blocked(self, origin: np.ndarray, points: np.ndarray, *, skin: float = 1e-3) -> np.ndarray:
        """Whether something stands between `origin` [3] and each of `points` [n, 3], bool [n].

        The last `skin` metres before the point are not looked at: they are its own surface.
        """
        return _occluded(self.caster, origin, points - origin.astype(points.dtype), skin)

    def lit_share(self, legs: list[np.ndarray]) -> np.ndarray:
        """Share of the lamp's light that ends of ways x, y, z from the lamp receive, float32 of their shape."""
        dark = _occluded(self.caster, self.lamp, np.stack(legs, -1).reshape(-1, 3), 5e-3).reshape(legs[0].shape)
        return np.where(dark, np.float32(0.25), np.float32(1))

    def ambient(self, triangle: np.ndarray, points: np.ndarray, view: np.ndarray, channels: np.ndarray) -> np.ndarray:
        """A picture in the room's own light, float32 [channels, rows, columns]; white in mean light is 1.

        Args:
            triangle: Hit triangles [rows, columns].
            points: Hit points float32 [rows, columns, 3].
            view: Where the camera is [3]; surfaces are seen from this side.
            channels: [3, channels], weights of R, G, B.
        """
        colour, glow = self.look(triangle.ravel(), points.reshape(-1, 3), channels)
        colour *= self.light(points, self.normal[triangle], view).ravel()
        colour += glow
        return colour.reshape(-1, *triangle.shape)

    def light(self, points: np.ndarray, normal: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Strength of the room's light at points [rows, columns, 3] with normals of either sense, float32."""
        f = np.float32
        (x, y, z), (a, b, c) = (np.moveaxis(part, -1, 0) for part in (points, normal))
        plane = a * x + b * y + c * z
        (vx, vy, vz), (lx, ly, lz) = view.astype(f), self.lamp.astype(f)
        sense = np.where(vx * a + vy * b + vz * c < plane, f(-1), f(1))
        r2 = np.square(lx - x) + np.square(ly - y) + np.square(lz - z)
        cosine = np.maximum((lx * a + ly * b + lz * c - plane) * sense, 0) / np.sqrt(r2)
        direct = cosine * f(0.95 * self.reach**2) / (r2 + f(0.6 * self.reach**2))
        if self.shadows:
            direct *= self._shadow(points, direct > 0)
        # Light from all sides: a little more from above than from below.
        return f(0.66) + f(0.05) * c * sense + direct

    def lamp_light(self, points: np.ndarray) -> np.ndarray:
        """Strength of the lamp's light on surfaces that face it, at points [rows, columns, 3]; as `light`."""
        r2 = np.sum(np.square(points - self.lamp.astype(np.float32)), -1)
        light = np.float32(0.95 * self.reach**2) / (r2 + np.float32(0.6 * self.reach**2))
        return light * self._shadow(points, np.ones(light.shape, bool)) if self.shadows else light

    def _shadow(self, points: np.ndarray, facing: np.ndarray) -> np.ndarray:
        """Share of the lamp's light at points [rows, columns, 3], looked up at every other one.

        It stays 1 where none of four points is `facing` the lamp, bool [rows, columns].
        """
        rows, columns = facing.shape
        asked = facing[::2, ::2].copy()
        asked[: rows // 2] |= facing[1::2, ::2]
        asked[:, : columns // 2] |= facing[::2, 1::2]
        asked[: rows // 2, : columns // 2] |= facing[1::2, 1::2]
        share = np.ones(asked.shape, np.float32)
        share[asked] = self.lit_share(list((points[::2, ::2][asked] - self.lamp.astype(points.dtype)).T))
        return share.repeat(2, 0).repeat(2, 1)[:rows, :columns]

    def look(self, triangle: np.ndarray, points: np.ndarray, channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Albedo [channels, n] and glow [n], float32, at hit points [n, 3]; `channels` [3, channels] weighs R, G, B.

        Points are sorted by surface, and each surface is evaluated at once.
        """
        surface = self.surface[triangle]
        order = np.argsort(surface.astype(np.uint16), kind="stable")
        counts = np.bincount(surface, minlength=len(self.mesh.surfaces) + 1)
        ends = np.cumsum(counts)
        colour = np.zeros((channels.shape[1], len(points)), np.float32)
        glow = np.zeros(len(points), np.float32)
        for index in np.flatnonzero(counts[:-1]):
            part = order[ends[index] - counts[index] : ends[index]]
            material, origin, along_u, along_v = self.mesh.surfaces[index]
            x, y, z = points.take(part, 0).T
            u, v = (
                x * np.float32(axis[0])
                + y * np.float32(axis[1])
                + (z * np.float32(axis[2]) - np.float32(axis @ origin))
                for axis in (along_u, along_v)
            )
            colour[:, part] = material.albedo(u, v, channels)
            if material.glow:
                glow[part] = material.glow
        return colour, glow


def room_from_scanner(config: SimulationConfig) -> Motion:
    """Scanner coordinates to the room's (origin in a corner on the floor); identity without a room."""
    if config.room is None:
        return Motion(np.eye(3), np.zeros(3))
    yaw = np.deg2rad(config.room.yaw_deg)
    return Motion(rodrigues(np.array([0.0, 0.0, 1.0]), yaw), np.array(config.room.rig_m))


@lru_cache(maxsize=4)
def make_scene(
    config: SimulationConfig, *, boards: bool = False, extras: Callable[[Mesh], None] | None = None
) -> Scene:
    """The scene of a configuration; the last few are kept.

    Where the table carries an object, that is taken off to make place for `boards`. `extras` adds surfaces to a room,
    in its coordinates: origin in a corner on the floor, x and y along the walls, z up [m].
    """
    if config.room is not None:
        mesh = furnish(config.room)
        if extras is not None:
            extras(mesh)
        size = np.array(config.room.size_m)
        lamp, reach = size * (0.5, 0.5, LAMP_HEIGHT_SHARE), float(np.mean(size[:2]) / 2)
    elif config.object is not None:
        mesh = set_table(config.object, empty=boards)
        lamp, reach = np.array([-0.6, 0.8, 1.0]), 1.4
    else:
        mesh, lamp, reach = Mesh(), np.zeros(3), 1.0
    motion = room_from_scanner(config).inverse()
    return build_scene(_carry(mesh, motion), motion.apply(lamp), reach, shadows=config.light.shadows)


def build_scene(mesh: Mesh, lamp: np.ndarray, reach: float, *, shadows: bool) -> Scene:
    """A scene of a mesh in the scanner frame."""
    corners = np.concatenate(mesh.triangles)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    surface = np.repeat(np.arange(len(mesh.triangles)), [len(part) for part in mesh.triangles])
    outline = Outline(mesh, normal)
    return Scene(
        Caster(corners),
        mesh,
        np.append(surface, len(mesh.triangles)),
        np.concatenate([normal, np.zeros((1, 3))]).astype(np.float32),
        lamp,
        reach,
        shadows,
        np.append(np.array([part.material.mirror for part in mesh.surfaces], np.float32)[surface], np.float32(0)),
        outline,
        LampView(outline, lamp),
    )


def _carry(mesh: Mesh, motion: Motion) -> Mesh:
    surfaces = [
        surface._replace(
            origin=motion.apply(surface.origin),
            along_u=motion.rotation @ surface.along_u,
            along_v=motion.rotation @ surface.along_v,
        )
        for surface in mesh.surfaces
    ]
    return Mesh([motion.apply(part) for part in mesh.triangles], surfaces)


def _occluded(caster: Caster, origin: np.ndarray, legs: np.ndarray, skin: float) -> np.ndarray:
    """Whether something stands on ways [n, 3] from `origin`, before their last `skin` metres, bool [n]."""
    distance = np.sqrt(np.einsum("ij,ij->i", legs, legs))
    return caster.blocked(origin, legs * np.maximum(1 - skin / np.maximum(distance, 1e-9), 0)[:, None])
