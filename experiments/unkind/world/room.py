"""A furnished room drawn by chance: flat patches, a sphere and a cylinder with textured paint. NumPy alone.

The room's frame has its origin in a corner of the floor and z upwards; metres.
"""

from typing import NamedTuple

import numpy as np


STEP_M = 0.05
"""How far the panels stand out of their walls."""
HEIGHT_M = 2.5


class Patch(NamedTuple):
    """A flat parallelogram, painted on the side of the cross product of its edges."""

    name: str
    origin: np.ndarray
    along: np.ndarray
    up: np.ndarray
    """Its edges [3], m; the paint's columns run along the first, its rows along the second."""
    paint: np.ndarray
    """Reflectance, float32 [rows, columns]."""

    def normal(self) -> np.ndarray:
        """Unit normal on the painted side."""
        cross = np.cross(self.along, self.up)
        return cross / np.linalg.norm(cross)


class Round(NamedTuple):
    """A sphere, or an upright cylinder."""

    name: str
    kind: str
    centre: np.ndarray
    """Of the sphere, or of the cylinder's foot."""
    radius: float
    height: float
    reflectance: float


class Room(NamedTuple):
    """All surfaces, the lamps, the four walls, and where the rig stands."""

    size: np.ndarray
    patches: list[Patch]
    rounds: list[Round]
    lamps: list[tuple[np.ndarray, float]]
    """Centre [3] and half side of square lamps under the ceiling; m."""
    camera: np.ndarray
    """T_room_cam [4, 4] at the table's angle 0."""


def paint(rng: np.random.Generator, base: float, *, spread: float = 0.05, size: int = 128) -> np.ndarray:
    """Paint with soft clouds, fine grain and perhaps sharp stripes, float32 [size, size]."""
    clouds = np.zeros((size, size))
    for cells in (4, 9, 19):
        coarse = rng.standard_normal((cells, cells))
        index = np.linspace(0, cells - 1.001, size)
        low = index.astype(int)
        part = index - low
        rows = coarse[low] * (1 - part)[:, None] + coarse[np.minimum(low + 1, cells - 1)] * part[:, None]
        clouds += rows[:, low] * (1 - part) + rows[:, np.minimum(low + 1, cells - 1)] * part
    grain = rng.standard_normal((size, size))
    return np.clip(base * (1 + spread * clouds / 1.7 + 0.3 * spread * grain), 0.03, 0.9).astype(np.float32)


def picture(rng: np.random.Generator, size: int = 96) -> np.ndarray:
    """A framed picture of hard-edged blocks, float32 [size, size]."""
    image = np.full((size, size), rng.uniform(0.2, 0.6))
    for _ in range(14):
        row, column = rng.integers(0, size - 8, 2)
        image[row : row + rng.integers(6, 40), column : column + rng.integers(6, 40)] = rng.uniform(0.05, 0.85)
    return image.astype(np.float32)


def spines(rng: np.random.Generator, books: int) -> np.ndarray:
    """Backs of books: upright stripes of different reflectance, float32 [16, 8 books]."""
    return np.repeat(np.repeat(rng.uniform(0.06, 0.75, books)[None], 8, 1), 16, 0).astype(np.float32)


def box(name: str, low: np.ndarray, size: np.ndarray, paints: list[np.ndarray]) -> list[Patch]:
    """Six patches, painted outside; paints are used in turn."""
    x, y, z = (np.eye(3)[k] * size[k] for k in range(3))
    corner = np.asarray(low, float)
    sides = [
        (corner, x, z),
        (corner + x, y, z),
        (corner + x + y, -x, z),
        (corner + y, -y, z),
        (corner + z, x, y),
        (corner + y, x, -y),
    ]
    return [
        Patch(f"{name} {k}", origin, along, up, paints[k % len(paints)]) for k, (origin, along, up) in enumerate(sides)
    ]


def draw_room(rng: np.random.Generator) -> Room:
    """A room of 4 to 4.3 m with a rig in its middle."""
    size = np.array([*rng.uniform(4.0, 4.3, 2), HEIGHT_M])
    camera = _place_rig(rng, size)
    eye = camera[:3, 3]
    patches = _shell(rng, size)
    patches += _panels(rng, size, eye[2])
    patches += _furniture(rng, size)
    table = np.array([size[0] - 0.75, 0.75, 0.0])
    rounds = [
        Round("ball", "sphere", table + np.array([-0.1, 0.05, 0.93]), 0.2, 0.0, rng.uniform(0.4, 0.7)),
        Round("column", "cylinder", np.array([0.65, size[1] - 0.7, 0.0]), rng.uniform(0.12, 0.2), 2.0, 0.5),
        Round("lamp", "cylinder", np.array([size[0] - 0.6, size[1] - 0.9, 0.0]), 0.08, 1.7, rng.uniform(0.1, 0.3)),
    ]
    lamps = [(np.array([x * size[0], y * size[1], HEIGHT_M - 0.02]), 0.3) for x, y in ((0.3, 0.35), (0.7, 0.65))]
    return Room(size, patches, rounds, lamps, camera)


def _place_rig(rng: np.random.Generator, size: np.ndarray) -> np.ndarray:
    """T_room_cam: near the middle, 1.1 to 1.25 m high, level within a degree."""
    yaw = rng.uniform(0, 2 * np.pi)
    ahead = np.array([np.cos(yaw), np.sin(yaw), rng.uniform(-0.015, 0.015)])
    ahead /= np.linalg.norm(ahead)
    down = np.array([rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01), -1.0])
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    camera = np.eye(4)
    camera[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], 1)
    camera[:3, 3] = [*(size[:2] / 2 + rng.uniform(-0.15, 0.15, 2)), rng.uniform(1.1, 1.25)]
    return camera


def _shell(rng: np.random.Generator, size: np.ndarray) -> list[Patch]:
    """Walls, floor and ceiling, painted inside."""
    x, y, z = (np.eye(3)[k] * size[k] for k in range(3))
    zero = np.zeros(3)
    sides = {
        "wall y0": (x, -x, z),
        "wall x0": (zero, y, z),
        "wall y1": (y, x, z),
        "wall x1": (x + y, -y, z),
        "floor": (zero, x, y),
        "ceiling": (z, y, x),
    }
    patches = []
    # One wall is dark, so that stripes of all brightnesses occur.
    walls = dict(zip(rng.permutation([name for name in sides if "wall" in name]), (0.15, 0.35, 0.55, 0.7), strict=True))
    for name, (origin, along, up) in sides.items():
        base = {"floor": 0.35, "ceiling": 0.75, **walls}[name] * rng.uniform(0.95, 1.05)
        patches.append(Patch(name, origin, along, up, paint(rng, base, spread=0.06 if "wall" in name else 0.1)))
        assert np.allclose(patches[-1].normal() @ (size / 2 - origin - (along + up) / 2) > 0, True)
    return patches


def _panels(rng: np.random.Generator, size: np.ndarray, height: float) -> list[Patch]:
    """Panels that stand 50 mm out of three walls, their upper edges at the height of the camera."""
    middle = size[:2] / 2
    long = 1.2
    places = [
        (np.array([0.0, middle[1] - long / 2 + rng.uniform(-0.2, 0.2), 0.0]), np.array([STEP_M, long, height])),
        (np.array([middle[0] - long / 2 + rng.uniform(-0.2, 0.2), 0.0, 0.0]), np.array([long, STEP_M, height])),
        (
            np.array([size[0] - STEP_M, middle[1] - long / 2 + rng.uniform(0.0, 0.4), 0.0]),
            np.array([STEP_M, long, height]),
        ),
    ]
    flat = [np.full((8, 8), value, np.float32) for value in rng.uniform(0.5, 0.65, 3)]
    return [patch for k, (low, extent) in enumerate(places) for patch in box(f"panel {k}", low, extent, [flat[k]])]


def _furniture(rng: np.random.Generator, size: np.ndarray) -> list[Patch]:
    """A table, a shelf with books, boxes and a picture on the wall."""
    wood = [paint(rng, rng.uniform(0.2, 0.45), spread=0.12) for _ in range(3)]
    patches = []
    x, y = size[0] - 1.15, 0.35
    patches += box("table top", np.array([x, y, 0.7]), np.array([0.8, 0.8, 0.03]), wood)
    for k, (dx, dy) in enumerate(((0.03, 0.03), (0.72, 0.03), (0.03, 0.72), (0.72, 0.72))):
        patches += box(f"leg {k}", np.array([x + dx, y + dy, 0.0]), np.array([0.05, 0.05, 0.7]), wood)
    patches += box(
        "carton",
        np.array([x + 0.45, y + 0.45, 0.73]),
        np.array([0.25, 0.2, rng.uniform(0.3, 0.5)]),
        [picture(rng), paint(rng, 0.4)],
    )
    # The shelf stands against the wall at y1.
    left, depth = size[0] / 2 - 0.1 + rng.uniform(-0.1, 0.1), 0.28
    for k, z in enumerate((0.3, 0.72, 1.14, 1.56)):
        patches += box(f"shelf {k}", np.array([left, size[1] - depth, z]), np.array([0.8, depth, 0.025]), wood)
        wide = rng.uniform(0.4, 0.75)
        books = np.array([wide, rng.uniform(0.14, 0.22), rng.uniform(0.2, 0.34)])
        low = np.array([left + 0.02, size[1] - 0.02 - books[1], z + 0.025])
        patches += box(f"books {k}", low, books, [spines(rng, int(wide / 0.04))])
    for k, dx in enumerate((0.0, 0.775)):
        patches += box(f"side {k}", np.array([left + dx, size[1] - depth, 0.0]), np.array([0.025, depth, 1.9]), wood)
    patches += box("chest", np.array([0.05, 0.1, 0.0]), np.array([0.6, 0.5, rng.uniform(0.85, 1.3)]), wood)
    patches += box(
        "crate", np.array([0.3, size[1] - 1.5, 0.0]), np.array([0.35, 0.4, rng.uniform(0.9, 1.3)]), [picture(rng)]
    )
    wide = rng.uniform(0.5, 0.8)
    frame = np.array([0.9, 0.004, rng.uniform(1.35, 1.5)])
    patches += [
        Patch("picture", frame + np.array([wide, 0, 0]), np.array([-wide, 0, 0]), np.array([0, 0, 0.45]), picture(rng))
    ]
    return patches
