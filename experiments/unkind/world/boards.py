"""ChArUco boards, where they are shown to the camera, and the contrast of their print under the stripe."""

from typing import NamedTuple

import cv2
import numpy as np

from experiments.unkind.world.rig import Rig, project, rigid, rotation
from experiments.unkind.world.room import Patch


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
