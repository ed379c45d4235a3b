"""Photographs of a sweep: the choice among many, their lens and pose, and the projection of points."""

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Int32, UInt8

from jaxscan.geometry import AbstractCamera, Array, Scanner, kinematics
from jaxscan.stripes import PixelFormat


Use = Literal["points", "pictures"]
"""What photographs are for: colours of measured points, or panoramas, textures and posed images."""
LEAST: dict[Use, int] = {"points": 60, "pictures": 180}
"""Fewest photographs of a turn that are used, however wide the lens: what is hidden in one is seen in the next."""
OVERLAP: dict[Use, int] = {"points": 8, "pictures": 16}
"""Photographs that show a place, at the least. With three times as many, colours of points in a rendered corner of a
room are closer to the true ones by 0.1 dB."""


def enough_photographs(scanner: Scanner, use: Use) -> int:
    """Photographs of a turn that show every place often enough, whatever the lens."""
    camera = scanner.camera
    narrowest = 2 * np.arctan(min(camera.width / float(camera.fx), camera.height / float(camera.fy)) / 2)
    return max(LEAST[use], int(np.ceil(OVERLAP[use] * 2 * np.pi / narrowest)))


def choose_evenly(
    places: Float[np.ndarray, " n"], most: int, *, period: float | None = None
) -> Int[np.ndarray, " chosen"]:
    """Choose at most so many by place, not by number: the sweep may have gone over one part twice, or more slowly.

    One is chosen of each of as many equal parts of the way.

    Args:
        places: Angle [rad] or position [m] of each photograph.
        most: How many.
        period: Period after which places repeat; None if they do not.
    """
    if len(places) <= most:
        return np.arange(len(places))
    places = np.asarray(places, np.float64)
    low, way = float(places.min()), float(np.ptp(places))
    if period is not None and way >= period:
        places, low, way = np.mod(places, period), 0.0, period
    # A small offset, or rounding would put the places of an even sweep into neighbouring parts.
    part = np.floor((places - low) / max(way, 1e-12) * most + 1e-6).astype(np.int64)
    return np.sort(np.unique(np.minimum(part, most - 1), return_index=True)[1])


MARGIN_PX = 1.5
"""Nearer to the border of an image no colour is taken: four pixels are needed on each side of a place."""


class Lens(NamedTuple):
    """A camera and the cone of its rays, single precision."""

    camera: AbstractCamera
    least_cosine: Float[Array, ""]
    """Cosine of the widest angle between the optical axis and a pixel's ray. Beyond, a lens model may fold back."""
    bounds: Float[Array, "2 3"]
    """Least and largest component of the rays of pixels on each axis of the camera."""
    per_pixel: Float[Array, ""]
    """Angle of a pixel in the middle of the image [rad]."""

    @staticmethod
    def of(camera: AbstractCamera) -> "Lens":
        """The lens of a camera."""
        rays = border_rays(camera)
        bounds = np.stack([rays.min(0) - 1e-4, rays.max(0) + 1e-4])
        # Rays across the optical axis are in the image of a wider lens, but not on its border.
        bounds[:, :2] = bounds[:, :2] if bounds[0, 2] > 0 else [[-1], [1]]
        bounds[1, 2] = 1
        single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), camera)
        focal = max(float(camera.fx), float(camera.fy))
        return Lens(single, *(np.asarray(field, np.float32) for field in (bounds[0, 2], bounds, 1.0 / focal)))


class PhotographView(NamedTuple):
    """Lens and pose of a photograph."""

    lens: Lens
    T_scanner_cam: Float[Array, "4 4"]


class Sight(NamedTuple):
    """Projection of a point into a photograph."""

    q: Float[Array, "2"]
    range_m: Float[Array, ""]
    inside: Bool[Array, ""]


def poses(scanner: Scanner, angles: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
    """T_scanner_cam at each of the table's angles [rad], or positions of a stage [m]."""
    return np.asarray(kinematics.poses(scanner.rig, np.asarray(angles, np.float64)), np.float32)


def pose_finder(scanner: Scanner) -> Callable[[float], Float[np.ndarray, "4 4"]]:
    """`poses` of one angle at a time."""
    rig = scanner.rig
    return lambda angle: np.asarray(kinematics.poses(rig, angle), np.float32)


def border_rays(camera: AbstractCamera) -> Float[np.ndarray, "n 3"]:
    """Unit rays [camera frame] of pixels round the border of the image."""
    columns, rows = np.linspace(0, camera.width - 1, 33), np.linspace(0, camera.height - 1, 33)
    sides = [(columns, rows[:1]), (columns, rows[-1:]), (columns[:1], rows), (columns[-1:], rows)]
    q = np.concatenate([np.stack(np.broadcast_arrays(u, v), -1) for u, v in sides])
    return np.asarray(camera.unproject(q))


def dot(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, ""]:
    """The scalar product, written out: XLA would turn a contraction of three components into a loop for each point."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def sight(view: PhotographView, point: Float[Array, "3"]) -> Sight:
    """A point [scanner frame, m] in a view."""
    camera = view.lens.camera
    rotation, centre = view.T_scanner_cam[:3, :3], view.T_scanner_cam[:3, 3]
    way = point - centre
    p = jnp.stack([dot(rotation[:, k], way) for k in range(3)])
    range_m = jnp.sqrt(dot(p, p))
    q = camera.project(p)
    u, v = q
    inside = (p[2] > view.lens.least_cosine * range_m) & (range_m > 0)
    inside &= (u >= MARGIN_PX) & (u <= camera.width - 1 - MARGIN_PX)
    inside &= (v >= MARGIN_PX) & (v <= camera.height - 1 - MARGIN_PX)
    return Sight(q, range_m, inside)


class Photograph(NamedTuple):
    """A laser-off image, and where the table stood."""

    angle: float
    """The table's angle [rad from home], or the position of a stage [m]."""
    image: np.ndarray
    """RGB, uint8 [rows, columns, 3]; in the camera's own response."""


@runtime_checkable
class Album(Protocol):
    """Photographs that need not all be read."""

    def __iter__(self) -> Iterator[Photograph]: ...

    def where(self, wanted: Callable[[float], bool]) -> Iterator[Photograph]:
        """The photographs whose angle [rad or m] is wanted; the others are not read."""
        ...


@dataclass(frozen=True)
class Photographs:
    """Photographs of a calibrated rig, one after the other; each is in memory only while it is used.

    Args:
        scanner: The calibrated rig.
        shots: The photographs; iterated once by every function that looks at them. An `Album` leaves out
            those that do not show what is wanted.
    """

    scanner: Scanner
    shots: Iterable[Photograph]

    def __iter__(self) -> Iterator[Photograph]:
        return self._checked(self.shots)

    def where(self, wanted: Callable[[float], bool]) -> Iterator[Photograph]:
        """Photographs whose angle [rad or m] is wanted."""
        if isinstance(self.shots, Album):
            return self._checked(self.shots.where(wanted))
        return (shot for shot in self if wanted(shot.angle))

    def _checked(self, shots: Iterable[Photograph]) -> Iterator[Photograph]:
        camera = self.scanner.camera
        for shot in shots:
            if shot.image.shape != (camera.height, camera.width, 3) or shot.image.dtype != np.uint8:
                raise ValueError(
                    f"A photograph must be uint8 [{camera.height}, {camera.width}, 3], got {shot.image.dtype} with "
                    f"shape {shot.image.shape}."
                )
            yield shot


def as_rgb(frame: UInt8[np.ndarray, "..."], pixel_format: PixelFormat) -> UInt8[np.ndarray, "rows columns 3"]:
    """A frame as an RGB image; grey for a mono camera. Missing colours of a Bayer frame are interpolated."""
    if pixel_format == "rgb8":
        return frame
    if pixel_format == "mono8":
        return np.repeat(frame[:, :, None], 3, 2)
    with jax.enable_x64(False):
        return np.asarray(_demosaic(frame, tile=pixel_format.removeprefix("bayer_").removesuffix("8")))


@functools.partial(jax.jit, static_argnames="tile")
def _demosaic(frame: UInt8[Array, "rows columns"], *, tile: str) -> UInt8[Array, "rows columns 3"]:
    """Each colour where it was not measured: the mean of those beside it, corrected by the colour that was.

    Source: Malvar, He, Cutler, High-quality linear interpolation for demosaicing of Bayer-patterned color images, 2004.
    """
    raw = frame.astype(jnp.float32)
    rows, columns = raw.shape
    padded = jnp.pad(raw, 2, mode="reflect")
    level = [[padded[2 + i : 2 + i + rows, 2 + j : 2 + j + columns] for j in range(-2, 3)] for i in range(-2, 3)]
    beside, above = level[2][1] + level[2][3], level[1][2] + level[3][2]
    beyond_beside, beyond_above = level[2][0] + level[2][4], level[0][2] + level[4][2]
    diagonal = level[1][1] + level[1][3] + level[3][1] + level[3][3]
    beyond = beyond_beside + beyond_above
    cross = (4 * raw + 2 * (beside + above) - beyond) / 8
    along_row = (5 * raw + 4 * beside - diagonal - beyond_beside + 0.5 * beyond_above) / 8
    along_column = (5 * raw + 4 * above - diagonal - beyond_above + 0.5 * beyond_beside) / 8
    opposite = (6 * raw + 2 * diagonal - 1.5 * beyond) / 8
    odd_row, odd_column = (jnp.arange(n) % 2 == 1 for n in (rows, columns))
    site = 2 * odd_row.astype(jnp.int32)[:, None] + odd_column.astype(jnp.int32)[None, :]
    planes = []
    for colour in "rgb":
        plane = raw
        for number, letter in enumerate(tile):
            in_row = colour in tile[number // 2 * 2 : number // 2 * 2 + 2]
            if letter == colour:
                continue
            if colour == "g":
                found = cross
            elif letter == "g":
                found = along_row if in_row else along_column
            else:
                found = opposite
            plane = jnp.where(site == number, found, plane)
        planes.append(plane)
    return jnp.clip(jnp.round(jnp.stack(planes, -1)), 0, 255).astype(jnp.uint8)


def packed(image: UInt8[Array, "rows columns 3"]) -> Int32[Array, "rows columns"]:
    """The three codes of each pixel in one number, so that they are read at once."""
    red, green, blue = (jnp.asarray(image)[..., k].astype(jnp.int32) for k in range(3))
    return red | (green << 8) | (blue << 16)


def read_image(
    pixels: Int32[Array, "rows columns"], q: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, ""]]:
    """Colour of a `packed` image at a pixel (u, v), by cubic convolution, and the brightest code of its pixels [DN].

    Pixels on the border repeat beyond it. A colour is no darker and no brighter than the pixels about it: beside an
    edge the cubic would be.
    """
    (rows, columns), pixels = pixels.shape, jnp.asarray(pixels).reshape(-1)
    left, top = jnp.floor(q)
    across, down = _cubic(q[0] - left), _cubic(q[1] - top)
    # Written out, XLA keeps the sixteen pixels in registers; as an array [4, 4, 3] they take four times as long.
    total, low, high = ([jnp.float32(start)] * 3 for start in (0, 255, 0))
    for i in range(4):
        row, along = columns * jnp.clip(top.astype(jnp.int32) + i - 1, 0, rows - 1), [jnp.float32(0)] * 3
        for j in range(4):
            column = jnp.clip(left.astype(jnp.int32) + j - 1, 0, columns - 1)
            pixel = pixels.at[row + column].get(mode="promise_in_bounds")
            for k in range(3):
                level = ((pixel >> (8 * k)) & 255).astype(jnp.float32)
                along[k] = along[k] + across[j] * level
                low[k], high[k] = jnp.minimum(low[k], level), jnp.maximum(high[k], level)
        total = [whole + down[i] * part for whole, part in zip(total, along, strict=True)]
    colour = [jnp.clip(*parts) for parts in zip(total, low, high, strict=True)]
    return jnp.stack(colour), functools.reduce(jnp.maximum, high)


def _cubic(t: Float[Array, ""]) -> tuple[Float[Array, ""], ...]:
    """Weights of four pixels in a row, `t` after the second of them.

    Source: Keys, Cubic convolution interpolation for digital image processing, 1981.
    """
    t2, t3 = t * t, t * t * t
    first, second = -0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3
    return first, second, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3
