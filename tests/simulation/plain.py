"""A plain camera before walls, whose pictures have closed forms."""

import numpy as np

from jaxscan.simulation import CameraSpec, LaserSpec, LightSpec, RoomSpec, SimulationConfig, TurntableSpec
from jaxscan.simulation.scene import Material, Mesh, build_scene


# The principal point lies on the border of two samples (eighths of a pixel), for edges put there.
F, CX, WIDTH = 300.0, 79.625, 160
GREY = Material(((0.7, 0.7, 0.7),))


def config(height=180, sheet=None, **changes) -> SimulationConfig:
    """A camera that looks along the scanner's x: camera z = x, camera x = -y, camera y = -z.

    Its sheet crosses the optical axis at 2 m; `sheet` has further numbers of it.
    """
    base = {
        "camera": CameraSpec(width=WIDTH, height=height, fx=F, fy=F, cx=CX, cy=height / 2 + 0.3),
        "laser": LaserSpec(**{"baseline_m": 0.3, "crossing_m": 2.0, **(sheet or {})}),
        "turntable": TurntableSpec(direction=(0, -1, 0), point_m=(0, 0, 0)),
        "room": RoomSpec(furniture=False),
        "light": LightSpec(shadows=False),
    }
    return SimulationConfig(**{**base, **changes})


def wall(mesh: Mesh, z: float, material: Material = GREY, *, left=-9.0, right=9.0, slope=0.0) -> None:
    """A wall across the view, at depth z + slope * x of the camera's frame, from `left` to `right`."""
    origin = np.array([z + slope * left, -left, -9.0])
    mesh.quad(origin, np.array([slope * (right - left), left - right, 0.0]), np.array([0.0, 0.0, 18.0]), material)


def scene_of(*walls):
    """A scene of functions that add to a mesh."""
    mesh = Mesh()
    for add in walls:
        add(mesh)
    return build_scene(mesh, np.array([0.0, 0.0, 2.0]), 2.0, shadows=False)
