"""What a seed draws for the path tracer: the rig, a furnished room, a board and its poses, and the sensor."""

from typing import NamedTuple

import cv2
import numpy as np
from scipy import fft  # type: ignore[import-untyped]
from scipy.ndimage import gaussian_filter  # type: ignore[import-untyped]


class Rig(NamedTuple):
    """A camera, a sheet of laser light, and the axis of the table under them, in the camera's frame at angle 0."""

    width: int
    height: int
    lens: np.ndarray
    """fx, fy, cx, cy [px], k1, k2, p1, p2 [1]."""
    source: np.ndarray
    """Where the sheet comes from [3], m."""
    normal: np.ndarray
    distance: float
    """The sheet: normal . p = distance."""
    direction: np.ndarray
    point: np.ndarray
    """The axis: its upward direction, and its point nearest the camera [m]."""
    gain: float
    harmonics: np.ndarray
    """c1, s1, c2, s2 [rad]."""

    def theta(self, phi: float) -> float:
        """Turned angle [rad] at the table's own angle [rad]."""
        c1, s1, c2, s2 = self.harmonics
        once = c1 * (np.cos(phi) - 1) + s1 * np.sin(phi)
        return float(self.gain * phi + once + c2 * (np.cos(2 * phi) - 1) + s2 * np.sin(2 * phi))

    def pose(self, phi: float) -> np.ndarray:
        """T_cam0_cam [4, 4] at the table's own angle [rad]."""
        turn = rotation(self.direction, self.theta(phi))
        return rigid(turn, self.point - turn @ self.point)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Turn [3, 3] about an axis by an angle [rad] (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def rigid(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A motion [4, 4] from a turn [3, 3] and a shift [3]."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, shift
    return motion


def project(lens: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels [..., 2] of points [..., 3] in the camera's frame."""
    fx, fy, cx, cy = lens[:4]
    x, y = _bend(lens, points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
    return np.stack([fx * x + cx, fy * y + cy], -1)


def look(lens: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Directions [..., 3] with z = 1 of pixels, the lens's bend undone by a fixed point, to 1e-9."""
    fx, fy, cx, cy = lens[:4]
    seen_x, seen_y = (np.asarray(u, np.float64) - cx) / fx, (np.asarray(v, np.float64) - cy) / fy
    x, y = seen_x, seen_y
    for _ in range(9):
        bent_x, bent_y = _bend(lens, x, y)
        x, y = x + (seen_x - bent_x), y + (seen_y - bent_y)
    return np.stack([x, y, np.ones_like(x)], -1)


def _bend(lens: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, p1, p2 = lens[4:]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    return (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)


def draw_rig(rng: np.random.Generator) -> Rig:
    """A rig like that of a careful hobbyist: 400 to 480 px wide, sheet from 0.34 to 0.42 m beside the camera."""
    width = int(rng.choice([400, 432, 464, 480]))
    height = width * 3 // 4
    f = 0.9 * width * rng.uniform(0.97, 1.03)
    middle = np.array([width - 1, height - 1]) / 2 + rng.uniform(-4, 4, 2)
    bend = np.array([rng.uniform(-0.09, -0.04), rng.uniform(0.0, 0.03), *rng.uniform(-6e-4, 6e-4, 2)])
    lens = np.array([f, f * rng.uniform(0.998, 1.002), *middle, *bend])
    side = rng.choice([-1.0, 1.0])
    source = np.array([side * rng.uniform(0.34, 0.42), rng.uniform(-0.02, 0.02), rng.uniform(-0.03, 0.03)])
    crossing = np.array([0.0, 0.0, rng.uniform(1.9, 2.3)])
    upright = np.array([rng.uniform(-0.03, 0.03), 1.0, rng.uniform(-0.02, 0.02)])
    normal = np.cross(crossing - source, upright)
    normal /= np.linalg.norm(normal)
    normal *= np.sign(normal @ source)
    direction = np.array([rng.uniform(-0.015, 0.015), -1.0, rng.uniform(-0.015, 0.015)])
    direction /= np.linalg.norm(direction)
    point = np.array([rng.uniform(-0.12, 0.12), 0.0, rng.uniform(-0.12, -0.04)])
    return Rig(
        width,
        height,
        lens,
        source,
        normal,
        float(normal @ source),
        direction,
        point - direction * (direction @ point),
        1 + 2e-4 * float(rng.standard_normal()),
        1.5e-4 * rng.standard_normal(4),
    )


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


TEXELS = 60
"""Texels per square of the print."""
INK, PAPER = 0.05, 0.8
MARGIN_M = 0.015
FREE, PLACEMENTS, ANGLES = 16, 2, 6


class Board(NamedTuple):
    """A printed board, flat, with a white margin around it."""

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str
    paint: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Width and height of the print [m]."""
        return self.square_m * np.array([self.columns, self.rows])

    def patch(self, room_board: np.ndarray) -> Patch:
        """The board as a surface of the room, by T_room_board [4, 4]; x right, y down, z into the board."""
        width, height = self.size + 2 * MARGIN_M
        corner = room_board @ np.array([-MARGIN_M, height - MARGIN_M, 0.0, 1.0])
        along, up = room_board[:3, 0] * width, -room_board[:3, 1] * height
        return Patch("board", corner[:3], along, up, self.paint)

    def header(self) -> dict[str, object]:
        """The board as captures name it."""
        lengths = {"square_mm": round(1000 * self.square_m, 3), "marker_mm": round(1000 * self.marker_m, 3)}
        return {"type": "charuco", "columns": self.columns, "rows": self.rows, "dictionary": self.dictionary, **lengths}


class View(NamedTuple):
    """A board in a place, and the table's own angle [rad]."""

    room_board: np.ndarray
    phi: float
    placement: int | None


def draw_board(rng: np.random.Generator) -> Board:
    """A board of 8 to 12 columns, 0.8 to 0.9 m wide."""
    columns = int(rng.integers(8, 13))
    rows = max(5, round(0.66 * columns))
    square = round(rng.uniform(0.8, 0.9) / columns, 4)
    marker = round(0.78 * square, 4)
    name = "DICT_4X4_250"
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    drawn = cv2.aruco.CharucoBoard((columns, rows), square, marker, dictionary)
    print_ = drawn.generateImage((columns * TEXELS, rows * TEXELS), marginSize=0, borderBits=1)
    edge = round(MARGIN_M / square * TEXELS)
    # The first row of a picture is its upper one; the paint's first row lies at the patch's lower edge.
    whole = np.pad(print_, edge, constant_values=255)[::-1] / 255.0
    return Board(columns, rows, square, marker, name, (INK + (PAPER - INK) * whole).astype(np.float32))


def draw_views(rig: Rig, board: Board, room_camera: np.ndarray, rng: np.random.Generator) -> list[View]:
    """Free views at angle 0, then placements seen at several angles; the stripe crosses most of them."""
    views = []
    for k in range(FREE):
        views.append(View(room_camera @ _draw(rig, board, rng, 0.8 + 0.9 * (k + 0.5) / FREE), 0.0, None))
    for number in range(PLACEMENTS):
        place = room_camera @ _draw(rig, board, rng, rng.uniform(1.1, 1.35), mild=True)
        angles = [phi for phi in np.radians(np.linspace(-30, 30, 121)) if _inside(rig, board, room_camera, place, phi)]
        chosen = np.linspace(angles[0], angles[-1], ANGLES)
        views += [View(place, float(np.round(phi, 4)), number) for phi in chosen]
    return views


def _inside(rig: Rig, board: Board, room_camera: np.ndarray, room_board: np.ndarray, phi: float) -> bool:
    pose = np.linalg.inv(room_camera @ rig.pose(phi)) @ room_board
    return _visible(rig, board, pose) > 0.75


def _visible(rig: Rig, board: Board, pose: np.ndarray) -> float:
    """Part of a grid on the board that is in the image."""
    x, y = np.meshgrid(*(np.linspace(0, side, 7) for side in board.size))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1) @ pose[:3, :3].T + pose[:3, 3]
    q = project(rig.lens, points)
    inside = (q > 5).all(1) & (q < np.array([rig.width, rig.height]) - 6).all(1)
    return float((inside & (points[:, 2] > 0.3)).mean())


def _draw(rig: Rig, board: Board, rng: np.random.Generator, far: float, mild: bool = False) -> np.ndarray:
    """T_cam_board at angle 0, tilted by 15 to 45 degrees (10 to 20 if `mild`), the stripe on its middle part."""
    while True:
        tilt = np.radians(rng.uniform(10, 20) if mild else rng.uniform(15, 45))
        way = rng.uniform(0, 2 * np.pi)
        turn = rotation(np.array([np.cos(way), np.sin(way), 0]), tilt)
        turn = turn @ rotation(np.array([0.0, 0.0, 1.0]), np.radians(rng.uniform(-20, 20)))
        y, z = rng.uniform(-0.18, 0.18) * far, far
        x = (rig.distance - rig.normal[1] * y - rig.normal[2] * z) / rig.normal[0]
        on = board.size * np.array([rng.uniform(0.2, 0.8), rng.uniform(0.35, 0.65)])
        pose = rigid(turn, np.array([x, y, z]) - turn @ np.array([*on, 0.0]))
        if _visible(rig, board, pose) > 0.75:
            return pose


FINE = 4
"""Samples per pixel, in both directions, of the grid on which speckle is drawn."""


class Sensor(NamedTuple):
    """A camera's chip and lens."""

    electrons_per_dn: float = 8.0
    read_dn: float = 1.7
    black_dn: float = 5.0
    blur_px: tuple[float, float] = (0.7, 0.9)
    """Standard deviation of the lens's blur in the middle and in the corners of the image [px]."""
    speckle: float = 0.05
    """Standard deviation over mean of the laser's light on one pixel."""
    pixel_um: float = 3.45
    f_number: float = 4.0
    wavelength_um: float = 0.65

    @property
    def grain_px(self) -> float:
        """Width of a grain of speckle, wavelength times f-number [px]."""
        return self.wavelength_um * self.f_number / self.pixel_um


def blurred(image: np.ndarray, sensor: Sensor, per_pixel: int, part: tuple[slice, int] | None = None) -> np.ndarray:
    """The image behind the lens; it has `per_pixel` samples per pixel in both directions.

    `part` says which columns of pixels it holds, and of how many.
    """
    columns, width = part or (slice(0, image.shape[1] // per_pixel), image.shape[1] // per_pixel)
    x = np.linspace(-1, 1, per_pixel * width)[None, per_pixel * columns.start : per_pixel * columns.stop]
    outer = ((x**2 + np.linspace(-1, 1, len(image))[:, None] ** 2) / 2).astype(np.float32)
    inside, outside = (
        gaussian_filter(image, per_pixel * sigma, mode="nearest", truncate=5.0) for sigma in sensor.blur_px
    )
    return (1 - outer) * inside + outer * outside


class Speckle:
    """Fields of speckle with mean 1, from which every record gets a piece of its own.

    The light on the sensor is the squared magnitude of a circular Gaussian field behind a round aperture. One field has
    a contrast of 1; where a pixel shows less, many independent fields lie on top of one another (wavelengths,
    polarisations, a moving diffuser): their mean has the same grain and a smaller contrast.
    """

    def __init__(self, sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> None:
        """Fields of `shape` [rows, columns] pixels, `FINE` samples each."""
        self.rng = rng
        rows, columns = (fft.next_fast_len(FINE * n) for n in shape)
        fy, fx = np.meshgrid(fft.fftfreq(rows), fft.fftfreq(columns), indexing="ij")
        # The aperture passes frequencies of the field below 1 / (2 grain); grain in samples.
        aperture = np.hypot(fx, fy) < 0.5 / (FINE * sensor.grain_px)
        self.fields = []
        for _ in range(3):
            light = np.zeros((rows, columns), np.float32)
            for _ in range(4):
                noise = rng.standard_normal((2, rows, columns)).astype(np.float32)
                field = fft.ifft2(fft.fft2(noise[0] + 1j * noise[1], workers=2) * aperture, workers=2)
                light += np.abs(field).astype(np.float32) ** 2
            light /= light.mean()
            blocks = light[: rows // FINE * FINE, : columns // FINE * FINE]
            pixels = blocks.reshape(rows // FINE, FINE, columns // FINE, FINE).mean((1, 3))
            light = 1 + (light - 1) * np.float32(sensor.speckle / pixels.std())
            self.fields.append(np.maximum(light, 0.0))

    def draw(self, shape: tuple[int, int]) -> np.ndarray:
        """A piece [rows, columns] of samples, from a random place of a random field."""
        field = self.fields[self.rng.integers(len(self.fields))]
        flipped = field[:: self.rng.choice([-1, 1]), :: self.rng.choice([-1, 1])]
        rows, columns = (
            (int(self.rng.integers(n)) + np.arange(m)) % n for n, m in zip(field.shape, shape, strict=True)
        )
        return flipped[np.ix_(rows, columns)]


def to_pixels(image: np.ndarray, per_pixel: int) -> np.ndarray:
    """Means over pixels of an image with `per_pixel` samples per pixel."""
    rows, columns = (n // per_pixel for n in image.shape)
    return image.reshape(rows, per_pixel, columns, per_pixel).mean((1, 3))


def expose(light: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """A frame, uint8, of the light on every pixel [DN]."""
    electrons = rng.poisson(np.maximum(light, 0.0) * sensor.electrons_per_dn)
    level = electrons / sensor.electrons_per_dn + sensor.black_dn + sensor.read_dn * rng.standard_normal(light.shape)
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)
