"""Poses of photographs for programs of neural scenes and structure from motion, which read `transforms.json`.

The camera has the axes of OpenGL there: x right, y up, z backward. The centre of the first pixel is (0.5, 0.5).
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, Array, Fisheye, Pinhole, Scanner
from jaxscan.photographs.photograph import packed, poses, read_image


OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns these axes into x right, y down, z forward; it is its own inverse."""
WIDEST_PINHOLE = np.radians(70.0)
"""Half of the widest field of view that an undistorted image has."""


def describe_cameras(scanner: Scanner, angles: Sequence[float], names: Sequence[str]) -> dict[str, Any]:
    """The content of `transforms.json` for images at the table's angles [rad], or positions [m], and their paths.

    Raises:
        CalibrationError: If the file cannot describe the camera (see `is_describable`).
    """
    camera = scanner.camera
    if not is_describable(camera):
        raise CalibrationError("transforms.json cannot describe the lens of this camera; write undistorted images.")
    # Rounded, so that zeros look like zeros.
    matrices = np.round(poses(scanner, np.asarray(angles)).astype(np.float64) @ OPENGL_FROM_OPENCV, 8) + 0.0
    frames = [
        {"file_path": name, "transform_matrix": matrix.tolist()} for name, matrix in zip(names, matrices, strict=True)
    ]
    return {**_intrinsics(camera), "frames": frames}


def is_describable(camera: AbstractCamera) -> bool:
    """Whether `transforms.json` has a model for a camera: a fisheye or pinhole without skew or rational terms."""
    if isinstance(camera, Pinhole | Fisheye):
        rational = isinstance(camera, Pinhole) and np.any(np.asarray(camera.distortion)[5:])
        return float(camera.skew) == 0 and not rational
    return False


def _intrinsics(camera: AbstractCamera) -> dict[str, Any]:
    values = [float(value) for value in np.asarray(camera.distortion)]
    if isinstance(camera, Fisheye):
        model, lens = "OPENCV_FISHEYE", dict(zip(("k1", "k2", "k3", "k4"), values, strict=True))
    else:
        model, lens = "OPENCV", dict(zip(("k1", "k2", "p1", "p2", "k3"), values[:5], strict=True))
    return {
        "camera_model": model,
        "w": camera.width,
        "h": camera.height,
        "fl_x": float(camera.fx),
        "fl_y": float(camera.fy),
        "cx": float(camera.cx) + 0.5,
        "cy": float(camera.cy) + 0.5,
        **lens,
    }


def ideal_camera(camera: AbstractCamera) -> Pinhole:
    """A camera without distortion, with square pixels, that shows the middle of `camera`'s image at the same size."""
    focal = float(min(camera.fx, camera.fy))
    # Beyond this a wide lens would be stretched without limit.
    most = focal * float(np.tan(WIDEST_PINHOLE))
    width, height = (int(min(size, 2 * most)) for size in (camera.width, camera.height))
    f, cx, cy = (np.asarray(value) for value in (focal, (width - 1) / 2, (height - 1) / 2))
    return Pinhole(f, f, cx, cy, np.zeros(5), width, height)


def undistort(
    image: UInt8[np.ndarray, "rows columns 3"], camera: AbstractCamera, ideal: Pinhole
) -> UInt8[np.ndarray, "height width 3"]:
    """A photograph as another camera at the same place would have taken it; black where it shows nothing."""
    with jax.enable_x64(False):
        single, other = (jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), one) for one in (camera, ideal))
        return np.asarray(_undistorted(image, single, other))


@jax.jit
def _undistorted(
    image: UInt8[Array, "rows columns 3"], camera: AbstractCamera, ideal: Pinhole
) -> UInt8[Array, "height width 3"]:
    pixels = packed(image)

    def colour(u: Float[Array, ""], v: Float[Array, ""]) -> UInt8[Array, "3"]:
        q = camera.project(ideal.unproject(jnp.stack([u, v])))
        inside = jnp.all((q >= -0.5) & (q <= jnp.array(image.shape[1::-1], jnp.float32) - 0.5))
        return jnp.where(inside, jnp.round(read_image(pixels, q)[0]), 0).astype(jnp.uint8)

    u, v = jnp.arange(ideal.width, dtype=jnp.float32), jnp.arange(ideal.height, dtype=jnp.float32)
    return jax.vmap(jax.vmap(colour, (0, None)), (None, 0))(u, v)
