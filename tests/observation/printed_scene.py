"""A printed board under a sheet of laser light, seen through a lens: written apart from the package, to test it.

Every pixel is the mean of 4 x 4 points; print, room light and laser light are multiplied on the board, before the lens.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates


FINE = 4
SIZE, FOCAL = (400, 320), 430.0
READ_DN, ELECTRONS_PER_DN, BLACK_DN = 1.7, 8.0, 5.0
PER_SQUARE = 168
INK, INK_IN_LASER = 0.08, 0.15


class Seen(NamedTuple):
    """One record, and the truth."""

    on: np.ndarray
    off: np.ndarray
    u: np.ndarray
    """True centre of the stripe on every row [rows], px."""
    pose: np.ndarray
    """T_cam_board [4, 4]."""
    inside: np.ndarray
    """bool [rows]: the stripe is on the print, clear of its rim."""
    clean: np.ndarray
    """The laser's light on every pixel without noise [rows, columns], DN."""
    room: np.ndarray
    """The room's light on every pixel without noise [rows, columns], DN."""


def markers(columns, rows, marker, dictionary=cv2.aruco.DICT_4X4_50):
    """Picture of a ChArUco board by OpenCV, 0 ink, 1 paper."""
    board = cv2.aruco.CharucoBoard((columns, rows), 1.0, marker, cv2.aruco.getPredefinedDictionary(dictionary))
    return board.generateImage((columns * PER_SQUARE, rows * PER_SQUARE), marginSize=0, borderBits=1) / 255.0


def squares(columns, rows):
    """Picture of a chessboard's squares, the first one ink."""
    return np.kron(np.add.outer(np.arange(rows), np.arange(columns)) % 2, np.ones((PER_SQUARE, PER_SQUARE)))


def look(
    picture, square, seed, *, lens_px=0.75, speckle=0.05, laser_dn=150.0, room_dn=35.0, low=(0.0, 0.0), noisy=True
):
    """Render a board in a random pose, about 0.9 m away.

    Args:
        picture: Of the print, which begins at board coordinates `low`; white around it.
        square: Side of a square [m].
        seed: Of pose and noise.
    """
    random, (width, height) = np.random.default_rng(seed), SIZE
    middle = np.array([low[0], low[1], 0.0])
    middle[:2] += np.array(picture.shape[::-1]) / PER_SQUARE * square / 2
    turn = cv2.Rodrigues(random.uniform(-0.4, 0.4, 3))[0]
    shift = np.array([*random.uniform(-0.04, 0.04, 2), 0.9]) - turn @ middle
    at = lambda count: (np.arange(count * FINE) + 0.5) / FINE - 0.5
    x = (at(width) - (width - 1) / 2)[None] / FOCAL
    y = (at(height) - (height - 1) / 2)[:, None] / FOCAL
    normal = turn[:, 2]
    depth = (normal @ shift) / (normal[0] * x + normal[1] * y + normal[2])
    p = np.stack([x * depth - shift[0], y * depth - shift[1], depth - shift[2]], -1)
    cell = lambda k: (p @ turn[:, k] - low[k]) / square * PER_SQUARE - 0.5
    paper = map_coordinates(picture, [cell(1), cell(0)], order=1, mode="constant", cval=1.0)
    sheet = np.array([0.98, 0.02, 0.2]) / np.linalg.norm([0.98, 0.02, 0.2])
    distance = sheet @ np.array([random.uniform(-0.04, 0.04), 0.0, 0.9])
    beside = (sheet[0] * x + sheet[1] * y + sheet[2]) * depth - distance
    thickness = 1.05 * FINE * np.median(np.abs(np.diff(beside, axis=1)))
    light = laser_dn * np.exp(-0.5 * np.square(beside / thickness)) * (INK_IN_LASER + (1 - INK_IN_LASER) * paper)
    light = gaussian_filter(light, lens_px * FINE)
    room = gaussian_filter(room_dn * (1 + 0.1 * x - 0.2 * y) * (INK + (1 - INK) * paper), lens_px * FINE)
    pixels = lambda fine: fine.reshape(height, FINE, width, FINE).mean((1, 3))
    clean, room = pixels(light), pixels(room)
    if noisy:
        grains = np.kron(random.normal(size=(2 * height, 2 * width)), np.ones((FINE // 2, FINE // 2)))
        light = light * (1.0 + 2.0 * speckle * grains)

    def sense(light):
        noise = np.sqrt(np.maximum(light, 0.0) / ELECTRONS_PER_DN + READ_DN**2) * random.normal(size=light.shape)
        return np.clip(np.rint(BLACK_DN + light + noisy * noise), 0, 255).astype(np.uint8)

    off, on = sense(room), sense(room + pixels(light))
    # On the board the sheet is a straight line, and in a pinhole's image too.
    line = sheet * (normal @ shift) - distance * normal
    rows = (np.arange(height) - (height - 1) / 2) / FOCAL
    u = -(line[1] * rows + line[2]) / line[0]
    z = (normal @ shift) / (normal[0] * u + normal[1] * rows + normal[2])
    place = (np.stack([u * z, rows * z, z], -1) - shift) @ turn[:, :2]
    low, high = np.array(low) + 0.1 * square, np.array(low) + np.array(picture.shape[::-1]) / PER_SQUARE * square
    u = u * FOCAL + (width - 1) / 2
    inside = np.all((place > low) & (place < high - 0.1 * square), 1) & (u > 16) & (u < width - 17)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    return Seen(on, off, u, pose, inside, clean, room)
