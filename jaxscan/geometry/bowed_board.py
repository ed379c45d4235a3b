"""A board as it is, not as it was drawn: of its true pitch, and bowed."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array


_ROUNDS = 4
"""Each leaves the slope of the bow, less than a hundredth, of the error before."""


class BowedBoard(eqx.Module):
    """The surface of a board; (x, y) are coordinates on the board as it was drawn [m]."""

    frame: Float[Array, "4"]
    """Centre x, y and half extents in x, y of the corner grid [m]; see `corner_frame`."""
    shape: Float[Array, "3"]
    """Height kx, ky [m] of the bow along x and y (z into the board), and the relative error of the pitch [1]."""

    def height(self, xy: Float[Array, "2"]) -> Float[Array, ""]:
        """z [m]: kx (1 - x'^2) + ky (1 - y'^2), with x', y' = +-1 at the outer corners.

        Source: mrcal's `calobject_warp`.
        """
        rise = self.rise(xy)
        return self.shape[0] * rise[0] + self.shape[1] * rise[1]

    def rise(self, xy: Float[Array, "2"]) -> Float[Array, "2"]:
        """How the height grows with kx and with ky [1]."""
        a = (xy - self.frame[:2]) / self.frame[2:]
        return 1.0 - a * a

    def point(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """The point of the board [m], board frame."""
        return jnp.append(xy * (1.0 + self.shape[2]), self.height(xy))

    def normal(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """The surface's normal, whose z is 1, board frame; the error of the pitch is left out."""
        half = self.frame[2:]
        slope = 2.0 * self.shape[:2] * (xy - self.frame[:2]) / (half * half)
        return jnp.stack([slope[0], slope[1], jnp.ones_like(slope[0])])

    def meet(self, pose: Float[Array, "4 4"], ray: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
        """Where a ray from the camera meets the board.

        Args:
            pose: T_cam_board.
            ray: Unit ray, camera frame.

        Returns:
            range_m: Along the ray [m]; without meaning where it runs along the board.
            point: In the board frame [m].
        """
        # Sums are written out: products of 3 x 3 matrices by the ten thousand are slow.
        turn = lambda p: jnp.stack([pose[0, i] * p[0] + pose[1, i] * p[1] + pose[2, i] * p[2] for i in range(3)])
        origin, direction = -turn(pose[:3, 3]), turn(ray)
        along_z = jnp.where(direction[2] == 0, 1.0, direction[2]).astype(direction.dtype)
        range_m = jnp.asarray(-origin[2] / along_z)
        for _ in range(_ROUNDS):
            xy = (origin[:2] + range_m * direction[:2]) / (1.0 + self.shape[2])
            range_m = jnp.asarray((self.height(xy) - origin[2]) / along_z)
        return range_m, origin + range_m * direction


def corner_frame(corners: Float[np.ndarray, "corners 3"]) -> Float[np.ndarray, "4"]:
    """Centre x, y and half extents in x, y of a board's corners [m]."""
    xy = corners[:, :2]
    return np.concatenate([(xy.min(0) + xy.max(0)) / 2, np.maximum(np.ptp(xy, axis=0) / 2, 1e-12)])
