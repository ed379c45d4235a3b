"""LAS 1.4 and LAZ, the formats of surveying, through laspy; with the uncertainty of every point."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.about import About, frame_of, header_lines
from jaxscan.files.clouds.crs import LOCAL_WKT, wkt_of
from jaxscan.files.clouds.las.library import load_laspy
from jaxscan.files.clouds.points import blocks, columns, known_names, smoothed_names
from jaxscan.files.disk import Part
from jaxscan.reconstruction import CloudPoints, PointCloud


SCALE_M = 1e-4
"""Step of the stored coordinates: a tenth of a millimetre."""
COARSEST_M = 1e-3
"""Largest step, for clouds of more than 429 km."""
_STEPS = (1 << 31) - 1
"""Largest stored number of steps from the offset."""
HEADER_RECORD = ("jaxscan", 1)
"""User and number of the record that holds the lines of `header_lines`."""
_EXTRA = {
    "amplitude": "of the stripe [DN]",
    "sigma": "std. dev. along ray [m]",
    "sigma_random": "part by the noise [m]",
    "sigma_systematic": "shared part [m]",
    "normal_x": "towards the camera",
    "normal_y": "towards the camera",
    "normal_z": "towards the camera",
    "step": "profile of the grid",
    "row": "line of the grid",
    "angle": "of the profile [rad]",
    "record": "of the capture",
}
_STATION_EXTRA = {"station": "place of the scanner"}
_TYPES = {"step": np.int32, "row": np.int32, "record": np.int32, "angle": np.float64, "station": np.uint8}
"""Of extra bytes that are no float32."""
_SMOOTHED_EXTRA = {
    "sigma_row": "noise, of the row alone [m]",
    "shift_px": "centre of the row - this [px]",
    "shared_lines": "lines that share its noise",
}


def write_las(cloud: PointCloud, path: Part, about: About) -> None:
    """Write the valid points: point format 7, colours and intensity in 16 bit, extra bytes, the frame as WKT.

    The suffix `.laz` compresses. Intensity is the amplitude in 1/257 DN, or coarser where the largest would not fit;
    the extra bytes hold it in DN. A record of our own holds digest, grid and stations.

    Raises:
        CloudError: If the points are too far apart for the format, or the EPSG code is none in metres.
        DependencyError: If laspy, or lazrs for `.laz`, or pyproj for a code, is not installed.
    """
    laspy = load_laspy(compressed=path.suffix.lower() == ".laz")
    # Without colours, point format 6.
    header = laspy.LasHeader(point_format=6 if "rgb" in cloud.lacks else 7, version="1.4")
    header.offsets, header.scales = _placed(cloud)
    header.generating_software = "jaxscan"
    # Point formats 6 to 10 have their frame as WKT.
    header.global_encoding.wkt = True
    wkt = LOCAL_WKT.format(frame=frame_of(cloud)) if about.epsg is None else wkt_of(about.epsg)
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    text = "\n".join(header_lines(cloud, about)).encode("ascii")
    header.vlrs.append(laspy.VLR(*HEADER_RECORD, "header of the cloud", text))
    extra = {name: _EXTRA[name] for name in known_names(_EXTRA, cloud)} | {
        name: _SMOOTHED_EXTRA[name] for name in smoothed_names(cloud)
    }
    extra |= {} if cloud.stations is None else _STATION_EXTRA
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, _TYPES.get(name, np.float32), description) for name, description in extra.items()]
    )
    brightest = (
        0.0 if "intensity" in cloud.lacks else float(np.max(cloud.intensity, where=cloud.valid, initial=-np.inf))
    )
    scale = 257.0 if brightest <= 255 else 65535 / brightest
    try:
        # Opened here, for the writer leaves its file open where the disk is full.
        with (
            open(path, "w+b") as file,
            laspy.LasWriter(file, header, do_compress=path.suffix.lower() == ".laz", closefd=False) as writer,
        ):
            for points in blocks(cloud):
                writer.write_points(_record(laspy, header, points, cloud, list(extra), scale))
    except Exception as problem:
        # lazrs, which is loaded for compressed points alone, has an error of its own for a disk that takes no more.
        if type(problem).__name__ != "LazrsError":
            raise
        raise OSError(f"the points cannot be packed onto the disk ({problem})") from problem


def _record(laspy: Any, header: Any, points: CloudPoints, cloud: PointCloud, extra: Sequence[str], scale: float) -> Any:
    values = columns(points, cloud)
    values |= {"amplitude": points.intensity}
    values |= {f"normal_{axis}": values[f"n{axis}"] for axis in "xyz"}
    record = laspy.ScaleAwarePointRecord.zeros(len(points.step), header=header)
    for axis, places in zip("xyz", points.xyz.astype(np.float64).T, strict=True):
        record[axis] = places
    if "rgb" not in cloud.lacks:
        for name, colours in zip(
            ("red", "green", "blue"), points.rgb.astype(np.uint16).T * np.uint16(257), strict=True
        ):
            record[name] = colours
    record["intensity"] = np.clip(np.round(points.intensity.astype(np.float64) * scale), 0, 65535).astype(np.uint16)
    record["return_number"] = record["number_of_returns"] = np.ones(len(points.step), np.uint8)
    record["user_data"] = points.laser
    for name in extra:
        record[name] = values[name]
    return record


def _placed(cloud: PointCloud) -> tuple[np.ndarray, np.ndarray]:
    """Offset and step [3] with which 32-bit numbers hold the coordinates: offset 0 where that suffices."""
    ends = np.array([(points.xyz.min(0), points.xyz.max(0)) for points in blocks(cloud)], np.float64)
    lowest, highest = ends[:, 0].min(0), ends[:, 1].max(0)
    if max(np.abs(lowest).max(), np.abs(highest).max()) <= SCALE_M * _STEPS:
        return np.zeros(3), np.full(3, SCALE_M)
    # Whole metres, so that the offset itself is exact. One metre is left for its rounding.
    offset = np.round(lowest / 2 + highest / 2)
    reach = float((highest / 2 - lowest / 2).max()) + 1.0
    scale = SCALE_M if reach <= SCALE_M * _STEPS else COARSEST_M
    if reach > scale * _STEPS:
        raise CloudError(
            f"LAS holds points at most {2 * COARSEST_M * _STEPS / 1e3:.0f} km apart, and these are "
            f"{reach / 500:.3g} km apart; remove the ones far away, or choose .ply."
        )
    return offset, np.full(3, scale)
