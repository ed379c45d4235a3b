"""The statements of a cloud's file beside its points, as lines of text in a header: frame, unit, stations, seal."""

import hashlib
import os
import re
from collections.abc import Iterable
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.disk import Part
from jaxscan.geometry import Array
from jaxscan.reconstruction import MAY_LACK, PointCloud, Stations


_TRIANGLE = np.triu_indices(6)
_POSE, _COVARIANCE = 12, len(_TRIANGLE[0])


def station_lines(stations: Stations) -> list[str]:
    """Two lines for each station: its number and T_room_scanner by rows without the last; its covariance.

    MeshLab opens no file with a longer line than 509 bytes.
    """
    lines = []
    for number, (pose, covariance) in enumerate(zip(stations.pose, stations.covariance, strict=True)):
        lines.append(f"station {number} {' '.join(f'{x:.17g}' for x in np.asarray(pose, np.float64)[:3].ravel())}")
        lines.append(f"station-covariance {number} {covariance_text(covariance)}")
    return lines


def read_stations(lines: Iterable[str], number: np.ndarray) -> Stations:
    """The stations of `station_lines`, in their order, with that of each profile."""
    poses: list[np.ndarray] = []
    covariances: list[np.ndarray] = []
    for line in lines:
        kind, *words = line.split() or [""]
        if kind not in ("station", "station-covariance"):
            continue
        # In files of an earlier version the line of a station also holds its covariance.
        counts = (_POSE, _POSE + _COVARIANCE) if kind == "station" else (_COVARIANCE,)
        expected = len(poses) if kind == "station" else len(poses) - 1
        try:
            values = [float(word) for word in words[1:]]
        except ValueError:
            values = []
        if words[:1] != [str(expected)] or len(values) not in counts or not np.isfinite(values).all():
            raise CloudError(f'the comment "{kind} {expected}" is missing or wrong: found "{line[:60]}".')
        if kind == "station":
            pose = np.eye(4)
            pose[:3] = np.reshape(values[:_POSE], (3, 4))
            poses.append(pose)
            covariances.append(_symmetric(values[_POSE:] or [0.0] * _COVARIANCE))
        else:
            covariances[-1] = _symmetric(values)
    if not poses:
        raise CloudError('the comments "station" are missing, with the poses of a joined cloud.')
    return Stations(number, np.array(poses), np.array(covariances))


def _symmetric(triangle: list[float]) -> np.ndarray:
    covariance = np.zeros((6, 6))
    covariance[_TRIANGLE] = triangle
    covariance.T[_TRIANGLE] = triangle
    return covariance


def covariance_text(covariance: Array) -> str:
    """The upper triangle of a covariance [6, 6], by rows."""
    return " ".join(f"{value:.9g}" for value in np.asarray(covariance, np.float64)[_TRIANGLE])


CLOUD_FORMAT, JOINED_FORMAT = "jaxscan-cloud/1", "jaxscan-cloud/2"
"""Formats of the cloud of one station and of a joined one, whose frame is a room's and not a scanner's."""

_FORMAT_WORD = "jaxscan-cloud/"
_CRS = re.compile(r"EPSG:(\d{1,6})\Z")


METRE = (1.0, 1.0, 1.0)


class About(NamedTuple):
    """The statements of a cloud's file beside its points."""

    calibration: str = ""
    """Digest of the calibration file that the cloud was made with; empty where it is not known."""
    epsg: int | None = None
    """Code of the coordinate reference system; None where the frame is that of a scanner or a room."""
    metres: tuple[float, float, float] | None = None
    """Metres that a unit of x, y and z is, where the file or its format says it."""
    unit_by: str = ""
    """Evidence for the unit, or why there is none."""
    in_degrees: bool = False
    """Whether the file says that x and y are degrees of longitude and latitude."""
    upright: bool = False
    """Whether the file, or its format, says that z is up."""

    @property
    def in_metres(self) -> bool:
        """Whether the file, or its format, says that its unit is the metre."""
        return self.metres == METRE


class StoredCloud(NamedTuple):
    """A cloud as a file holds it."""

    cloud: PointCloud
    about: About
    words: tuple[str, ...] = ()
    """What was decided about the columns of another program's file, with its evidence."""


def header_lines(cloud: PointCloud, about: About) -> list[str]:
    """The lines with which our files begin: format, unit, frame, grid, and where known calibration, CRS, stations."""
    return lines_of_grid(cloud.valid.shape, cloud.stations, about, cloud.lacks)


def lines_of_grid(
    grid: tuple[int, ...], stations: Stations | None, about: About, lacks: tuple[str, ...] = ()
) -> list[str]:
    """The header lines of a cloud that is not in memory, by its numbers of profiles and lines and its stations."""
    found = [format_of(stations), "unit metre", f"frame {frame_of(stations)}", f"grid {grid[0]} {grid[1]}"]
    found += [f"lacks {' '.join(lacks)}"] if lacks else []
    found += [f"calibration {about.calibration}"] if about.calibration else []
    found += [f"crs EPSG:{about.epsg}"] if about.epsg is not None else []
    return found + ([] if stations is None else station_lines(stations))


def format_of(stations: Stations | None) -> str:
    """The format's number: a joined cloud has its own."""
    return CLOUD_FORMAT if stations is None else JOINED_FORMAT


def frame_of(stations: Stations | None) -> str:
    """The frame of the points, in the words of file headers."""
    return "scanner" if stations is None else "room"


def version_of(lines: Iterable[str]) -> str:
    """The format that the lines of a file name; empty where it is not one of ours."""
    found = next((line for line in lines if line.startswith(_FORMAT_WORD)), "")
    if found not in ("", CLOUD_FORMAT, JOINED_FORMAT):
        raise CloudError(
            f"found {found[:60]}, expected {CLOUD_FORMAT} or {JOINED_FORMAT}; a newer version of jaxscan reads it."
        )
    return found


def lacking(lines: Iterable[str]) -> tuple[str, ...]:
    """Fields that the header of one of our files lists as lacking."""
    words = next((line.split()[1:] for line in lines if line.startswith("lacks ")), [])
    return tuple(name for name in MAY_LACK if name in words)


def about_of(lines: Iterable[str]) -> About:
    """Parse header lines; an empty `About` where they are not ours."""
    words = {line.partition(" ")[0]: line.partition(" ")[2] for line in lines}
    if not any(word.startswith(_FORMAT_WORD) for word in words):
        return About()
    crs, digest = _CRS.match(words.get("crs", "")), words.get("calibration", "")
    return About(
        calibration=digest if digest.isascii() and digest.isprintable() else "",
        epsg=int(crs[1]) if crs else None,
        metres=METRE if words.get("unit") == "metre" else None,
        upright=True,
    )


# A line in the header of a cloud that tells whether the file is still as it was written: formats without checksums.
#
# The line holds the file's size and a digest of all its bytes, taken with zeros in the place of the digest. A program
# that keeps the comments but writes a header of its own makes a file of another size, of which the line says nothing; a
# file of the same size that differs is damaged, or was edited in place.

_DIGEST_BYTES, _SIZE_DIGITS = 16, 15
_HEAD_BYTES = 64 << 10
_BLOCK_BYTES = 1 << 20
_LINE = re.compile(rb"seal blake2b ([0-9a-f]{%d}) of ([0-9]{%d}) bytes\r?\n" % (2 * _DIGEST_BYTES, _SIZE_DIGITS))

SEAL_LINE = f"seal blake2b {'0' * 2 * _DIGEST_BYTES} of {'0' * _SIZE_DIGITS} bytes"
"""Comment for a header, whose numbers `seal` fills in."""


def seal(path: Part) -> None:
    """Fill in the `SEAL_LINE` of a file that is complete; it is read once, a block at a time."""
    with open(path, "r+b") as file:
        found = _LINE.search(file.read(_HEAD_BYTES))
        if found is None:
            raise ValueError(f"{path} has no line to fill in.")
        file.seek(found.start(2))
        file.write(f"{os.fstat(file.fileno()).st_size:0{_SIZE_DIGITS}d}".encode())
        digest = _digest(file, found.start(1))
        file.seek(found.start(1))
        file.write(digest.encode())


def check_seal(file: BinaryIO) -> None:
    """Compare a file with the line in its header; one without it, or of another size, is that of another program.

    The file is at its beginning afterwards.
    """
    found = _LINE.search(file.read(_HEAD_BYTES))
    if found is not None and int(found[2]) == os.fstat(file.fileno()).st_size:
        digest = _digest(file, found.start(1))
        if digest != found[1].decode():
            raise CloudError(
                f"has changed since it was written: found digest {digest}, expected {found[1].decode()}; copy or write "
                'it anew, or take the comment "seal ..." out of its header if you have edited it.'
            )
    file.seek(0)


def _digest(file: BinaryIO, place: int) -> str:
    """Digest of the whole file, as if zeros were at the place of its own digest."""
    digits = 2 * _DIGEST_BYTES
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    file.seek(0)
    digest.update(file.read(place) + b"0" * digits)
    file.seek(place + digits)
    while block := file.read(_BLOCK_BYTES):
        digest.update(block)
    return digest.hexdigest()
