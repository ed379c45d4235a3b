"""A rig as arrays, and the places of its minimal coordinates in one vector."""

from itertools import accumulate, chain
from typing import NamedTuple

import jax
from jaxtyping import Float, Int

from jaxscan.geometry.arrays import Array, ArrayModule, namespace
from jaxscan.geometry.cameras import AbstractCamera
from jaxscan.geometry.laser import LASER_BLOCKS, LaserSheet
from jaxscan.geometry.motions import AbstractMotion
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
    """The layout of a rig."""
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


class Rig(ArrayModule):
    """Camera, laser sheets and motion, in the camera frame at position 0.

    A pytree of arrays: sizes of images and names of lasers are the `Scanner`'s, so what is compiled for one rig serves
    all of its models. `kinematics` computes with it; `jax.vmap` over its leaves is a Monte Carlo, and `jax.grad` by
    them a sensitivity.
    """

    camera: AbstractCamera
    """Without the size of its images: width and height are 0."""
    lasers: LaserSheet
    """All sheets stacked: every field has a leading axis over lasers (`stack_lasers`)."""
    motion: AbstractMotion
    """The motion between records: a `Turntable`, a `LinearStage`, or `Still`."""

    @staticmethod
    def of(camera: AbstractCamera, lasers: LaserSheet, motion: AbstractMotion) -> "Rig":
        """The rig of a camera of any size, of stacked sheets and a motion."""
        return Rig(camera.without_size(), lasers, motion)

    def laser(self, index: int | Int[Array, "..."]) -> LaserSheet:
        """One of the stacked sheets, or for many indices the sheet of each."""
        xp = namespace(self.lasers, index)
        return jax.tree.map(lambda leaf: xp.asarray(leaf)[index], self.lasers)

    def layout(self) -> Layout:
        """Positions of the minimal coordinates of each part; lasers are named by their numbers."""
        numbers = tuple(map(str, range(self.lasers.distance.shape[-1])))
        return make_layout(self.camera, numbers, motion=self.motion.blocks)

    def retract(self, step: Float[Array, " params"]) -> "Rig":
        """The rig moved by `step` in its minimal coordinates [px, rad, m]."""
        layout = self.layout()
        return Rig(
            self.camera.retract(step[layout.camera]),
            self.lasers.retract(step[layout.lasers].reshape(-1, 5)),
            self.motion.retract(step[layout.turntable]),
        )
