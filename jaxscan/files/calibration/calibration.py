"""Calibration files: their tables, as they are checked when they are read, and the observations beside them."""

import dataclasses
import functools
import hashlib
import json
import math
import operator
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

import jax
import numpy as np
import pydantic

from jaxscan.calibration import Calibration, CalibrationSettings, Quality
from jaxscan.errors import CalibrationError
from jaxscan.files.capture import BoardTable
from jaxscan.files.disk import (
    MEGABYTE,
    FileModel,
    ImageSize,
    Number,
    Part,
    check,
    check_arrays,
    check_writable,
    file_digest,
    parse_json,
    read_arrays,
    read_bounded,
    readable_json,
    write_arrays,
    write_together,
)
from jaxscan.geometry import (
    CAMERAS,
    MOTIONS,
    AbstractCamera,
    AbstractMotion,
    Carries,
    LaserSheet,
    Scanner,
    Still,
    Turntable,
    camera_doubts,
    is_pose,
    motion_class,
    motion_of,
    point_up,
    scanner_doubts,
    stack_lasers,
)
from jaxscan.geometry.rigid import UNIT_TOLERANCE, check_frame
from jaxscan.geometry.scanner import UP_VECTORS, Up
from jaxscan.observation import CONTRAST_CLASSES, BoardViews, Observations, StripeViews


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


def _motion_tables() -> dict[str, Any]:
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
        Union[tuple(Annotated[table, pydantic.Tag(part)] for part, table in _motion_tables().items())],  # noqa: UP007
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
        # The matrix is checked as correlations, so that px and rad are judged alike; a parameter held fixed has no row.
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


# Calibrations on disk: JSON that people read, and the observations beside it, so that anyone can solve again.


# Larger numbers are nonsense, and formatting and arithmetic would fail.
_LARGEST, _LARGEST_INTEGER, _DEEPEST = 1e100, 2**53, 20


def quality_table(quality: Quality) -> dict[str, Any]:
    """The quality as JSON; keys without a value are left out."""
    if quality == Quality():
        return {}
    known = lambda items: {key: value for key, value in items if value is not None}
    return finite(dataclasses.asdict(quality, dict_factory=known))


def read_quality(table: dict[str, Any]) -> Quality:
    """The quality from the table of a file.

    A key whose value has the wrong type counts as missing, and unknown keys are ignored: a calibration
    can be used even if the quality in its file is damaged.
    """
    known = {}
    for key, value in table.items():
        try:
            if key in Quality.__dataclass_fields__ and _is_usable(value):
                # Strict JSON: no number in quotes, no truth value as a number, but a list for a tuple.
                alone = _adapter().validate_json(json.dumps({key: value}), strict=True)
                known[key] = getattr(alone, key)
        except pydantic.ValidationError:
            continue
    return Quality(**known)


_adapter = functools.cache(lambda: pydantic.TypeAdapter(Quality))


def _is_usable(value: Any, depth: int = 0) -> bool:
    """Whether a JSON value is not nested too deeply, and its numbers are not too large."""
    if isinstance(value, dict | list):
        items = value.values() if isinstance(value, dict) else value
        return depth < _DEEPEST and all(_is_usable(item, depth + 1) for item in items)
    return not isinstance(value, int | float) or abs(value) <= (_LARGEST_INTEGER if type(value) is int else _LARGEST)


def finite(value: Any) -> Any:
    """The same value with null for numbers that are not finite, which JSON cannot hold (a prior switched off)."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# The file may come from anyone, so the length of the solve is bounded.
_MAX_STEPS = 10_000


def stored_settings(provenance: dict[str, Any], *, name: str) -> CalibrationSettings:
    """Settings from the provenance of a calibration; keys that an older file lacks have their defaults.

    Raises:
        CalibrationError: With the key, if a value is not allowed.
    """
    settings = provenance.get("settings", {})
    if not isinstance(settings, dict):
        raise CalibrationError(f"{name}: provenance.settings: found {settings!r:.60}, expected a table.")
    priors = settings.get("priors", {})
    if isinstance(priors, dict):
        # JSON has no infinity: a prior that is switched off is written as null.
        priors = {key: math.inf if value is None else value for key, value in priors.items()}
    try:
        found = pydantic.TypeAdapter(CalibrationSettings).validate_python({**settings, "priors": priors})
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        key = ".".join(str(part) for part in ("provenance", "settings", *first["loc"]))
        raise CalibrationError(f"{name}: {key[:90]}: found {first['input']!r:.60}, {first['msg']}.") from None
    numbers = (found.huber, found.reject_any, found.reject_all, *found.priors.values())
    if not all(number > 0 for number in numbers) or not 1 <= found.max_steps <= _MAX_STEPS:
        raise CalibrationError(
            f"{name}: provenance.settings: priors and thresholds must be above 0, and max_steps 1 to {_MAX_STEPS}."
        )
    return found


OBSERVATIONS_FORMAT: Literal["jaxscan-observations/1"] = "jaxscan-observations/1"
MAX_ARRAY_BYTES = 1 << 30

_ARRAYS: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "corners.q": (np.floating, ("views", "corners", 2)),
    "corners.sigma": (np.floating, ("views", "corners")),
    "corners.valid": (np.bool_, ("views", "corners")),
    "corners.angle": (np.floating, ("views",)),
    "corners.placement": (np.signedinteger, ("views",)),
    "corners.record": (np.signedinteger, ("views",)),
    "stripes.q": (np.floating, ("stripes", "points", 2)),
    "stripes.sigma": (np.floating, ("stripes", "points")),
    "stripes.valid": (np.bool_, ("stripes", "points")),
    "stripes.view": (np.signedinteger, ("stripes",)),
    "stripes.laser": (np.signedinteger, ("stripes",)),
}
_OPTIONAL: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "stripes.contrast": (np.signedinteger, ("stripes", "points")),
    "poses": (np.floating, ("records", 4, 4)),
}
_RANGES = {
    "corners.q": (-1e6, 1e6),
    "corners.sigma": (1e-6, 1e6),
    "corners.angle": (-1e6, 1e6),
    "stripes.q": (-1e6, 1e6),
    "stripes.sigma": (1e-6, 1e6),
}
"""Limits of the numbers of valid points [px, rad]: squares of others would not be finite."""
# Fields of `Observations` that are stored as they are, as JSON.
_PLAIN = ("width", "height", "laser_names", "up", "carries")


_LENGTHS = ("square", "marker", "diameter", "tag")
_NAMES = {"circles": {"square": "spacing"}, "aprilgrid": {"square": "gap"}}
"""Names of fields in the tables of captures, where they have others."""


def _in_millimetres(board: Any) -> Any:
    """A board with lengths in metres, as in this file, as the table of all other files, in millimetres."""
    if not isinstance(board, dict):
        return board
    lengths = {key: board[key] for key in _LENGTHS if isinstance(board.get(key), int | float)}
    others = {key: value for key, value in board.items() if key not in lengths}
    names = _NAMES.get(str(board.get("type")), {})
    return others | {f"{names.get(key, key)}_mm": 1000 * value for key, value in lengths.items()}


class _About(ImageSize):
    """The fields that are not arrays, as JSON; lengths in metres."""

    format: Literal["jaxscan-observations/1"]
    board: Annotated[BoardTable, pydantic.BeforeValidator(_in_millimetres)]
    laser_names: tuple[str, ...]
    up: Up
    carries: Carries


def observations_path(path: Path) -> Path:
    """The file of the observations that belong to a calibration file."""
    return path.with_suffix(".npz")


def _observations_writer(observations: Observations, path: Path) -> Callable[[Part], None]:
    """The function that writes the observations to a file, which is then to be renamed to `path`."""
    board = {"type": type(observations.board).__name__.lower(), **vars(observations.board)}
    about = {"format": OBSERVATIONS_FORMAT, "board": board}
    about |= {name: getattr(observations, name) for name in _PLAIN}
    # The same checks as on reading: a board may be of a kind that files do not know.
    check(_About, about, name=str(path), error=CalibrationError)
    every = {name: operator.attrgetter(name)(observations) for name in (*_ARRAYS, *_OPTIONAL)}
    arrays = {name: np.asarray(values) for name, values in every.items() if values is not None}
    return lambda part: write_arrays(part, {"about": np.array(readable_json(about)), **arrays})


def _holds_observations(path: Path) -> bool:
    about = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES, only="about").get("about")
    return about is not None and OBSERVATIONS_FORMAT in str(about)


def _is_observations(path: Path) -> bool:
    """Whether a file holds observations; False for a damaged file."""
    try:
        return _holds_observations(path)
    except CalibrationError:
        return False


def _observations_in(path: Path) -> Observations | None:
    """The observations in a file beside a calibration; None where it holds something else."""
    try:
        return _read_observations(path) if _holds_observations(path) else None
    except CalibrationError as problem:
        reason = str(problem).removeprefix(f"{path}: ").removesuffix(".")
        raise CalibrationError(
            f"{path}: the observations are damaged ({reason}): restore the file, or move it away to use the "
            "calibration without observations."
        ) from problem


def _read_observations(path: Path) -> Observations:
    arrays = read_arrays(path, error=CalibrationError, limit=MAX_ARRAY_BYTES)
    value = parse_json(str(arrays.get("about", "null")).encode(), name=str(path), error=CalibrationError)
    about = check(_About, value, name=str(path), error=CalibrationError)
    board = about.board.board()
    known = {"corners": len(board.corners())}
    there = _ARRAYS | {name: kind for name, kind in _OPTIONAL.items() if name in arrays}
    sizes = check_arrays(arrays, there, known, name=str(path), error=CalibrationError)
    counts = {"stripes.view": sizes["views"], "stripes.laser": len(about.laser_names)}
    # Indices of all entries: those of points that are not valid are looked up too.
    for name, count in (
        counts | {name: CONTRAST_CLASSES for name in _OPTIONAL if name in arrays and name != "poses"}
    ).items():
        if ((arrays[name] < 0) | (arrays[name] >= count)).any():
            raise CalibrationError(f"{path}: {name}: found an index outside 0 ... {count - 1}.")
    for name, (least, most) in _RANGES.items():
        values, valid = arrays[name], arrays.get(f"{name.split('.')[0]}.valid")
        seen = values if valid is None or values.ndim < valid.ndim else values[valid]
        if not ((seen >= least) & (seen <= most)).all():
            raise CalibrationError(f"{path}: {name}: found a number outside {least:g} ... {most:g}.")
    corners, stripes = (
        {name.removeprefix(part): arrays[name] for name in there if name.startswith(part)}
        for part in ("corners.", "stripes.")
    )
    return Observations(
        board=board,
        corners=BoardViews(**corners),
        stripes=StripeViews(**stripes),
        poses=_poses_of(arrays, about.carries, path),
        **{name: getattr(about, name) for name in _PLAIN},
    )


def _poses_of(arrays: Mapping[str, np.ndarray], carries: Carries, path: Path) -> np.ndarray | None:
    """The poses of the hand in a file of observations."""
    if MOTIONS[carries].unit != "pose":
        return None
    poses, angle = arrays.get("poses", np.zeros((0, 4, 4))), arrays["corners.angle"]
    there = not len(angle) or (angle.min() >= 0 and angle.max() < len(poses))
    if not there or not all(is_pose(pose) for pose in poses):
        raise CalibrationError(f"{path}: poses: expected a rigid pose for every view.")
    return poses


_DIGESTS = "digests"


def _digests_of(tables: Mapping[str, Any], observations: Path | None = None) -> dict[str, str]:
    """The table of digests of a calibration file, of all other tables and the file of its observations."""
    digests = {"values": _values_digest(tables)}
    if observations is not None:
        digests["observations"] = file_digest(observations, error=CalibrationError)
    return digests


def _values_note(tables: Mapping[str, Any], name: str) -> str:
    """A sentence if the values of a calibration file do not match its digest; else "".

    A file without a digest, as a person writes it, gives none.
    """
    digests = tables.get(_DIGESTS)
    expected = digests.get("values") if isinstance(digests, dict) else None
    if expected is None or expected == _values_digest(tables):
        return ""
    return (
        f"{name}: its values have changed since jaxscan calibrate wrote it, so points may be wrong; calibrate again, "
        f'or, if the change is meant, remove "{_DIGESTS}" from the file.'
    )


def _require_own(table: CalibrationTable, path: Path, beside: Path, *, found: bool) -> None:
    """Refuse observations whose digest the calibration file beside them does not name."""
    digests = table.digests
    if digests is None:
        return
    if digests.observations is None:
        # A calibration without observations may have an unrelated file of that name beside it.
        own = not (found and digests.values is not None)
    else:
        own = file_digest(beside, error=CalibrationError) == digests.observations
    if not own:
        raise CalibrationError(
            f"{beside}: the observations beside {path.name} belong to another calibration or are damaged: calibrate "
            "again, copy the right file here, or move this one away to use the calibration without observations."
        )


def _values_digest(tables: Mapping[str, Any]) -> str:
    """Digest of the parsed values, so that another layout of the text does not matter."""
    values = {key: value for key, value in tables.items() if key != _DIGESTS}
    return "sha256:" + hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


MAX_CALIBRATION_BYTES = 16 * MEGABYTE


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration as `path`, and its observations, where it has any, as `<stem>.npz`.

    Args:
        calibration: Calibration of a scanner, or of a camera alone.
        path: Ends in `.json`. Existing files are replaced when the new ones are complete.

    Raises:
        CalibrationError: If it is no calibration, is inconsistent, or cannot be written.
    """
    if not isinstance(calibration, Calibration):
        remedy = "; save_scanner writes a scanner" if isinstance(calibration, Scanner) else ""
        raise CalibrationError(f"{path}: found a {type(calibration).__name__}, expected a Calibration{remedy}.")
    path = Path(path)
    check_calibration_path(path, with_observations=calibration.observations is not None)
    try:
        text = readable_json(_tables(calibration))
    except (TypeError, ValueError) as problem:
        raise CalibrationError(f"{path}: cannot be written: {problem}.") from problem
    # The same checks as on reading, on the same bytes, so that every written file can be read.
    tables = _parse(text.encode(), name=str(path))[0]
    beside = observations_path(path)
    tables[_DIGESTS] = _digests_of(tables)
    writers: dict[Path, Callable[[Part], None]] = {}
    if calibration.observations is not None:
        write = _observations_writer(calibration.observations, beside)

        def write_beside(part: Part) -> None:
            write(part)
            tables[_DIGESTS] = _digests_of(tables, part)

        writers[beside] = write_beside

    def write_own(part: Part) -> None:
        part.write_bytes(readable_json(tables).encode())

    # The names change one right after the other: a calibration with observations of another is refused.
    writers[path] = write_own
    write_together(writers, error=CalibrationError)
    if calibration.observations is None and _is_observations(beside):
        # The old observations belong to the calibration that was just replaced.
        beside.unlink()


def save_scanner(scanner: Scanner, path: str | Path) -> None:
    """Write a scanner, as of `Scanner.from_parts`, as a calibration file that `load_scanner` reads.

    Args:
        scanner: The scanner; its covariance is written where it has one.
        path: Ends in `.json`. An existing file is replaced when the new one is complete.

    Raises:
        CalibrationError: If it is no scanner, its numbers do not fit one another, or it cannot be written.
    """
    if not isinstance(scanner, Scanner):
        raise CalibrationError(f"{path}: found a {type(scanner).__name__}, expected a Scanner.")
    covariance = np.zeros((0, 0)) if scanner.covariance is None else np.asarray(scanner.covariance, np.float64)
    order = scanner.parameter_names() if covariance.size else ()
    save_calibration(Calibration(scanner.camera, scanner, order, covariance), path)


def check_calibration_path(path: str | Path, *, with_observations: bool = True) -> None:
    """Check that a calibration can be written under this name, before the solve.

    Args:
        path: The calibration file.
        with_observations: Whether observations will be written beside it.

    Raises:
        CalibrationError: If the suffix is `.npz`, which the observations have, or a file cannot be written.
    """
    if Path(path).suffix.lower() == ".npz":
        raise CalibrationError(
            f"{path}: a calibration is JSON; end its name in .json (the .npz beside it is made too)."
        )
    check_writable(path, error=CalibrationError)
    beside = observations_path(Path(path))
    if with_observations:
        check_writable(beside, error=CalibrationError)
        if os.path.exists(beside) and not _is_observations(beside):
            raise CalibrationError(
                f"{beside}: exists and holds no observations; choose another name for the calibration."
            )


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration, with its observations where they lie beside it.

    Args:
        path: The JSON file.

    Returns:
        The calibration; `scanner` is None where the file holds a camera alone, `observations`
        is None where there are none.

    Raises:
        CalibrationError: One line with the key, the value found and the values allowed; or if the observations beside
            it are not those that it names.
    """
    path = Path(path)
    table = _load(path)[1]
    scanner, covariance = table.scanner(), table.covariance
    beside, observations = observations_path(path), None
    if os.path.exists(beside):
        observations = _observations_in(beside)
        _require_own(table, path, beside, found=observations is not None)
    return Calibration(
        camera=table.camera.camera() if scanner is None else scanner.camera,
        scanner=scanner,
        order=() if covariance is None else covariance.order,
        covariance=np.zeros((0, 0)) if covariance is None else covariance.array(),
        quality=read_quality(table.quality),
        observations=observations,
        provenance=table.provenance,
    )


def load_scanner(path: str | Path) -> Scanner:
    """Read the scanner of a calibration file; the JSON alone suffices.

    Args:
        path: The JSON file.

    Returns:
        The scanner with NumPy float64 leaves, and its covariance where the file has one.

    Raises:
        CalibrationError: If the file is missing or wrong, or holds no laser sheet.
    """
    scanner = _load(path)[1].scanner()
    if scanner is None or not scanner.laser_names:
        parts = "a camera alone" if scanner is None else "camera and axis"
        raise CalibrationError(
            f"{path}: holds {parts}, without a laser sheet, so it cannot reconstruct; calibrate with a capture that "
            "has laser images, or add the sheet's plane under lasers."
        )
    return scanner


def load_parts(path: str | Path) -> tuple[AbstractCamera, Scanner | None]:
    """Camera, and sheets and motion where there are any, of a calibration file; the JSON alone suffices.

    Raises:
        CalibrationError: If the file is missing or wrong.
    """
    table = _load(path)[1]
    return table.camera.camera(), table.scanner()


def calibration_notes(path: str | Path) -> list[str]:
    """Warnings for users of a calibration file.

    Raises:
        CalibrationError: If the file is missing or wrong.
    """
    tables, table = _load(path)
    notes = [_values_note(tables, str(path))]
    if read_quality(table.quality).converged is False:
        notes.append(f"{path}: its solve did not converge, so points and their sigmas may be wrong; calibrate again.")
    if table.covariance is None and table.lasers:
        notes.append(f"{path}: has no covariance, so it counts as exact: sigmas hold the noise of the stripes alone.")
    scanner = table.scanner()
    doubts = camera_doubts(table.camera.camera()) if scanner is None else scanner_doubts(scanner)
    return [note for note in (*notes, *(f"{path}: {doubt.said}." for doubt in doubts)) if note]


def calibration_digest(path: str | Path) -> str:
    """The sha256 of a calibration file, as "sha256:<hex>", by which clouds name it.

    Raises:
        CalibrationError: If it cannot be read.
    """
    return file_digest(path, error=CalibrationError)


def _load(path: str | Path) -> tuple[dict[str, Any], CalibrationTable]:
    """A calibration file as it stands, and checked."""
    return _parse(read_bounded(path, MAX_CALIBRATION_BYTES, error=CalibrationError), name=str(path))


def _parse(data: bytes, *, name: str) -> tuple[dict[str, Any], CalibrationTable]:
    tables = parse_json(data, name=name, error=CalibrationError)
    table = check(CalibrationTable, tables, name=name, error=CalibrationError)
    if table.covariance is not None:
        found, expected = table.covariance.order, (table.scanner() or table.camera.camera()).parameter_names()
        if found != expected:
            raise CalibrationError(
                f"{name}: covariance.order: found {', '.join(found)[:60]}, expected {', '.join(expected)}."
            )
    return tables, table


def _tables(calibration: Calibration) -> dict[str, Any]:
    scanner, observations = calibration.scanner, calibration.observations
    up = scanner.up if scanner is not None else observations.up if observations is not None else "-v"
    tables: dict[str, Any] = {"format": CALIBRATION_FORMAT, "camera": CameraTable.of(calibration.camera, up)}
    if scanner is not None:
        # Numbers in the file are float64.
        scanner = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), scanner)
        sheets = scanner.lasers
        tables["lasers"] = [
            {"name": name, "normal": normal, "distance_m": distance, "bow": bow, "basis": basis}
            for name, normal, distance, bow, basis in zip(
                scanner.laser_names, sheets.normal, sheets.distance, sheets.bow, sheets.basis, strict=True
            )
        ]
        if scanner.turntable.fields:
            tables["turntable"] = scanner.turntable.table()
    tables["quality"] = quality_table(calibration.quality)
    tables["provenance"] = finite(calibration.provenance)
    if len(calibration.order) > 0:
        matrix = np.asarray(calibration.covariance, np.float64)
        tables["covariance"] = {"order": calibration.order, "scale": 1.0, "matrix": matrix}
    return tables
