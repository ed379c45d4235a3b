"""A rig as arrays: what a pixel's ray, its point and its derivatives depend on, and nothing else."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from jaxscan.geometry.arrays import Array, namespace
from jaxscan.geometry.cameras import AbstractCamera
from jaxscan.geometry.laser import LaserSheet
from jaxscan.geometry.motions import AbstractMotion


class Rig(eqx.Module):
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
        return Rig(replace(camera, width=0, height=0), lasers, motion)

    def laser(self, index: int | Int[Array, "..."]) -> LaserSheet:
        """One of the stacked sheets, or for many indices the sheet of each."""
        xp = namespace(self.lasers, index)
        return jax.tree.map(lambda leaf: xp.asarray(leaf)[index], self.lasers)

    def parameter_count(self) -> int:
        """Number of the minimal coordinates: of the camera, of the sheets, of the motion."""
        motion = sum(len(block.parameters) for block in self.motion.blocks)
        return 4 + self.camera.distortion.shape[-1] + 5 * self.lasers.distance.shape[-1] + motion

    def retract(self, step: Float[Array, " params"]) -> "Rig":
        """The rig moved by `step` in its minimal coordinates [px, rad, m]."""
        lasers = 4 + self.camera.distortion.shape[-1]
        motion = lasers + 5 * self.lasers.distance.shape[-1]
        sheets = self.lasers.retract(step[lasers:motion].reshape(-1, 5))
        return Rig(self.camera.retract(step[:lasers]), sheets, self.motion.retract(step[motion:]))

    def astype(self, dtype: jnp.dtype | type) -> "Rig":
        """The same rig in another precision, as NumPy arrays or JAX arrays, whichever it is made of."""
        return jax.tree.map(lambda leaf: leaf.astype(dtype), self)
