"""The unknowns of the joint solve: all blocks that can be freed or held, and how a pose moves."""

from typing import TYPE_CHECKING, Literal

from jaxtyping import Float

from jaxscan.geometry import CAMERAS, Array, ParameterBlock, compose, exponential
from jaxscan.geometry.laser import LASER_BLOCKS
from jaxscan.geometry.motions import MOTION_BLOCKS


BOARD_BLOCKS = (
    ParameterBlock("warp", ("warp.x", "warp.y"), 0.001, "m", prior="warp", sigma=2e-3),
    # No image shows the size of the squares: the prior says how well the board was measured.
    ParameterBlock("pitch", ("pitch",), 0.001, prior="pitch", sigma=1e-4),
)
"""Unknowns of the calibration board, after those of the scanner."""


def board_blocks(modes: int) -> tuple[ParameterBlock, ...]:
    """`BOARD_BLOCKS`, and a block for the modes of a free shape, in units of their priors' standard deviations."""
    names = tuple(f"shape.{mode}" for mode in range(modes))
    return (*BOARD_BLOCKS, ParameterBlock("shape", names, 1.0, prior="shape", sigma=1.0))


def is_mode(name: str) -> bool:
    """Whether an unknown is a mode of the board's shape."""
    return name.startswith("shape.")


LOCAL_SCALE = 1e-2
"""Unit of a board's pose steps [m, rad]."""

_OF_CAMERAS = tuple(block for camera in CAMERAS.values() for block in camera.blocks())
_OF_ALL = _OF_CAMERAS + LASER_BLOCKS + MOTION_BLOCKS + board_blocks(0)
_HELD = ("pitch",)

CAMERA_BLOCKS = tuple(dict.fromkeys(block.name for block in _OF_CAMERAS))
"""Names of the blocks that cameras have."""
BLOCKS = tuple(dict.fromkeys(block.name for block in _OF_ALL))
"""Names of all blocks."""
USUALLY_FREE = tuple(dict.fromkeys(block.name for block in _OF_ALL if not block.optional and block.name not in _HELD))
"""Names of the blocks that are free unless settings say otherwise."""
PRIORS = {block.prior: block.sigma for block in _OF_ALL if block.prior}
"""Standard deviations of the priors, by name."""

if TYPE_CHECKING:
    Block = str
    PriorName = str
else:
    Block = Literal[BLOCKS]
    PriorName = Literal[tuple(PRIORS)]


def move_poses(poses: Float[Array, "*n 4 4"], steps: Float[Array, "*n 6"]) -> Float[Array, "*n 4 4"]:
    """T_cam0_board moved by scaled steps (translation, rotation) in the boards' own frames."""
    return compose(poses, exponential(LOCAL_SCALE * steps))
