"""The unknowns of the joint solve: their names, scales, and which of them are free."""

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.settings import BLOCKS, Block
from jaxscan.geometry import Array, exponential


BOARD_PARAMETERS = BLOCKS["warp"] + BLOCKS["pitch"]
ANGLE_PARAMETERS = BLOCKS["gain"] + BLOCKS["harmonics"]
LOCAL_SCALE = 1e-2
"""Unit of a board's pose steps [m, rad]."""

# One unit of each scaled parameter is about as far as a seed is off. The damping is
# scale-invariant; the scales make tolerances mean the same for all, and 0 holds a parameter.
_SCALES: dict[Block, float] = {
    "focal": 100.0,
    "centre": 20.0,
    "radial": 0.1,
    "tangential": 0.01,
    "k3": 0.1,
    "rational": 0.1,
    "laser": 0.01,
    "bow": 0.001,
    "axis": 0.01,
    "gain": 0.001,
    "harmonics": 0.001,
    "warp": 0.001,
    "pitch": 0.001,
}
_BLOCK_OF: dict[str, Block] = {name: block for block, names in BLOCKS.items() for name in names}


def block_of(name: str, camera: str = "pinhole") -> Block:
    """The block that a shared unknown belongs to.

    Args:
        name: Of the unknown.
        camera: Model of the camera: a fisheye's k1 ... k4 are all its radial distortion.
    """
    if camera == "fisheye" and name in ("k3", "k4"):
        return "radial"
    return _BLOCK_OF[name.rsplit(".", 1)[-1] if name.startswith("laser.") else name]


def parameter_scales(names: tuple[str, ...], free: tuple[Block, ...], camera: str = "pinhole") -> np.ndarray:
    """Size of one scaled unit of each shared unknown [px, 1, rad, m]; 0 where it is held."""
    blocks = [block_of(name, camera) for name in names]
    return np.array([_SCALES[block] if block in free else 0.0 for block in blocks])


def move_pose(pose: Float[Array, "4 4"], step: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """T_cam0_board moved by a scaled step (translation, rotation) in the board's own frame."""
    return pose @ exponential(LOCAL_SCALE * step)
