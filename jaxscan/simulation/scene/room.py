"""The furniture of a living room, and a small object on a plate.

Room coordinates: origin in a corner on the floor, x and y along the walls, z up. Pieces stand
along the walls or in corners. Their sizes are fixed, so small rooms are fuller; of each wall more
than 40 % stays visible.
"""

from functools import partial

import numpy as np

from jaxscan.simulation.scene import textures
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.textures import Material, framed
from jaxscan.simulation.settings import MirrorSpec, ObjectSpec, RoomSpec


LAMP_HEIGHT_SHARE = 0.93
"""Height of the lamp under the ceiling, as a share of the room's."""

_OAK = Material(((0.52, 0.34, 0.18), (0.42, 0.26, 0.13)), textures.wood)
_WHITE = Material(((0.80, 0.79, 0.76),))
_DARK = Material(((0.16, 0.15, 0.15),))
_BRASS = Material(((0.66, 0.52, 0.22),))
_SOFA = Material(((0.20, 0.34, 0.56), (0.26, 0.42, 0.64)), textures.weave)
_CUSHION = Material(((0.80, 0.50, 0.16), (0.86, 0.78, 0.62)), partial(textures.stripes, period=0.08))
_LEAF = Material(((0.14, 0.40, 0.13), (0.22, 0.52, 0.18)), partial(textures.checker, size=0.05))
_POT = Material(((0.66, 0.34, 0.22),))
_BALL = Material(((0.82, 0.18, 0.14), (0.86, 0.84, 0.80)), partial(textures.stripes, period=0.12))
_BOOKS = (
    (0.14, 0.10, 0.07),
    (0.62, 0.16, 0.14),
    (0.16, 0.30, 0.52),
    (0.74, 0.62, 0.30),
    (0.20, 0.44, 0.28),
    (0.78, 0.76, 0.70),
    (0.46, 0.24, 0.46),
)


def furnish(room: RoomSpec) -> Mesh:
    """The room as triangles, room coordinates."""
    mesh = Mesh()
    _shell(mesh, room)
    if room.mirror is not None:
        _mirror(mesh, room, room.mirror)
    if room.furniture:
        _openings(mesh, room)
        _pictures(mesh, room)
        _sofa(mesh, room)
        _shelf(mesh, room)
        _table(mesh, room)
        _small_things(mesh, room)
    return mesh


def _shell(mesh: Mesh, room: RoomSpec) -> None:
    x, y, z = room.size_m
    floor = Material(((0.60, 0.42, 0.25), (0.46, 0.30, 0.17)), partial(textures.planks, width=0.14, length=1.3))
    mesh.quad(np.zeros(3), np.array([x, 0, 0]), np.array([0, y, 0]), floor)
    ceiling = Material(((0.78, 0.78, 0.76),), textures.plaster)
    mesh.quad(np.array([0, y, z]), np.array([x, 0, 0]), np.array([0, -y, 0]), ceiling)
    walls = (
        Material(((0.76, 0.70, 0.56),), textures.plaster),
        Material(((0.66, 0.74, 0.62), (0.57, 0.68, 0.56)), partial(textures.stripes, period=0.2)),
        Material(((0.62, 0.70, 0.76),), textures.plaster),
        Material(((0.78, 0.68, 0.64), (0.68, 0.48, 0.44)), partial(textures.dots, period=0.24, radius=0.035)),
    )
    corners = np.array([[0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0]], float)
    height = np.array([0, 0, z])
    for index, wall in enumerate(walls):
        start, end = corners[index], corners[(index + 1) % 4]
        along = end - start
        mesh.quad(start, along, height, wall)
        if room.furniture:
            length = float(np.linalg.norm(along))
            inward = np.array([-along[1], along[0], 0]) / length
            foot = (start + end) / 2 + 0.0075 * inward
            mesh.box(tuple(foot), (length, 0.015, 0.08), _WHITE, yaw=float(np.arctan2(along[1], along[0])))


def _mirror(mesh: Mesh, room: RoomSpec, mirror: MirrorSpec) -> None:
    """In front of a wall by more than skirting and pictures are thick."""
    axis, far = "xy".index(mirror.wall[0]), mirror.wall[1] == "1"
    width, height = mirror.size_m
    low, along = np.zeros(3), np.zeros(3)
    low[axis] = room.size_m[axis] - 0.03 if far else 0.03
    low[1 - axis], along[1 - axis] = mirror.along_m - width / 2, width
    low[2] = mirror.height_m - height / 2
    mesh.quad(low, along, np.array([0, 0, height]), Material(((0.0, 0.0, 0.0),), mirror=mirror.reflects))


def _openings(mesh: Mesh, room: RoomSpec) -> None:
    """A door in the wall y = 0, a window in the wall x = 0."""
    x, y, _ = room.size_m
    door = framed((0.9, 2.02), ((0.50, 0.30, 0.16), (0.40, 0.23, 0.12), (0.78, 0.76, 0.72)), textures.wood, 0.05)
    at = 0.27 * x
    mesh.box((at, 0.015, 0), (0.9, 0.03, 2.02), _OAK, yaw=np.pi, front=door)
    mesh.sphere((at + 0.33, 0.07, 1.0), 0.03, _BRASS)
    width, height = 1.3, 1.1
    panes = partial(textures.panes, size=(width, height), bar=0.07)
    window = Material(((0.55, 0.72, 0.90), (0.84, 0.84, 0.82)), panes, glow=0.3)
    mesh.box((0.02, 0.62 * y, 0.95), (width, 0.04, height), _WHITE, yaw=np.pi / 2, front=window)
    mesh.box((0.08, 0.62 * y, 0.90), (width + 0.2, 0.16, 0.04), _WHITE, yaw=np.pi / 2)


def _pictures(mesh: Mesh, room: RoomSpec) -> None:
    x, y, _ = room.size_m
    gold, black = (0.70, 0.55, 0.22), (0.10, 0.10, 0.10)
    sizes = ((0.8, 0.6), (0.6, 0.6), (0.7, 0.5), (0.5, 0.7))
    inner = (
        ((0.86, 0.82, 0.70), (0.70, 0.20, 0.14), gold, partial(textures.rings, period=0.12, centre=(0.4, 0.3))),
        ((0.88, 0.88, 0.86), (0.08, 0.10, 0.14), black, partial(textures.checker, size=0.1)),
        ((0.86, 0.74, 0.22), (0.16, 0.28, 0.56), black, partial(textures.stripes, period=0.1)),
        ((0.84, 0.84, 0.80), (0.24, 0.46, 0.40), gold, partial(textures.dots, period=0.14, radius=0.05)),
    )
    places = (
        ((x - 0.012, 0.45 * y, 1.35), -np.pi / 2),
        ((0.66 * x, 0.012, 1.45), np.pi),
        ((0.30 * x, y - 0.012, 1.40), 0.0),
        ((0.012, 0.25 * y, 1.30), np.pi / 2),
    )
    for (width, height), (first, second, frame, pattern), (foot, yaw) in zip(sizes, inner, places, strict=True):
        picture = framed((width, height), (first, second, frame), pattern)
        mesh.box(foot, (width, 0.024, height), Material((frame,)), yaw=yaw, front=picture)


def _sofa(mesh: Mesh, room: RoomSpec) -> None:
    """Against the wall x = X, its front towards the room."""
    x, y, _ = room.size_m
    at = 0.42 * y

    def part(across: float, along: float, z: float, size: tuple[float, float, float], material: Material) -> None:
        mesh.box((x - 0.03 - across, at + along, z), size, material, yaw=-np.pi / 2)

    part(0.42, 0.0, 0.06, (1.7, 0.80, 0.36), _SOFA)
    part(0.12, 0.0, 0.42, (1.7, 0.20, 0.42), _SOFA)
    for side in (-1, 1):
        part(0.42, side * 0.92, 0.06, (0.16, 0.80, 0.56), _SOFA)
        part(0.34, side * 0.55, 0.42, (0.42, 0.16, 0.38), _CUSHION)


def _shelf(mesh: Mesh, room: RoomSpec) -> None:
    """Against the wall y = Y: four boards, two sides, and books."""
    x, y, _ = room.size_m
    middle, width, depth, height = 0.70 * x, 1.1, 0.28, 1.7
    front = y - 0.03 - depth / 2
    for side in (-1, 1):
        mesh.box((middle + side * (width / 2 - 0.015), front, 0), (0.03, depth, height), _OAK)
    levels = np.linspace(0.02, height - 0.03, 5)
    for level in levels:
        mesh.box((middle, front, float(level)), (width, depth, 0.03), _OAK)
    gap = float(levels[1] - levels[0])
    for number, level in enumerate(levels[:-1]):
        spines = partial(textures.books, width=0.035 + 0.006 * number, height=gap, colours=len(_BOOKS))
        length = width - 0.07 - 0.2 * (number % 2)
        mesh.box(
            (middle - 0.1 * (number % 2), front + 0.03, float(level) + 0.03),
            (length, 0.18, 0.75 * gap),
            _DARK,
            front=Material(_BOOKS, spines),
        )


def _table(mesh: Mesh, room: RoomSpec) -> None:
    """In the corner x = 0, y = Y, with two chairs and a vase on it."""
    _, y, _ = room.size_m
    cx, cy, top = 0.62, y - 0.85, 0.74
    cloth = Material(((0.74, 0.70, 0.62), (0.62, 0.28, 0.24)), partial(textures.checker, size=0.09))
    mesh.box((cx, cy, top - 0.03), (0.8, 1.1, 0.03), _OAK, front=None)
    mesh.box((cx, cy, top), (0.5, 0.7, 0.004), cloth)
    for dx in (-0.35, 0.35):
        for dy in (-0.5, 0.5):
            mesh.box((cx + dx, cy + dy, 0), (0.05, 0.05, top - 0.03), _OAK)
    profile = np.array([[0, 0], [0.05, 0], [0.09, 0.08], [0.08, 0.16], [0.04, 0.22], [0.055, 0.26]])
    mesh.lathe(
        (cx, cy + 0.1, top + 0.004),
        profile,
        Material(((0.22, 0.40, 0.62), (0.84, 0.82, 0.76)), partial(textures.bands, period=0.05)),
    )
    _chair(mesh, cx + 0.62, cy - 0.15, np.pi / 2)
    _chair(mesh, cx - 0.05, cy - 0.85, 0.0)


def _chair(mesh: Mesh, x: float, y: float, yaw: float) -> None:
    """A chair whose back stands on its own -y side, turned by `yaw`."""
    c, s = np.cos(yaw), np.sin(yaw)

    def part(dx: float, dy: float, z: float, size: tuple[float, float, float]) -> None:
        mesh.box((x + c * dx - s * dy, y + s * dx + c * dy, z), size, _CHAIR, yaw=yaw)

    part(0.0, 0.0, 0.43, (0.42, 0.42, 0.035))
    for dx in (-0.18, 0.18):
        part(dx, 0.18, 0.0, (0.035, 0.035, 0.43))
        part(dx, -0.19, 0.0, (0.035, 0.035, 0.92))
    for z in (0.58, 0.72, 0.86):
        part(0.0, -0.19, z, (0.36, 0.02, 0.06))


_CHAIR = Material(((0.58, 0.22, 0.16), (0.50, 0.18, 0.13)), textures.wood)


def _small_things(mesh: Mesh, room: RoomSpec) -> None:
    """A rug, a floor lamp, a plant, a ball, and a low chest of drawers."""
    x, y, _ = room.size_m
    colours = (0.62, 0.20, 0.18), (0.76, 0.64, 0.42), (0.22, 0.24, 0.36)
    rug = framed((1.8, 1.3), colours, partial(textures.dots, period=0.26, radius=0.09), 0.1)
    mesh.quad(np.array([0.5 * x - 0.9, 0.36 * y - 0.65, 0.008]), np.array([1.8, 0, 0]), np.array([0, 1.3, 0]), rug)
    shade = Material(((0.84, 0.76, 0.56),), glow=0.25)
    mesh.cylinder((x - 0.32, y - 0.9, 0), 0.14, 0.025, _DARK)
    mesh.cylinder((x - 0.32, y - 0.9, 0.025), 0.014, 1.45, _BRASS)
    mesh.sphere((x - 0.32, y - 0.9, 1.58), 0.16, shade)
    mesh.lathe((x - 0.35, 0.38, 0), np.array([[0, 0], [0.12, 0], [0.17, 0.32], [0.15, 0.32], [0, 0.28]]), _POT)
    leaves = (0, 0, 0.62, 0.20), (-0.10, 0.08, 0.85, 0.16), (0.08, 0.02, 0.98, 0.14), (-0.02, -0.06, 1.14, 0.10)
    for dx, dy, z, radius in leaves:
        mesh.sphere((x - 0.35 + dx, 0.38 + dy, z), radius, _LEAF)
    mesh.sphere((0.55, 0.30 * y + 0.75, 0.13), 0.13, _BALL)
    colours = (0.70, 0.68, 0.62), (0.40, 0.38, 0.34), (0.56, 0.54, 0.48)
    drawers = framed((0.9, 0.7), colours, partial(textures.tiles, size=0.23), 0.03)
    mesh.box((0.25, 0.25 * y, 0), (0.9, 0.42, 0.7), Material(((0.60, 0.58, 0.52),)), yaw=np.pi / 2, front=drawers)


def set_table(spec: ObjectSpec, *, empty: bool = False) -> Mesh:
    """A vase, a block and a ball on the turntable's plate, or the plate alone; scanner coordinates."""
    mesh = Mesh()
    z, h = spec.base_z_m, spec.height_m
    plate = Material(((0.34, 0.34, 0.36), (0.46, 0.46, 0.48)), partial(textures.rings, period=0.04, centre=(0.0, 0.0)))
    r = spec.plate_radius_m
    mesh.cylinder((0, 0, z - 0.02), r, 0.02, plate)
    if empty:
        return mesh
    radius = [0, 0.20, 0.30, 0.36, 0.33, 0.20, 0.14, 0.18, 0.24, 0]
    outline = np.column_stack([radius, [0, 0, 0.12, 0.30, 0.48, 0.66, 0.80, 0.93, 1.0, 0.97]])
    vase = Material(((0.22, 0.42, 0.60), (0.80, 0.76, 0.66)), partial(textures.bands, period=0.22 * h))
    mesh.lathe((0.0, 0.0, z), h * outline, vase, sides=96)
    block = Material(((0.78, 0.58, 0.22), (0.56, 0.20, 0.16)), partial(textures.checker, size=0.1 * h))
    mesh.box((0.62 * r, 0.1 * r, z), (0.3 * h, 0.3 * h, 0.35 * h), block, yaw=0.4)
    mesh.sphere((-0.55 * r, 0.45 * r, z + 0.15 * h), 0.15 * h, Material(((0.70, 0.72, 0.66),)))
    return mesh
