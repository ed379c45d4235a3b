"""Draws parts of the mount: `python hardware/mount/picture.py hardware/mount/build/whole.stl -o mount.png`."""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure


LIGHT = np.array([-0.25, -0.55, 0.8])
COLOUR = np.array([0.40, 0.60, 0.76])
PAPER = np.array([1.0, 1.0, 1.0])
FINENESS = 5.0
"""Pixels for a millimetre, before the picture is drawn smaller."""


def triangles(path: Path) -> np.ndarray:
    """Corners [triangles, 3, 3], mm, of an STL in letters, as OpenSCAD writes it."""
    rows = [line.split()[1:] for line in path.read_text().splitlines() if line.strip().startswith("vertex")]
    return np.array(rows, float).reshape(-1, 3, 3)


def seen(part: np.ndarray, turn_deg: float = 28.0, lift_deg: float = 30.0) -> np.ndarray:
    """The part seen from behind, turned and from above, as an RGB image: every pixel shows the nearest face."""
    turn, lift = np.deg2rad([turn_deg, lift_deg])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    away = np.array([-np.sin(turn) * np.cos(lift), np.cos(turn) * np.cos(lift), -np.sin(lift)])
    up = np.cross(right, away)
    flat = part @ np.stack([right, up, away], axis=1)
    flat[..., :2] = FINENESS * (flat[..., :2] - flat[..., :2].min(axis=(0, 1))) + 2
    columns, rows = (int(np.ceil(flat[..., k].max())) + 3 for k in (0, 1))
    image, depth = np.broadcast_to(PAPER, (rows, columns, 3)).copy(), np.full((rows, columns), np.inf)
    normal = np.cross(part[:, 1] - part[:, 0], part[:, 2] - part[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    bright = 0.5 + 0.5 * np.clip(normal @ (LIGHT / np.linalg.norm(LIGHT)), -0.5, 1)
    for corners, light in zip(flat, bright, strict=True):
        _fill(image, depth, corners, np.clip(1.25 * light * COLOUR, 0, 1))
    return image[::-1]


def _fill(image: np.ndarray, depth: np.ndarray, corners: np.ndarray, colour: np.ndarray) -> None:
    low, high = np.floor(corners[:, :2].min(0)).astype(int), np.ceil(corners[:, :2].max(0)).astype(int)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners
    area = (by - cy) * (ax - cx) + (cx - bx) * (ay - cy)
    if abs(area) < 1e-9:
        return
    a = ((by - cy) * (x - cx) + (cx - bx) * (y - cy)) / area
    b = ((cy - ay) * (x - cx) + (ax - cx) * (y - cy)) / area
    inside = (a >= -1e-9) & (b >= -1e-9) & (a + b <= 1 + 1e-9)
    z = a * az + b * bz + (1 - a - b) * cz
    there = (slice(low[1], high[1] + 1), slice(low[0], high[0] + 1))
    nearer = inside & (z < depth[there])
    depth[there][nearer] = z[nearer]
    image[there][nearer] = colour


def draw(paths: list[Path], output: Path) -> None:
    """The parts side by side, all to the same scale."""
    parts = [triangles(path) for path in paths]
    images = [seen(part) for part in parts]
    rows = max(image.shape[0] for image in images)
    figure = Figure(figsize=(10.5, 4.3), layout="constrained")
    grid = figure.add_gridspec(1, len(parts), width_ratios=[image.shape[1] for image in images])
    for column, (path, part, image) in enumerate(zip(paths, parts, images, strict=True)):
        axes = figure.add_subplot(grid[column])
        above = np.broadcast_to(PAPER, (rows - image.shape[0], image.shape[1], 3))
        axes.imshow(np.concatenate([above, image]), interpolation="antialiased")
        axes.set_axis_off()
        x, y, z = np.ptp(part.reshape(-1, 3), axis=0)
        axes.set_title(f"{path.stem}\n{x:.0f} x {y:.0f} x {z:.0f} mm", fontsize=10)
    figure.savefig(output, dpi=100)


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("stl", nargs="+", type=Path)
    words.add_argument("-o", "--output", type=Path, required=True)
    given = words.parse_args()
    draw(given.stl, given.output)
