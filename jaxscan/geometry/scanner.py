"""The scanner: camera, laser sheets and motion, calibrated, as one pytree."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import kinematics
from jaxscan.geometry.arrays import Array, ArrayModule
from jaxscan.geometry.cameras import AbstractCamera
from jaxscan.geometry.laser import LaserSheet, stack_lasers
from jaxscan.geometry.motions import AbstractMotion, Still, Turntable
from jaxscan.geometry.rig import Layout, Rig, make_layout
from jaxscan.geometry.rigid import transform


Up = Literal["-v", "+v", "+u", "-u"]
UP_VECTORS = {"-v": (0.0, -1.0, 0.0), "+v": (0.0, 1.0, 0.0), "+u": (1.0, 0.0, 0.0), "-u": (-1.0, 0.0, 0.0)}
"""The image's up direction in the camera frame, by the name it has in files."""


class Scanner(ArrayModule):
    """The result of a calibration and the input of a reconstruction.

    Held as NumPy float64 on the host; `as_dtype` casts it for computing.
    """

    camera: AbstractCamera
    lasers: LaserSheet
    """All sheets stacked: every field has a leading axis over lasers (`stack_lasers`)."""
    turntable: AbstractMotion
    """The motion between records: a `Turntable`, a `LinearStage`, or `Still`."""
    covariance: Float[Array, "params params"] | None = None
    """Covariance of the minimal coordinates (`parameter_names`; px, rad, m), where known."""
    laser_names: tuple[str, ...] = eqx.field(static=True, default=("laser",))
    up: Up = eqx.field(static=True, default="-v")
    """The image direction that is up; it fixes the sense of the axis."""

    @staticmethod
    def from_parts(
        camera: AbstractCamera,
        lasers: LaserSheet | Sequence[LaserSheet],
        turntable: AbstractMotion | None = None,
        *,
        laser_names: Sequence[str] = (),
        up: Up = "-v",
    ) -> "Scanner":
        """A scanner from its parts, all in the camera frame at position 0.

        Args:
            camera: Any model.
            lasers: One sheet, or several.
            turntable: A turntable, its axis in either sense (it is flipped to the image's up side, with the signs of
                its angles); a linear stage; or None for a scanner that stands still.
            laser_names: One for each sheet; without any, "laser", or "laser1", "laser2" and so on.
            up: The image direction that is up.

        Returns:
            The scanner, without a covariance.

        Raises:
            ValueError: If there is no sheet, or the names do not fit the sheets.
        """
        sheets = [lasers] if isinstance(lasers, LaserSheet) else list(lasers)
        if not sheets or any(np.shape(sheet.normal) != (3,) for sheet in sheets):
            raise ValueError("lasers: expected one sheet, or a list of at least one sheet")
        counted = ["laser"] if len(sheets) == 1 else [f"laser{k + 1}" for k in range(len(sheets))]
        names = tuple(laser_names) or tuple(counted)
        if len(names) != len(sheets) or len(set(names)) < len(names):
            raise ValueError(f"laser_names: found {', '.join(names)}, expected {len(sheets)} different names")
        return Scanner(camera, stack_lasers(sheets), point_up(turntable or Still(), up), laser_names=names, up=up)

    @property
    def rig(self) -> Rig:
        """Camera, sheets and motion as arrays alone: what `kinematics` computes with."""
        return Rig.of(self.camera, self.lasers, self.turntable)

    def laser(self, index: int | Int[Array, ""]) -> LaserSheet:
        """One of the stacked sheets."""
        return self.rig.laser(index)

    def as_dtype(self, dtype: jnp.dtype | type) -> "Scanner":
        """The same scanner with JAX leaves of one floating type."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), self)

    def scanner_from_camera(self) -> Float[Array, "4 4"]:
        """T_scanner_cam at position 0; see `frame` of the motion."""
        return self.turntable.frame()

    def pose(self, phi: Float[Array, "..."]) -> Float[Array, "... 4 4"]:
        """T_scanner_cam(phi); see `kinematics.poses`."""
        return kinematics.poses(self.rig, phi)

    def point(
        self, q: Float[Array, "... 2"], laser: int | Int[Array, "..."], phi: Float[Array, "..."]
    ) -> tuple[Float[Array, "... 3"], Float[Array, "..."]]:
        """Points of stripes, scanner frame [m], and the incidence, which is positive where a point exists.

        See `kinematics.points`.
        """
        rig = self.rig
        p_cam, incidence = kinematics.lit_points(rig, q, laser)
        return transform(kinematics.poses(rig, phi), p_cam), incidence

    def along(self, poses: Float[np.ndarray, "records 4 4"] | None) -> "Scanner":
        """The scanner in one capture, where its records have poses; see `along` of the motion."""
        return self if poses is None else replace(self, turntable=self.turntable.along(poses))

    def parameter_names(self) -> tuple[str, ...]:
        """Names of the minimal coordinates: camera, lasers, motion."""
        return self.layout().names

    def layout(self) -> Layout:
        """Positions of the minimal coordinates of each part."""
        return make_layout(self.camera, self.laser_names, motion=self.turntable.blocks)

    def retract(self, step: Float[Array, " params"]) -> "Scanner":
        """The scanner moved by `step` in its minimal coordinates; it has no covariance."""
        return self.with_rig(self.rig.retract(step))

    def values(self) -> Float[np.ndarray, " params"]:
        """Values of the minimal coordinates; 0 for those of directions and points, which are steps from them."""
        with jax.enable_x64(True):
            camera = np.asarray(self.camera.parameters(), np.float64)
        sheets = [[0.0, 0.0, float(d), *bow] for d, bow in zip(self.lasers.distance, self.lasers.bow, strict=True)]
        table = self.turntable
        angles = [0.0] * 4 + [float(table.gain), *table.harmonics] if isinstance(table, Turntable) else []
        found = np.concatenate([camera, *np.asarray(sheets, np.float64), np.asarray(angles, np.float64)])
        return np.pad(found, (0, len(self.parameter_names()) - len(found)))

    def departure(self, other: "Scanner") -> Float[np.ndarray, " params"]:
        """How far another scanner of the same kind is from this one, in the minimal coordinates of this one."""
        with jax.enable_x64(True):
            parts = [np.asarray(other.camera.parameters()) - np.asarray(self.camera.parameters())]
        for index in range(len(self.laser_names)):
            old, new = self.laser(index), other.laser(index)
            parts += [np.asarray(old.basis) @ (np.asarray(new.normal) - np.asarray(old.normal))]
            parts += [np.atleast_1d(new.distance - old.distance), np.asarray(new.bow - old.bow)]
        return np.concatenate([*parts, np.asarray(self.turntable.departure(other.turntable))]).astype(np.float64)

    def with_rig(self, rig: Rig) -> "Scanner":
        """Another rig under the names and with the image size of this one, without a covariance."""
        camera = replace(rig.camera, width=self.camera.width, height=self.camera.height)
        return Scanner(camera, rig.lasers, rig.motion, laser_names=self.laser_names, up=self.up)


def point_up(turntable: AbstractMotion, up: Up) -> AbstractMotion:
    """The same motion in its canonical form: the axis of a turntable on the image's up side."""
    return turntable.pointed(np.array(UP_VECTORS[up])) if isinstance(turntable, Turntable) else turntable
