"""Pictures of printed boards through a camera with a distorted lens, without the simulator's code."""

import functools

import cv2
import numpy as np


SIZE = (640, 480)
CAMERA = np.array([[560.0, 0.0, 322.0], [0.0, 558.0, 236.5], [0.0, 0.0, 1.0]])
LENS = np.array([-0.18, 0.05, 0.001, -0.0008, 0.0])
OVERSAMPLING, BLUR_PX, NOISE_DN = 4, 0.8, 1.5


def pose(tilt_deg, axis_deg, roll_deg, depth_m, board, shift=(0.0, 0.0)):
    """T_cam_board: the board's middle at a depth, tilted about a direction in its plane."""
    axis = np.radians(axis_deg)
    tilt, _ = cv2.Rodrigues(np.radians(tilt_deg) * np.array([np.cos(axis), np.sin(axis), 0.0]))
    roll, _ = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(roll_deg)]))
    turn = tilt @ roll
    middle = np.append(board.outline().mean(0), 0.0)
    return turn, np.array([*shift, depth_m]) - turn @ middle


def seen_at(board, motion):
    """True pixels of the corners."""
    turn, place = motion
    q, _ = cv2.projectPoints(board.corners(), cv2.Rodrigues(turn)[0], place, CAMERA, LENS)
    return q.reshape(-1, 2)


def inside(board, motion, margin=12):
    """Whether the printed area lies in the image."""
    turn, place = motion
    corners = np.column_stack([board.outline(), np.zeros(4)])
    q, _ = cv2.projectPoints(corners, cv2.Rodrigues(turn)[0], place, CAMERA, LENS)
    q = q.reshape(-1, 2)
    return bool(((q > margin) & (q < np.array(SIZE) - 1 - margin)).all())


def picture(board, texture, pixels_per_square, motion, seed=0):
    """uint8 [rows, columns]: every pixel is the mean of many rays, blurred, with noise; all round is white."""
    turn, place = motion
    texture = np.pad(texture, pixels_per_square, constant_values=255).astype(np.float32)
    low = board.outline().min(0) - board.square
    # The plane z = 0 of the board.
    to_board = np.linalg.inv(np.column_stack([turn[:, :2], place]))
    ray_x, ray_y = rays()
    x, y, w = (a * ray_x + b * ray_y + c for a, b, c in to_board)
    scale = pixels_per_square / board.square
    column = np.clip(np.rint((x / w - low[0]) * scale - 0.5), 0, texture.shape[1] - 1).astype(int)
    row = np.clip(np.rint((y / w - low[1]) * scale - 0.5), 0, texture.shape[0] - 1).astype(int)
    fine = texture[row, column].reshape(SIZE[1], OVERSAMPLING, SIZE[0], OVERSAMPLING).mean((1, 3))
    # Light falls off to one side.
    light = 0.75 + 0.25 * np.linspace(0, 1, SIZE[0])[None]
    image = cv2.GaussianBlur(light * (25 + 0.75 * fine), (0, 0), BLUR_PX)
    image = image + NOISE_DN * np.random.default_rng(seed).normal(size=image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@functools.cache
def rays():
    """Normalised coordinates of all rays [2, n]."""
    step = (np.arange(OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    u = (np.arange(SIZE[0])[:, None] + step).ravel()
    v = (np.arange(SIZE[1])[:, None] + step).ravel()
    return undistorted(np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)).T.copy()


def undistorted(q):
    """Normalised coordinates of pixels: the lens inverted by fixed-point iteration to 1e-7."""
    target = (q - CAMERA[:2, 2]) / CAMERA[[0, 1], [0, 1]]
    k1, k2, p1, p2, k3 = LENS
    xy = target.copy()
    for _ in range(14):
        x, y = xy.T
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1)
        xy = (target - shift) / radial[:, None]
    return xy
