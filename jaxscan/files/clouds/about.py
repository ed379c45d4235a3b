"""The statements of a cloud's file beside its points, as lines of text in a header."""

import re
from collections.abc import Iterable
from typing import NamedTuple

from jaxscan.errors import CloudError
from jaxscan.files.clouds.stations import station_lines
from jaxscan.reconstruction import MAY_LACK, PointCloud, Stations


CLOUD_FORMAT, JOINED_FORMAT = "jaxscan-cloud/1", "jaxscan-cloud/2"
"""Of the cloud of one station, and of a joined one: a reader of the first would take its frame for a scanner's."""

_FORMAT_WORD = "jaxscan-cloud/"
_CRS = re.compile(r"EPSG:(\d{1,6})\Z")


METRE = (1.0, 1.0, 1.0)
"""Unit of x, y and z of all our files."""


class About(NamedTuple):
    """The statements of a cloud's file beside its points."""

    calibration: str = ""
    """Digest of the calibration file that the cloud was made with; empty where it is not known."""
    epsg: int | None = None
    """Code of the coordinate reference system; None where the frame is that of a scanner or a room."""
    metres: tuple[float, float, float] | None = None
    """Metres that a unit of x, y and z is, where the file or its format says it."""
    unit_by: str = ""
    """What says it, or why nothing does."""
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
    profiles, lines = cloud.valid.shape
    return lines_of_grid((profiles, lines), cloud.stations, about, cloud.lacks)


def lines_of_grid(
    grid: tuple[int, int], stations: Stations | None, about: About, lacks: tuple[str, ...] = ()
) -> list[str]:
    """The same of a cloud that is not in memory: of its profiles and lines, and its stations."""
    version, frame = (CLOUD_FORMAT, "scanner") if stations is None else (JOINED_FORMAT, "room")
    found = [version, "unit metre", f"frame {frame}", f"grid {grid[0]} {grid[1]}"]
    found += [f"lacks {' '.join(lacks)}"] if lacks else []
    found += [f"calibration {about.calibration}"] if about.calibration else []
    found += [f"crs EPSG:{about.epsg}"] if about.epsg is not None else []
    return found + ([] if stations is None else station_lines(stations))


def format_of(cloud: PointCloud) -> str:
    """The format's number: a joined cloud has its own."""
    return CLOUD_FORMAT if cloud.stations is None else JOINED_FORMAT


def frame_of(cloud: PointCloud) -> str:
    """The frame of the points, in the words of file headers."""
    return "scanner" if cloud.stations is None else "room"


def version_of(lines: Iterable[str], name: str) -> str:
    """The format that the lines of a file name; empty where it is not one of ours.

    Raises:
        CloudError: If it is newer than this code.
    """
    found = next((line for line in lines if line.startswith(_FORMAT_WORD)), "")
    if found not in ("", CLOUD_FORMAT, JOINED_FORMAT):
        raise CloudError(
            f"{name}: found {found[:60]}, expected {CLOUD_FORMAT} or {JOINED_FORMAT}; a newer version of jaxscan "
            "reads it."
        )
    return found


def lacking(lines: Iterable[str]) -> tuple[str, ...]:
    """What the lines of one of our files say that its cloud does not have."""
    words = next((line.split()[1:] for line in lines if line.startswith("lacks ")), [])
    return tuple(name for name in MAY_LACK if name in words)


def about_of(lines: Iterable[str]) -> About:
    """What the lines of a file say; nothing where they are not ours."""
    words = {line.partition(" ")[0]: line.partition(" ")[2] for line in lines}
    ours = any(word.startswith(_FORMAT_WORD) for word in words)
    if not ours:
        return About()
    crs = _CRS.match(words.get("crs", ""))
    digest = words.get("calibration", "")
    return About(
        calibration=digest if digest.isascii() and digest.isprintable() else "",
        epsg=int(crs[1]) if crs else None,
        metres=METRE if words.get("unit") == "metre" else None,
        upright=True,
    )
