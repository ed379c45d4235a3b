"""Small pieces of an image compared with the pieces in which their features began: places to hundredths of a pixel."""

from typing import NamedTuple

import cv2
import numpy as np

from jaxscan.recalibration.tracks import Cylinder


HALF = 9
"""Half side of a piece [px]."""
MARGIN = 4
"""Pixels around a piece that interpolation and steps need."""
_STEPS = 6
_DONE_PX = 2e-3
_FARTHEST_PX = 2.0
_GAIN = (0.6, 1.6)
_BENT, _NOISE_DN = 0.05, 2.0
"""Gradient of the shift over a piece that is usual [1], and noise of an image, to weigh it."""


class Patches(NamedTuple):
    """Pieces of images around features."""

    level: np.ndarray
    """Grey levels less their mean [n, side, side]."""
    solver: np.ndarray
    """Weighted pseudo-inverse [n, 8, side * side]: grey levels to shift (x, y), gain, offset, and the gradient of the
    shift over the piece, which a wall seen obliquely has."""
    columns: np.ndarray
    """Changes of the grey levels by these eight [n, 8, side * side]."""
    spread: np.ndarray
    """Variance of x and of y [n, 2] for noise of one grey level in every pixel."""


class Matched(NamedTuple):
    """Where pieces are in another image."""

    x: np.ndarray
    """[n, 2], px."""
    sigma: np.ndarray
    """Standard deviation of a coordinate by the differences that are left [px]."""
    difference: np.ndarray
    """What is left, over the piece's own contrast [1]."""
    valid: np.ndarray


class Unrolled(NamedTuple):
    """An image, sampled at places of the unrolled one."""

    level: np.ndarray
    across: np.ndarray
    """Second differences along the rows, and `down` along the columns: with these, linear interpolation is as good as
    cubic, which OpenCV shifts by up to 0.05 px."""
    down: np.ndarray
    cylinder: Cylinder

    @staticmethod
    def of(image: np.ndarray, cylinder: Cylinder) -> "Unrolled":
        """An image, uint8 [rows, columns]."""
        second = np.array([[1.0, -2.0, 1.0]], np.float32)
        across, down = cv2.filter2D(image, cv2.CV_32F, second), cv2.filter2D(image, cv2.CV_32F, second.T)
        return Unrolled(image.astype(np.float32), across, down, cylinder)

    def pieces(self, x: np.ndarray, reach: int) -> np.ndarray:
        """Pieces [n, 2 reach + 1, 2 reach + 1] around whole places [n, 2], `reach` from the border at least."""
        r = np.arange(-reach, reach + 1)
        if not len(x):
            return np.zeros((0, len(r), len(r)), np.float32)
        row, column = x[:, 1, None, None] + r[:, None], x[:, 0, None, None] + r
        side = len(r)
        u = self.cylinder.u[row, column].astype(np.float32).reshape(-1, side)
        v = self.cylinder.v[row, column].astype(np.float32).reshape(-1, side)
        level, across, down = (
            np.asarray(cv2.remap(part, u, v, cv2.INTER_LINEAR), np.float32)
            for part in (self.level, self.across, self.down)
        )
        a, b = u - np.floor(u), v - np.floor(v)
        out = level - 0.5 * (a * (1 - a) * across + b * (1 - b) * down)
        return out.reshape(-1, side, side)


def make_patches(image: Unrolled, x: np.ndarray) -> Patches:
    """The pieces around features at whole places [n, 2]."""
    wide = image.pieces(x, HALF + 1)
    level = wide[:, 1:-1, 1:-1]
    level = level - level.mean((1, 2), keepdims=True)
    gx, gy = (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]) / 2, (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]) / 2
    n, r = len(x), np.arange(-HALF, HALF + 1, dtype=np.float32)
    along, down = np.broadcast_to(r, gx.shape), np.broadcast_to(r[:, None], gx.shape)
    bent = [gx * along, gx * down, gy * along, gy * down]
    columns = np.stack([gx, gy, level, np.ones_like(level), *bent], 1).reshape(n, 8, (2 * HALF + 1) ** 2)
    weighted = columns * _window().ravel()
    normal = weighted @ columns.transpose(0, 2, 1)
    normal += 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(8, dtype=np.float32)
    normal[:, range(4, 8), range(4, 8)] += (_NOISE_DN / _BENT) ** 2
    solver = np.linalg.solve(normal, weighted)
    return Patches(level, solver, columns, (solver[:, :2] ** 2).sum(2))


def take(patches: Patches, index: np.ndarray) -> Patches:
    """The pieces at `index`."""
    return Patches(*(field[index] for field in patches))


def joined(parts: list[Patches]) -> Patches:
    """All pieces."""
    return Patches(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def match(patches: Patches, image: Unrolled, guess: np.ndarray) -> Matched:
    """Find pieces near guessed places, by least squares with gain and offset of the light.

    The steps are those of inverse compositional alignment; the image is interpolated by cubic convolution.

    Source: Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56 (2004), section 3.
    """
    reach = HALF + MARGIN
    rows, columns = image.cylinder.u.shape
    whole = np.rint(guess).astype(int)
    inside = (whole >= reach).all(1) & (whole[:, 0] < columns - reach) & (whole[:, 1] < rows - reach)
    whole = np.where(inside[:, None], whole, reach)
    pieces = image.pieces(whole, reach)
    shift = np.where(inside[:, None], guess - whole, 0.0)
    step, left = np.zeros((len(guess), 8), np.float32), pieces[:, :1, :1]
    for _ in range(_STEPS):
        shift = np.clip(shift, -_FARTHEST_PX, _FARTHEST_PX)
        left = (_interpolate(pieces, shift) - patches.level).reshape(len(guess), -1)
        step = (patches.solver @ left[..., None])[..., 0]
        shift = shift - step[:, :2]
        if np.abs(step[:, :2]).max(initial=0.0) < _DONE_PX:
            break
    n = len(guess)
    left = left - (step[:, None] @ patches.columns)[:, 0]
    weight = _window().ravel()
    error = np.sqrt((left**2 @ weight) / weight.sum())
    contrast = np.sqrt(((patches.level.reshape(n, -1)) ** 2 @ weight) / weight.sum())
    gain = 1.0 + step[:, 2]
    valid = inside & (np.abs(shift) < _FARTHEST_PX).all(1) & (np.abs(step[:, :2]).max(1) < 10 * _DONE_PX)
    valid &= (gain > _GAIN[0]) & (gain < _GAIN[1])
    # Half of the differences' variance is that of the piece itself, which all its sightings share.
    sigma = np.sqrt(0.5 * patches.spread.mean(1)) * error / np.maximum(gain, _GAIN[0])
    return Matched(whole + shift, sigma, error / np.maximum(contrast, 1e-6), valid)


def _interpolate(pieces: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Pieces moved by less than `MARGIN` - 1 pixels, and reduced by `MARGIN` on all sides."""
    whole = np.floor(shift).astype(int)
    weights = _cubic((shift - whole).astype(np.float32))
    side = 2 * HALF + 1
    taps = np.arange(-1, 3)
    n = np.arange(len(pieces))[:, None, None]
    offset = np.arange(side) + MARGIN
    columns = offset[None, None, :] + whole[:, 0, None, None]
    across = np.zeros((len(pieces), pieces.shape[1], side), np.float32)
    every = np.arange(pieces.shape[1])[None, :, None]
    for tap in range(4):
        across += weights[:, 0, tap, None, None] * pieces[n, every, columns + taps[tap]]
    rows = offset[None, :, None] + whole[:, 1, None, None]
    out = np.zeros((len(pieces), side, side), np.float32)
    all_columns = np.arange(side)[None, None, :]
    for tap in range(4):
        out += weights[:, 1, tap, None, None] * across[n, rows + taps[tap], all_columns]
    return out


def _cubic(t: np.ndarray) -> np.ndarray:
    """Weights of four neighbours [..., 4] at the fraction t. Source: Keys, IEEE Trans. ASSP 29 (1981)."""
    t2, t3 = t * t, t * t * t
    return np.stack(
        [-0.5 * t + t2 - 0.5 * t3, 1 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2 * t2 - 1.5 * t3, 0.5 * (t3 - t2)], -1
    )


def _window() -> np.ndarray:
    r = np.arange(-HALF, HALF + 1, dtype=np.float32)
    g = np.exp(-0.5 * (r / (0.6 * HALF)) ** 2)
    return np.outer(g, g)
