"""A facet of the scene as the camera sees it: depth, texture and light follow from its plane."""

from typing import Any, NamedTuple

import numpy as np

from jaxscan.simulation.rig import Motion
from jaxscan.simulation.scene.meshes import Surface
from jaxscan.simulation.scene.scene import Scene


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
            rays: Of square tiles, row by row.
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
        """As `Scene.light`."""
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
