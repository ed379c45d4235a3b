"""Positions of the minimal coordinates of each part of a scanner in one vector."""

from itertools import accumulate, chain
from typing import NamedTuple

from jaxscan.geometry.cameras import AbstractCamera
from jaxscan.geometry.laser import LASER_BLOCKS
from jaxscan.geometry.parameters import ParameterBlock


class Layout(NamedTuple):
    """The order of all minimal coordinates: camera, laser after laser, motion, board."""

    names: tuple[str, ...]
    blocks: tuple[ParameterBlock, ...]
    """Block of each coordinate, as long as `names`."""
    camera: slice
    lasers: slice
    turntable: slice
    board: slice


def make_layout(
    camera: AbstractCamera,
    lasers: tuple[str, ...],
    *,
    motion: tuple[ParameterBlock, ...] = (),
    board: tuple[ParameterBlock, ...] = (),
) -> Layout:
    """The layout of a rig.

    Args:
        camera: The camera.
        lasers: Names of the lasers.
        motion: Blocks of the motion between records; none where there is no motion.
        board: Blocks of the board, if it is solved for too.
    """
    names = camera.parameter_names()
    parts = (
        list(zip(names, (block for block in camera.blocks() for _ in block.parameters), strict=False)),
        [(f"laser.{laser}.{name}", block) for laser in lasers for block in LASER_BLOCKS for name in block.parameters],
        [(name, block) for block in motion for name in block.parameters],
        [(name, block) for block in board for name in block.parameters],
    )
    ends = list(accumulate(map(len, parts)))
    every = list(chain(*parts))
    return Layout(
        tuple(name for name, _ in every),
        tuple(block for _, block in every),
        *(slice(end - len(part), end) for part, end in zip(parts, ends, strict=True)),
    )
