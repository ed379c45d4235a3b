"""Point clouds on disk: the suffix chooses the format."""

import struct
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import jax
import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.columns import Reading
from jaxscan.files.clouds.e57 import Surroundings, write_e57, write_e57_stations
from jaxscan.files.clouds.formats import FORMATS
from jaxscan.files.clouds.header import About, StoredCloud
from jaxscan.files.clouds.points import check_cloud
from jaxscan.files.disk import Part, check_writable, open_regular, write_atomically
from jaxscan.reconstruction import PointCloud, join_clouds


Writer = Callable[[PointCloud, Part, About], None]
Reader = Callable[[BinaryIO, Reading], StoredCloud]


def _functions(prefix: str) -> dict[str, Any]:
    files = {suffix: import_module(f"jaxscan.files.clouds.{name}") for suffix, name in FORMATS.items()}
    return {suffix: getattr(file, f"{prefix}_{FORMATS[suffix]}") for suffix, file in files.items()}


WRITERS: dict[str, Writer] = _functions("write")
READERS: dict[str, Reader] = _functions("read")
_NAMED = (".npz", ".e57", ".las", ".laz", ".ptx")
TEXTS = (".txt", ".csv", ".asc", ".pts")
"""Suffixes that other programs give to tables of points: they are read as .xyz."""
_DAMAGE = (
    *(ValueError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError, MemoryError, RuntimeError),
    *(OSError, struct.error),
)


def check_cloud_path(path: Path) -> None:
    """Check that a cloud can be written under this name, before it is computed.

    Raises:
        CloudError: If the suffix is not one of `WRITERS`, or nothing can be written there.
    """
    if path.suffix.lower() not in WRITERS:
        raise CloudError(f'{path}: cannot write "{path.suffix}", known are {", ".join(WRITERS)}.')
    check_writable(path, error=CloudError)


def save_cloud(cloud: PointCloud, path: str | Path, *, calibration_digest: str = "", epsg: int | None = None) -> None:
    """Write a cloud. `load_cloud` reads it again.

    Args:
        cloud: Points [m], scanner frame.
        path: Its suffix is one of `WRITERS`. An existing file is replaced when the new one is complete.
        calibration_digest: Digest of the calibration file, stored where the format has room for it.
        epsg: Code of the coordinate reference system that the points are in, stored where the format has room for it.

    Raises:
        CloudError: If the suffix is unknown, the cloud has no valid point, the code is none in metres, or the file
            cannot be written. Then nothing has changed.
        DependencyError: If the format needs a library that is not installed.
    """
    path = Path(path)
    check_cloud_path(path)
    if not calibration_digest.isascii() or not calibration_digest.isprintable():
        raise ValueError(f"`calibration_digest` must be printable ASCII, got {calibration_digest!r}.")
    _write(cloud, path, About(calibration=calibration_digest, epsg=epsg), WRITERS[path.suffix.lower()])


def save_cloud_with_pictures(stored: StoredCloud, around: Surroundings, path: Path) -> None:
    """Write the cloud of one station [m], and what is seen around it, as one E57.

    Raises:
        CloudError: As in `save_cloud`.
        DependencyError: If pye57 is not installed.
    """
    check_cloud_path(path)
    _write(stored.cloud, path, stored.about, lambda cloud, part, about: write_e57(cloud, part, about, around))


def _write(cloud: PointCloud, path: Path, about: About, writer: Writer) -> None:
    host = jax.tree.map(np.asarray, cloud)
    try:
        check_cloud(host)
    except CloudError as problem:
        raise CloudError(f"{path}: {problem}") from problem
    write_atomically(path, lambda part: writer(host, part, about), error=CloudError)


def save_clouds(
    stations: Sequence[tuple[PointCloud, np.ndarray, np.ndarray]], path: str | Path, *, calibration_digest: str = ""
) -> None:
    """Write the clouds of several stations as one: E57 and PTX as a scan each with its pose, others joined.

    Args:
        stations: The cloud of each in its own scanner frame [m], T_room_scanner [4, 4], and the covariance [6, 6] of a
            step (translation [m], rotation [rad]) in its own frame.
        path, calibration_digest: As in `save_cloud`.

    Raises:
        CloudError: As in `save_cloud`, or if the clouds are not of one camera.
        DependencyError: If the format needs a library that is not installed.
    """
    clouds, poses, covariances = zip(*stations, strict=True) if stations else ((), (), ())
    save_cloud(join_clouds(clouds, poses, covariances), path, calibration_digest=calibration_digest)


def save_stations(
    stations: Sequence[Callable[[], PointCloud]], path: str | Path, *, calibration_digest: str = ""
) -> None:
    """Write the clouds of several stations as one E57, a scan each with its pose; one is in memory at a time.

    Args:
        stations: Each gives the cloud of one station, in the frame of the room, with its pose. It is called twice.
        path: Its suffix is .e57. An existing file is replaced when the new one is complete.
        calibration_digest: As in `save_cloud`.

    Raises:
        CloudError: As in `save_cloud`.
        DependencyError: If pye57 is not installed.
    """
    path = Path(path)
    check_cloud_path(path)
    about = About(calibration=calibration_digest)
    write_atomically(path, lambda part: write_e57_stations(stations, part, about), error=CloudError)


def load_cloud(path: str | Path) -> PointCloud:
    """Read a cloud, of this library or of another program.

    `jaxscan.api.read_cloud` also gives what was decided about the columns, the colours and the unit of another
    program's file, and `jaxscan.files.clouds.in_metres` scales the cloud by it.

    Args:
        path: Its suffix is one of `READERS` or `TEXTS`.

    Returns:
        The cloud on its grid, NumPy arrays. A cloud of another program has one profile unless its format has a grid,
        in its own unit and frame; what it lacks is zero, and named by `lacks`. Coordinates are float64
        where the file holds doubles.

    Raises:
        CloudError: If the suffix is unknown, or the file is missing or damaged.
        DependencyError: If the format needs a library that is not installed.
    """
    return read_cloud(path).cloud


def read_cloud(path: str | Path, reading: Reading | None = None) -> StoredCloud:
    """Read a cloud as `load_cloud` does, and what its file says beside the points.

    Args:
        reading: What a person says of the columns and colours of another program's file.

    Raises:
        CloudError: As in `load_cloud`, or if the columns are not those of the file.
        DependencyError: As in `load_cloud`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    reader = READERS.get(".xyz" if suffix in TEXTS else suffix)
    if reader is None:
        raise CloudError(f'{path}: cannot read "{path.suffix}", known are {", ".join((*READERS, *TEXTS))}.')
    reading = reading or Reading()
    if reading.columns and suffix in _NAMED:
        raise CloudError(f"{path}: the columns of {suffix} are named by the format; leave --columns out.")
    with open_regular(path, error=CloudError) as file:
        try:
            # Numbers that are too large for their column become infinite, and are refused by the last check.
            with np.errstate(over="ignore", invalid="ignore"):
                stored = reader(file, reading)
            check_cloud(stored.cloud)
        except CloudError as problem:
            # What reads archives and XML names the file itself.
            said = str(problem)
            raise CloudError(said if said.startswith(f"{path}: ") else f"{path}: {said}") from problem
        except _DAMAGE as problem:
            reason = (str(problem).splitlines() or [type(problem).__name__])[0].removesuffix(".")
            raise CloudError(f"{path}: not a readable {suffix} file: {reason:.100}.") from problem
    return stored
