"""The scene as every pixel sees it, and its own light there.

Most tiles of a picture show one plane. Which tiles do is found from the rays of their corners and from the edges that
cross them, so that nothing is lost, however small it is; there, depth, texture and light follow from the plane. Rays
are cast for all pixels of the other tiles.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from jaxscan.simulation.rig import Motion, RayTable, TrueRig, project, ray_table
from jaxscan.simulation.scene import Cone, Scene, points_on
from jaxscan.simulation.scene.meshes import Surface
from jaxscan.simulation.settings import CameraSpec


class Rays(NamedTuple):
    """Directions of rays, camera frame, float32, all of one shape."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray | None
    """None where all are 1."""

    def at(self, index: Any) -> "Rays":
        """Some of them."""
        return Rays(self.x[index], self.y[index], None if self.z is None else self.z[index])

    def along(self, way: np.ndarray) -> np.ndarray:
        """Their product with a vector [3]."""
        a, b, c = way.astype(np.float32)
        out = a * self.x
        out += b * self.y
        out += c if self.z is None else c * self.z
        return out


class Plane(NamedTuple):
    """The plane of a facet, and the camera's place."""

    scene: Scene
    surface: Surface
    pose: Motion
    """T_scanner_cam."""
    normal: np.ndarray
    """Towards the camera, scanner frame [3]."""
    offset: float
    """normal . p of its points [m]."""

    @classmethod
    def of(cls, scene: Scene, triangle: int, pose: Motion) -> "Plane":
        """The plane of a triangle."""
        corner, normal = scene.outline.corners[triangle, 0], scene.outline.normal[triangle]
        normal = normal if normal @ (pose.translation - corner) > 0 else -normal
        return cls(scene, scene.mesh.surfaces[scene.surface[triangle]], pose, normal, float(normal @ corner))

    def seen(
        self, rays: Rays, weights: np.ndarray, lit: int, share: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depth and colours of the points that rays [tiles, side^2] meet, float32.

        Args:
            rays: Rays of square tiles, row by row.
            weights: [3, channels], of R, G, B.
            lit: In the first channels stands a picture in the scene's light, in the others the albedo.
            share: That of the lamp's light which arrives; see `shadow`.
        """
        depth = self.depth(rays)
        u, v = self._place(rays, depth)
        material = self.surface.material
        colours = material.albedo(u.ravel(), v.ravel(), weights).reshape(-1, *depth.shape)
        colours[:lit] *= self._light(rays, depth, (u, v), share)
        if material.glow:
            colours[:lit] += np.float32(material.glow)
        return depth, colours

    def _place(self, rays: Rays, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Texture coordinates of points on rays [m]."""
        _, origin, along_u, along_v = self.surface
        start, back = self.pose.translation - origin, self.pose.rotation.T
        u, v = rays.along(back @ along_u), rays.along(back @ along_v)
        for place, way in ((u, along_u), (v, along_v)):
            place *= depth
            place += np.float32(start @ way)
        return u, v

    def shadow(self, rays: Rays) -> np.ndarray | None:
        """Share of the lamp's light on tiles, looked up at every other pixel of every other row.

        Args:
            rays: As for `seen`.

        Returns:
            float32 [tiles, side / 2, side / 2]; None where all of it arrives or none.
        """
        if not self.scene.shadows or self._height() <= 0:
            return None
        side = round(rays.x.shape[1] ** 0.5)
        even = np.arange(0, side, 2)
        share = self.scene.lit_share(self._from_lamp(rays.at((slice(None), (even[:, None] * side + even).ravel()))))
        return None if share.min() == 1 else share.reshape(-1, side // 2, side // 2)

    def depth(self, rays: Rays) -> np.ndarray:
        """Depth at which rays meet the plane, float32."""
        depth = rays.along(self.pose.rotation.T @ self.normal)
        np.divide(np.float32(self.offset - self.normal @ self.pose.translation), depth, out=depth)
        return depth

    def _height(self) -> float:
        """Height of the lamp over the plane, on the camera's side [m]."""
        return float(self.normal @ self.scene.lamp) - self.offset

    def _light(
        self, rays: Rays, depth: np.ndarray, place: tuple[np.ndarray, np.ndarray], share: np.ndarray | None
    ) -> np.ndarray | np.float32:
        """See `Scene.light`."""
        f, scene, height = np.float32, self.scene, self._height()
        sky = f(0.66) + f(0.05) * f(self.normal[2])
        if height <= 0:
            return sky
        _, origin, *axes = self.surface
        if abs(axes[0] @ axes[1]) < 1e-9 and all(abs(axis @ self.normal) < 1e-9 for axis in axes):
            foot = scene.lamp - origin
            r2: np.ndarray = np.square(place[0] - f(foot @ axes[0]))
            r2 += np.square(place[1] - f(foot @ axes[1]))
            r2 += f(height**2)
        else:
            r2 = np.sum([np.square(part) for part in self._from_lamp(rays, depth)], axis=0)
        light = r2 + f(0.6 * scene.reach**2)
        light *= np.sqrt(r2, out=r2)
        np.divide(f(0.95 * scene.reach**2 * height), light, out=light)
        if share is not None:
            half = share.shape[1]
            by_blocks = light.reshape(len(depth), half, 2, half, 2)
            by_blocks *= share[:, :, None, :, None]
        light += sky
        return light

    def _from_lamp(self, rays: Rays, depth: np.ndarray | None = None) -> list[np.ndarray]:
        """Ways x, y, z from the lamp to points on rays."""
        depth = self.depth(rays) if depth is None else depth
        start = self.pose.translation - self.scene.lamp
        return [rays.along(row) * depth + np.float32(at) for row, at in zip(self.pose.rotation, start, strict=True)]


TILE = 8
"""Side of a tile [px]."""
_BATCH = 256
"""Tiles evaluated at a time: their numbers stay in the processor's cache."""
_BEHIND = 1.001
"""Edges deeper than this factor times the deepest corner of a tile are hidden."""
_REACH = 0.4 * TILE
"""Reach of a point of an edge [px]: half the distance to the next one, half a pixel, and a margin."""


class SceneView(NamedTuple):
    """Depth, triangle and light of every pixel, without a board."""

    depth: np.ndarray
    """Along the ray of its centre, float32 [height, width]; inf where nothing is."""
    triangle: np.ndarray
    """Triangle that is hit, int32 [height, width]; the last index of `Scene.normal` where nothing is."""
    ambient: np.ndarray
    """The scene in its own light, float32 [channels, height, width]; white in mean light is 1."""
    albedo: np.ndarray
    """Albedo of the surfaces in further channels, float32 [channels, height, width]."""


class Tiles(NamedTuple):
    """A camera's rays by tiles, row by row; at the lower and right border they are filled up with the last pixels."""

    rays: Rays
    """Rays of all pixels, [tiles, TILE^2]."""
    shape: tuple[int, int]
    """Rows and columns of tiles."""
    corners: np.ndarray
    """Rays of the corners, float32 [(rows + 1) (columns + 1), 3]."""
    cone: Cone
    """The cone that holds the rays of each tile, camera frame."""
    step: float
    """Angle that is nowhere more than half a tile [rad]."""


@lru_cache(maxsize=4)
def tiles_of(camera: CameraSpec) -> Tiles:
    """The tiles of a camera; the last few are kept."""
    table = ray_table(camera)
    height, width = table.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    vectors = table.vectors.reshape(height, width, 3)
    i = np.minimum(np.arange(rows * TILE), height - 1).reshape(rows, 1, TILE, 1)
    j = np.minimum(np.arange(columns * TILE), width - 1).reshape(1, columns, 1, TILE)
    x, y, z = (np.ascontiguousarray(vectors[i, j, k].reshape(-1, TILE * TILE)) for k in range(3))
    down, right = (
        np.minimum(np.arange(0, n * TILE + 1, TILE), size - 1) for n, size in ((rows, height), (columns, width))
    )
    return Tiles(
        Rays(x, y, z if camera.wide else None),
        (rows, columns),
        vectors[down[:, None], right].reshape(-1, 3),
        *_angles(vectors, table),
    )


def _angles(vectors: np.ndarray, table: RayTable) -> tuple[Cone, float]:
    ways = vectors.astype(np.float64)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    axis = ways.reshape(-1, 3).mean(0)
    axis /= np.linalg.norm(axis)
    cone = Cone(axis, float(np.arccos(np.clip(np.min(ways @ axis), -1, 1))))
    sees = np.ones(table.shape, bool) if table.sees is None else table.sees
    narrowest = np.inf
    for first, second in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        apart = np.linalg.norm(ways[first] - ways[second], axis=-1)[sees[first] & sees[second]]
        narrowest = min(narrowest, float(apart.min(initial=np.inf)))
    # Pixels are not quite square, and a step may run along their diagonal.
    return cone, 0.4 * TILE * narrowest


def observe(
    rig: TrueRig, scene: Scene, pose: Motion, channels: np.ndarray, further: np.ndarray | None = None
) -> SceneView:
    """The scene from a pose of the camera.

    Args:
        channels: Weights [3, channels] of R, G, B for the picture.
        further: Weights [3, further] of R, G, B for `SceneView.albedo`.
    """
    tiles = tiles_of(rig.config.camera)
    count = channels.shape[1]
    weights = channels if further is None else np.concatenate([channels, further], 1)
    size = (len(tiles.rays.x), TILE * TILE)
    depth, picture = np.empty(size, np.float32), np.empty((weights.shape[1], *size), np.float32)
    triangle = np.empty(size, np.int32)
    nothing, first = len(scene.normal) - 1, plain_tiles(rig, tiles, scene, pose)
    triangle[:] = first[:, None]
    facet = np.where(first < 0, -2, scene.outline.facet[first])
    order = np.argsort(facet, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(facet[order])) + 1):
        shown = int(first[part[0]])
        if shown == nothing:
            depth[part], picture[:, part] = np.inf, 0
        elif shown < 0:
            for batch in _batches(part):
                depth[batch], triangle[batch], picture[:, batch] = _every_ray(
                    tiles.rays.at(batch), scene, pose, weights, count
                )
        else:
            plane = Plane.of(scene, shown, pose)
            share = plane.shadow(tiles.rays.at(part))
            for start in range(0, len(part), _BATCH):
                batch = part[start : start + _BATCH]
                here = None if share is None else share[start : start + _BATCH]
                depth[batch], picture[:, batch] = plane.seen(tiles.rays.at(batch), weights, count, here)
    seen, hit, picture = (_image(part, tiles.shape, rig.rays.shape) for part in (depth, triangle, picture))
    return SceneView(seen, hit, picture[:count], picture[count:])


def points_at(
    rig: TrueRig, pose: Motion, depth: np.ndarray, index: tuple[np.ndarray | slice, ...] = (slice(None), slice(None))
) -> np.ndarray:
    """Points that pixels see, float32 [..., 3], scanner frame; the camera's place where nothing is.

    Args:
        depth: Depth of all pixels [height, width].
    """
    far = depth[index]
    reached = np.where(np.isfinite(far), far, np.float32(0))[..., None]
    return pose.apply(rig.rays.vectors.reshape(*depth.shape, 3)[index] * reached)


def _batches(part: np.ndarray) -> list[np.ndarray]:
    return np.array_split(part, -(-len(part) // _BATCH))


def plain_tiles(rig: TrueRig, tiles: Tiles, scene: Scene, pose: Motion) -> np.ndarray:
    """A triangle of the one facet that every tile shows, int64 [tiles]; -1 where it may show several."""
    rows, columns = tiles.shape
    far, triangle = (
        part.reshape(rows + 1, columns + 1) for part in scene.cast(pose.translation, pose.turn(tiles.corners))
    )
    facet = scene.outline.facet[triangle]
    one = facet[:-1, :-1]
    alike = (one == facet[1:, :-1]) & (one == facet[:-1, 1:]) & (one == facet[1:, 1:])
    deepest = np.maximum(np.maximum(far[:-1, :-1], far[1:, :-1]), np.maximum(far[:-1, 1:], far[1:, 1:]))
    nearest = _nearest_edges(rig, tiles, scene, pose)
    # A tile that sees nothing, and no edge, is plain too.
    alike &= (nearest > np.float32(_BEHIND) * deepest) | (np.isinf(nearest) & np.isinf(deepest))
    return np.where(alike, triangle[:-1, :-1], -1).ravel()


def _nearest_edges(rig: TrueRig, tiles: Tiles, scene: Scene, pose: Motion) -> np.ndarray:
    """Depth of the nearest edge in every tile, float32 [rows, columns]; inf where there is none."""
    camera = rig.config.camera
    cone = Cone(pose.rotation @ tiles.cone.axis, tiles.cone.half)
    points = pose.inverse().apply(points_on(scene.outline.edges, pose.translation, tiles.step, cone))
    if not camera.wide:
        points = points[points[:, 2] > 0]
    u, v = project(camera, points)
    depth = (np.linalg.norm(points, axis=-1) if camera.wide else points[:, 2]).astype(np.float32)
    rows, columns = tiles.shape
    nearest = np.full((rows + 2, columns + 2), np.inf, np.float32)
    for dv in (-_REACH, _REACH):
        for du in (-_REACH, _REACH):
            # The rim takes the points outside the picture.
            row = np.clip(np.floor((v + dv) / TILE) + 1, 0, rows + 1).astype(np.intp)
            column = np.clip(np.floor((u + du) / TILE) + 1, 0, columns + 1).astype(np.intp)
            np.minimum.at(nearest, (row, column), depth)
    return nearest[1:-1, 1:-1]


def _every_ray(
    rays: Rays, scene: Scene, pose: Motion, weights: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, triangle and picture [n, TILE^2] of some tiles, by a ray for each pixel."""
    shape = rays.x.shape
    z = np.broadcast_to(np.float32(1) if rays.z is None else rays.z, shape)
    ways = pose.turn(np.stack([rays.x, rays.y, z], -1).reshape(-1, 3))
    far, triangle = scene.cast(pose.translation, ways)
    hit = np.isfinite(far)
    points = ways * np.where(hit, far, np.float32(0))[:, None] + pose.translation.astype(np.float32)
    colour, glow = scene.look(triangle, points, weights)
    # In rows of tiles, of which every other pixel of every other row is looked up in the shadow.
    field = (len(points) // TILE, TILE)
    light = scene.light(points.reshape(*field, 3), scene.normal[triangle].reshape(*field, 3), pose.translation).ravel()
    colour[:count] = (colour[:count] * light + glow) * hit
    return far.reshape(shape), triangle.reshape(shape), colour.reshape(-1, *shape)


def _image(tiled: np.ndarray, shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Values [..., tiles, TILE^2] as pictures [..., height, width]."""
    rows, columns = shape
    height, width = size
    blocks = tiled.reshape(*tiled.shape[:-2], rows, columns, TILE, TILE).swapaxes(-3, -2)
    return np.ascontiguousarray(blocks.reshape(*tiled.shape[:-2], rows * TILE, columns * TILE)[..., :height, :width])
