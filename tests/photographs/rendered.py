"""A rendered corner of a room: a box before a wall, a slanted bar and print on the wall; with the cloud of a perfect
scanner."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.photographs import Photograph, Photographs
from jaxscan.reconstruction import PointCloud
from jaxscan.simulation import SimulationConfig, make_rig, make_scene, render_sweep, true_cloud, true_scanner
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.scene import Scene
from jaxscan.simulation.scene.textures import Blend, Material


WALL_X = 1.9
"""The wall that everything is about, scanner frame [m]."""
BOX = (1.1, 1.4)
"""Where the box begins and ends along x."""
BOX_Y = (-0.25, 0.15)
RED, WHITE, DARK = (0.85, 0.10, 0.08), (0.75, 0.75, 0.72), (0.06, 0.06, 0.08)
BAR_SLOPE, BAR_AT, BAR_HALF = 0.12, 0.45, 0.02
"""The bar runs along z = slope y + at, this far to both sides [m]."""


class World(NamedTuple):
    """Everything that a test may ask for."""

    config: SimulationConfig
    scene: Scene
    scanner: Scanner
    cloud: PointCloud
    angles: np.ndarray
    images: list[np.ndarray]

    @property
    def photographs(self) -> Photographs:
        shots = [Photograph(float(angle), image) for angle, image in zip(self.angles, self.images, strict=True)]
        return Photographs(self.scanner, shots)

    def truth(self, points: np.ndarray, eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """True colours [DN] of points seen from a place, and whether nothing stands before them."""
        ways = (points - eye).astype(np.float32)
        t, triangle = self.scene.cast(eye, ways)
        hit = (eye + t[:, None] * ways).astype(np.float32)
        light = self.scene.ambient(triangle[None], hit[None], eye, np.eye(3, dtype=np.float32))[:, 0].T
        return self.config.light.white_dn * light, np.abs(t - 1) * np.linalg.norm(ways, axis=-1) < 5e-3

    def eyes(self) -> list[np.ndarray]:
        """Places of the camera."""
        rig = make_rig(self.config)
        return [rig.pose(float(angle)).translation for angle in self.angles]


def make_world() -> World:
    """Render the corner: 41 photographs, 2 degrees apart."""
    config = SimulationConfig.model_validate(
        {
            "camera": {"width": 320, "height": 240, "fx": 260.0, "fy": 260.3, "cx": 161.2, "cy": 118.1, "k1": -0.05},
            "sensor": {"pixel_format": "rgb8", "psf_px": 0.6},
            "laser": {"baseline_m": 0.3, "crossing_m": 2.0, "fan_deg": 110.0},
            "turntable": {"direction": (0.012, -0.99989, 0.008), "point_m": (0.12, 0.0, -0.06)},
            "room": {"size_m": (3.5, 4.0, 2.4), "rig_m": (1.5, 2.0, 1.2), "yaw_deg": 0.0, "furniture": False},
            "light": {"shadows": False},
        }
    )
    scene = make_scene(config, extras=furnish)
    angles = np.deg2rad(np.arange(-40.0, 41.0, 2.0))
    records = list(render_sweep(config, angles=angles, scene=scene))
    scanner = true_scanner(config)
    world = World(config, scene, scanner, None, angles, [record.off for record in records])
    return world._replace(cloud=cloud_of(world, records))


def furnish(mesh: Mesh) -> None:
    """Room coordinates: the scanner's are (1.5, 2.0, 1.2) less."""
    shift = np.array([1.5, 2.0, 1.2])
    plain = Material((WHITE, DARK), _pattern)
    mesh.quad(shift + (WALL_X, 1.9, -1.1), np.array([0, -3.8, 0]), np.array([0, 0, 2.2]), plain)
    size = BOX[1] - BOX[0], BOX_Y[1] - BOX_Y[0], 0.6
    foot = shift + (np.mean(BOX), np.mean(BOX_Y), -0.5)
    mesh.box(tuple(foot), size, Material((RED,)))


def wall_albedo(y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Share of dark ink on the wall at scanner coordinates: the bar, and a print of fine upright lines."""
    bar = np.abs(z - BAR_SLOPE * y - BAR_AT) < BAR_HALF
    print_ = (np.abs(y - 0.75) < 0.3) & (np.abs(z + 0.2) < 0.25) & (np.mod(y, 0.08) < 0.04)
    return (bar | print_).astype(np.float32)


def _pattern(u: np.ndarray, v: np.ndarray) -> Blend:
    return Blend(0, 1, wall_albedo(1.9 - u, v - 1.1), 1.0)


def cloud_of(world: World, records: list) -> PointCloud:
    """What a perfect scanner finds in records."""
    xyz, valid, angle = true_cloud(records)
    rgb, normals = np.zeros((*valid.shape, 3), np.uint8), np.zeros((*valid.shape, 3), np.float32)
    rig = make_rig(world.config)
    for number, phi in enumerate(angle):
        eye, on = rig.pose(float(phi)).translation, valid[number]
        colours, _ = world.truth(xyz[number][on], eye)
        rgb[number][on] = np.clip(np.rint(colours), 0, 255)
        _, triangle = world.scene.cast(eye, (xyz[number][on] - eye).astype(np.float32))
        normals[number][on] = world.scene.facing(eye)[triangle]
    nothing = np.zeros(valid.shape, np.float32)
    return PointCloud(
        xyz=xyz.astype(np.float32),
        rgb=rgb,
        intensity=nothing,
        normals=normals,
        sigma_random=nothing,
        sigma_systematic=nothing,
        valid=valid,
        record=np.arange(len(valid), dtype=np.int32),
        laser=np.zeros(len(valid), np.int32),
        angle=angle,
    )
