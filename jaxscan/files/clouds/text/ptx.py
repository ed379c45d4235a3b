"""PTX: text that keeps the grid, with the pose of every station."""

import numpy as np

from jaxscan.files.clouds.about import About
from jaxscan.files.disk import Part
from jaxscan.reconstruction import PointCloud, of_station


# A micrometre is far below any scanner's noise, and near the resolution of float32.
_LINE, _COLOUR = "%.6f %.6f %.6f %.6f", " %d %d %d"
_HOLE = "0 0 0 0.500000"
_UNKNOWN = 0.5
"""Intensity of points that have none, as other scanners write it: the format has no line without."""
_SAMPLES = 200_000
_AT_ONCE = 1 << 15


def write_ptx(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the whole grid, a block per station and laser: `x y z intensity r g b`, holes as zeros.

    Without colours it is `x y z intensity`; without intensity that is 0.5.

    Columns are profiles. As in files of other scanners a column runs upwards, and columns follow one another to the
    right as seen from the scanner: programs take the side of a surface from that. Points are in the scanner frame of
    the station, whose pose heads the block.
    """
    poses = np.eye(4)[None] if cloud.stations is None else np.asarray(cloud.stations.pose, np.float64)
    # The format's intensity is between 0 and 1; an amplitude may exceed the range of a pixel.
    brightest = max(255.0, float(np.max(cloud.intensity, where=np.asarray(cloud.valid), initial=0)))
    with open(path, "w", encoding="ascii", newline="\n") as file:
        for number, pose in enumerate(poses):
            station = of_station(cloud, number)
            for laser in np.unique(np.asarray(station.laser)):
                profiles = np.flatnonzero(np.asarray(station.laser) == laser)
                file.write(f"{len(profiles)}\n{station.valid.shape[1]}\n" + _pose_text(pose))
                down, left = _directions(station, profiles)
                for profile in profiles[::-1] if left else profiles:
                    for part in _parts(station.valid.shape[1], reverse=down):
                        file.writelines(_column(station, int(profile), part, brightest)[:: -1 if down else 1])


def _pose_text(pose: np.ndarray) -> str:
    """Place and axes of the scanner, and the motion for rows of coordinates: the transpose of T_room_scanner."""
    rows = (pose[:3, 3], *pose[:3, :3].T, *pose.T)
    return "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in rows)


def _directions(cloud: PointCloud, profiles: np.ndarray) -> tuple[bool, bool]:
    """Whether lines run downwards along most of the profiles, and most profiles follow one another to the left."""
    stride = max(1, cloud.valid[:1].size * len(profiles) // _SAMPLES)
    chosen = profiles[: -1 if len(profiles) > 1 else None : stride]
    following = profiles[1:][::stride] if len(profiles) > 1 else chosen
    # As in most images, lines run downwards where the points do not tell.
    rises, right = 0.0, 0.0
    for first, second in zip(chosen, following, strict=True):
        for part in _parts(cloud.valid.shape[1] - 1):
            start, stop = part.start, part.stop
            p, q = (np.asarray(cloud.xyz[one, start : stop + 1], np.float64) for one in (first, second))
            seen, seen_next = (np.asarray(cloud.valid[one, start : stop + 1]) for one in (first, second))
            along = p[1:] - p[:-1]
            both = seen[1:] & seen[:-1]
            rises += np.sign(along[..., 2][both]).sum()
            triple = both & seen_next[:-1]
            # To the right, then along the line, is a right-handed turn about the way back to the scanner if it rises.
            turn = np.cross((q - p)[:-1][triple], along[triple])
            right -= np.sign(np.einsum("ij,ij->i", turn, p[:-1][triple])).sum()
    down = bool(rises <= 0)
    return down, bool((-right if down else right) < 0)


def _parts(lines: int, *, reverse: bool = False) -> list[slice]:
    """Lines that are looked at together: as words and numbers of Python each takes ten times the memory."""
    parts = [slice(start, min(start + _AT_ONCE, lines)) for start in range(0, lines, _AT_ONCE)]
    return parts[::-1] if reverse else parts


def _column(cloud: PointCloud, profile: int, part: slice, brightest: float) -> list[str]:
    """Lines of a profile, from the first to the last of them."""
    seen_of, places, levels, colours = (
        np.asarray(field[profile, part]) for field in (cloud.valid, cloud.xyz, cloud.intensity, cloud.rgb)
    )
    levels = np.full(levels.shape, _UNKNOWN) if "intensity" in cloud.lacks else np.clip(levels / brightest, 0.0, 1.0)
    rows = zip(*(field.tolist() for field in (seen_of, places, levels, colours)), strict=True)
    if "rgb" in cloud.lacks:
        line, hole = f"{_LINE}\n", f"{_HOLE}\n"
        return [line % (*xyz, level) if seen else hole for seen, xyz, level, _ in rows]
    line, hole = f"{_LINE}{_COLOUR}\n", f"{_HOLE} 0 0 0\n"
    return [line % (*xyz, level, *rgb) if seen else hole for seen, xyz, level, rgb in rows]
