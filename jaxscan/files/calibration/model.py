"""The tables of a calibration file, as they are checked when it is read."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

import numpy as np
import pydantic

from jaxscan.files.disk import FileModel, ImageSize, Number
from jaxscan.geometry import (
    CAMERAS,
    MOTIONS,
    AbstractCamera,
    AbstractMotion,
    LaserSheet,
    Scanner,
    Still,
    Turntable,
    motion_class,
    motion_of,
    point_up,
    stack_lasers,
)
from jaxscan.geometry.rigid import UNIT_TOLERANCE, check_frame
from jaxscan.geometry.scanner import UP_VECTORS, Up


# Beyond these limits squares and quotients are not finite, in single precision at the latest.
Limited = Annotated[Number, pydantic.Field(ge=-1e6, le=1e6)]
"""Pixels, metres, coefficients, and components of vectors."""
Focal = Annotated[Number, pydantic.Field(ge=0.1, le=1e6)]
Bend = Annotated[Number, pydantic.Field(ge=-10, le=10)]
"""Bows and harmonics, rad."""
Covariance = Annotated[Number, pydantic.Field(ge=-1e12, le=1e12)]
Pair = tuple[Bend, Bend]
Triple = tuple[Limited, Limited, Limited]
Basis = tuple[Triple, Triple]


def arrays(*values: Any) -> tuple[np.ndarray, ...]:
    """Numbers as float64 arrays."""
    return tuple(np.array(value, np.float64) for value in values)


class MotionTable(FileModel):
    """A motion between records: its kind, and the numbers that this kind has."""

    direction: Triple = (0.0, 0.0, 0.0)
    basis: Basis | None = None

    @pydantic.model_validator(mode="after")
    def _meaningful(self) -> "MotionTable":
        self.motion()
        return self

    def motion(self) -> AbstractMotion:
        """The motion of the geometry.

        Raises:
            ValueError: If the numbers make none.
        """
        values = self.model_dump()
        carries = values.pop("carries")
        return motion_of(carries, **{key: None if one is None else np.array(one) for key, one in values.items()})


_SHAPES: dict[tuple[int, ...], Any] = {(): Limited, (3,): Triple, (4,): tuple[Bend, Bend, Bend, Bend], (2, 3): Basis}


def _tables() -> dict[str, Any]:
    """The table of each class of motions; that of a turntable need not say what it carries."""
    names: dict[str, list[str]] = {}
    for carries, kind in MOTIONS.items():
        if motion_class(carries).fields:
            names.setdefault(kind.part, []).append(carries)
    tables = {}
    for part, known in names.items():
        fields: Any = {
            key: (_SHAPES[field.shape] | None if field.default is None else _SHAPES[field.shape], field.default)
            for key, field in motion_class(known[0]).fields.items()
        }
        fields["carries"] = (Literal[tuple(known)], known[0] if "scanner" in known else ...)
        tables[part] = pydantic.create_model("MotionTable", __base__=MotionTable, **fields)
    return tables


def _part(value: Any) -> str:
    carries = value.get("carries", "scanner") if isinstance(value, dict) else getattr(value, "carries", "scanner")
    return MOTIONS[carries].part if isinstance(carries, str) and carries in MOTIONS else MOTIONS["scanner"].part


if TYPE_CHECKING:
    AnyMotionTable = MotionTable
else:
    AnyMotionTable = Annotated[
        Union[tuple(Annotated[table, pydantic.Tag(part)] for part, table in _tables().items())],  # noqa: UP007
        pydantic.Discriminator(_part),
    ]


CALIBRATION_FORMAT: Literal["jaxscan-calibration/1"] = "jaxscan-calibration/1"
NEAREST_M, FARTHEST_M = 1e-6, 1e6
"""Range of the distance of a sheet from the camera centre."""


class LensTable(FileModel):
    """Coefficients of a lens by name [1]; each camera model has a table of its own."""

    @pydantic.model_validator(mode="after")
    def _all_or_none(self) -> "LensTable":
        optional = [name for name, known in type(self).model_fields.items() if not known.is_required()]
        if len({getattr(self, name) is None for name in optional}) > 1:
            raise ValueError(f"{', '.join(optional[:-1])} and {optional[-1]} come together or not at all")
        return self


class CameraTable(ImageSize):
    """A camera; the coefficients of its lens depend on the model."""

    model: str
    up: Up = "-v"
    fx: Focal
    fy: Focal
    cx: Limited
    cy: Limited
    skew: Limited = 0.0
    distortion: LensTable

    @pydantic.field_validator("skew")
    @classmethod
    def _known(cls, skew: float, info: Any) -> float:
        if skew != 0.0 and not _has_skew(CAMERAS[info.data["model"]]):
            raise ValueError(f"found {skew}, a {info.data['model']} has no skew: expected 0")
        return skew

    def camera(self) -> AbstractCamera:
        """The camera of the geometry."""
        model = CAMERAS[self.model]
        fx, fy, cx, cy = (np.asarray(value, np.float64) for value in (self.fx, self.fy, self.cx, self.cy))
        lens = np.array([value for _, value in self.distortion if value is not None], np.float64)
        skew: dict[str, Any] = {"skew": np.asarray(self.skew, np.float64)} if _has_skew(model) else {}
        return model(fx, fy, cx, cy, lens, self.width, self.height, **skew)

    @staticmethod
    def of(camera: AbstractCamera, up: Up) -> dict[str, Any]:
        """A camera as its table in the file."""
        names, values = camera.parameter_names(), np.asarray(camera.parameters(), np.float64).tolist()
        numbers = dict(zip(names, values, strict=True))
        pixels = {name: numbers.pop(name) for name in ("fx", "fy", "cx", "cy")}
        size = {"model": camera.model, "width": camera.width, "height": camera.height, "up": up}
        return {**size, **pixels, "skew": float(getattr(camera, "skew", 0.0)), "distortion": numbers}


def _has_skew(model: type[AbstractCamera]) -> bool:
    return "skew" in model.__dataclass_fields__


def _table(model: type[AbstractCamera]) -> type[CameraTable]:
    """The table of a camera model."""
    lens: Any = {
        name: (Limited | None, None) if block.optional else (Limited, ...)
        for block in model.lens
        for name in block.parameters
    }
    coefficients = pydantic.create_model(f"{model.__name__}Lens", __base__=LensTable, **lens)
    fields: Any = {"model": (Literal[model.model], ...), "distortion": (coefficients, ...)}
    return pydantic.create_model(f"{model.__name__}Table", __base__=CameraTable, **fields)


if TYPE_CHECKING:
    AnyCameraTable = CameraTable
else:
    AnyCameraTable = Annotated[
        Union[tuple(map(_table, CAMERAS.values()))],  # noqa: UP007
        pydantic.Field(discriminator="model"),
    ]


class LaserTable(FileModel):
    """A laser sheet in the camera frame at position 0: `normal` and `distance_m`, or the paper's `abc`.

    With a `basis` it is canonical: a unit normal and a positive distance. Without one it was written by hand, and
    neither sign nor length of the normal matters.
    """

    name: Annotated[str, pydantic.Field(min_length=1, max_length=64)] = "laser"
    normal: Triple | None = None
    distance_m: Limited | None = None
    abc: Triple | None = None
    """a, b [1] and c [m] of the plane a X + b Y + Z = c. Source: the paper, equation (4)."""
    bow: Pair = (0.0, 0.0)
    basis: Basis | None = None

    @pydantic.model_validator(mode="after")
    def _meaningful(self) -> "LaserTable":
        distance = float(self.sheet().distance)
        if not NEAREST_M <= distance <= FARTHEST_M:
            raise ValueError(f"distance_m: the sheet is {distance:g} m away, expected {NEAREST_M:g} to {FARTHEST_M:g}")
        return self

    def sheet(self) -> LaserSheet:
        """The sheet of the geometry.

        Raises:
            ValueError: If the plane is given twice or not at all, or the numbers are no plane.
        """
        if self.abc is not None:
            if self.normal is not None or self.distance_m is not None or self.basis is not None:
                raise ValueError("abc: found beside normal, distance_m or basis, expected the plane only once")
            return self._bowed(LaserSheet.from_abc(*self.abc))
        if self.normal is None or self.distance_m is None:
            raise ValueError(
                f"{'normal' if self.normal is None else 'distance_m'}: missing (or abc, the paper's plane)"
            )
        if self.basis is None:
            return self._bowed(LaserSheet.from_plane(self.normal, self.distance_m))
        check_frame("normal", self.normal, self.basis)
        if self.distance_m <= 0:
            raise ValueError(f"distance_m: found {self.distance_m:g}, expected greater than 0 beside a basis")
        return LaserSheet(*arrays(self.normal, self.distance_m, self.bow, self.basis))

    def _bowed(self, flat: LaserSheet) -> LaserSheet:
        if any(self.bow) and not np.allclose(flat.normal, self.normal or 0.0, rtol=0, atol=UNIT_TOLERANCE):
            raise ValueError("bow: its signs and its size refer to a normal of length 1 and a distance_m above 0")
        return dataclasses.replace(flat, bow=np.array(self.bow, np.float64))


class CovarianceTable(FileModel):
    """Covariance of the minimal coordinates [px, rad, m]."""

    order: Annotated[tuple[str, ...], pydantic.Field(max_length=200)]
    matrix: Annotated[tuple[tuple[Covariance, ...], ...], pydantic.Field(max_length=200)]
    scale: Annotated[Number, pydantic.Field(ge=0)] = 1.0
    """Factor by which the misfit of the solve has already scaled `matrix`; for information only."""

    @pydantic.model_validator(mode="after")
    def _semidefinite(self) -> "CovarianceTable":
        count = len(self.order)
        if len(self.matrix) != count or any(len(row) != count for row in self.matrix):
            raise ValueError(f"matrix: expected {count} rows of {count} numbers, as order has names")
        matrix = self.array()
        variances = np.diag(matrix)
        if (variances < 0).any():
            raise ValueError(f"matrix: the variance of {self.order[int(np.argmin(variances))]} is negative")
        # As correlations, so that px and rad are judged alike; a parameter held fixed has no row.
        deviations = np.sqrt(np.where(variances > 0, variances, 1.0))
        with np.errstate(over="ignore"):
            correlations = matrix / deviations[:, None] / deviations[None, :]
        if not np.isfinite(correlations).all():
            raise ValueError("matrix: not positive semidefinite")
        if not np.allclose(correlations, correlations.T, rtol=0, atol=1e-9):
            raise ValueError("matrix: not symmetric")
        # Rounding in inverting an information matrix of condition 1e10 leaves about 1e-6.
        if count and np.linalg.eigvalsh(correlations)[0] < -1e-6:
            raise ValueError("matrix: not positive semidefinite")
        return self

    def array(self) -> np.ndarray:
        """The matrix, float64 [parameters, parameters]."""
        return np.array(self.matrix, np.float64).reshape(len(self.order), -1 if self.order else 0)


class DigestTable(FileModel):
    """Digests as a program writes them; a person leaves them out."""

    values: str | None = None
    observations: str | None = None


class CalibrationTable(FileModel):
    """A calibration file; without lasers or without turntable it holds a part of a rig."""

    format: Literal["jaxscan-calibration/1"]
    camera: AnyCameraTable
    lasers: Annotated[tuple[LaserTable, ...], pydantic.Field(max_length=16)] = ()
    turntable: AnyMotionTable | None = None
    quality: dict[str, Any] = pydantic.Field(default_factory=dict)
    provenance: dict[str, Any] = pydantic.Field(default_factory=dict)
    covariance: CovarianceTable | None = None
    digests: DigestTable | None = None

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> "CalibrationTable":
        names = [laser.name for laser in self.lasers]
        if len(set(names)) < len(names):
            raise ValueError(f"lasers: found the names {', '.join(names)[:60]}, expected no name twice")
        table = self.turntable
        canonical = table is None or table.basis is not None or "basis" not in table.motion().fields
        if table is not None and canonical and isinstance(table.motion(), Turntable):
            if np.dot(table.direction, UP_VECTORS[self.camera.up]) < 0:
                raise ValueError(
                    f'turntable.direction: points down, expected towards the image\'s up "{self.camera.up}"'
                )
        if self.covariance is not None and not (canonical and all(laser.basis is not None for laser in self.lasers)):
            raise ValueError(
                "covariance: refers to the basis of every laser and of the turntable, and one is missing; give them, "
                "or leave the covariance out"
            )
        return self

    def scanner(self) -> Scanner | None:
        """The scanner; None where the file holds a camera alone."""
        if self.turntable is None and not self.lasers:
            return None
        motion = Still() if self.turntable is None else self.turntable.motion()
        return Scanner(
            camera=self.camera.camera(),
            lasers=stack_lasers([one.sheet() for one in self.lasers]),
            turntable=point_up(motion, self.camera.up),
            covariance=None if self.covariance is None else self.covariance.array(),
            laser_names=tuple(one.name for one in self.lasers),
            up=self.camera.up,
        )
