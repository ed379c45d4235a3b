"""LAS 1.4 and LAZ, the formats of surveying, through laspy; with the uncertainty of every point."""

from pathlib import Path

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.files.clouds.points import columns
from jaxscan.reconstruction import PointCloud


SCALE_M = 1e-4
"""Step of the stored coordinates: a tenth of a millimetre."""
_EXTRA = {
    "sigma": "std. dev. along ray [m]",
    "sigma_random": "independent part [m]",
    "sigma_systematic": "shared part [m]",
    "normal_x": "towards the camera",
    "normal_y": "towards the camera",
    "normal_z": "towards the camera",
    "step": "profile of the grid",
    "row": "line of the grid",
}


def write_las(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write the valid points: point format 7, colours and intensity in 16 bit, extra bytes.

    The suffix `.laz` compresses. Intensity is the amplitude in 1/257 DN, so that 255 DN fill the range.

    Raises:
        DependencyError: If laspy, or lazrs for `.laz`, is not installed.
    """
    missing = DependencyError('LAS and LAZ need laspy and lazrs: pip install "jaxscan[export]"')
    try:
        import laspy
    except ImportError as problem:
        raise missing from problem
    if path.suffix.lower() == ".laz" and not laspy.LazBackend.detect_available():
        raise missing
    points = cloud.points()
    values = columns(points)
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales = np.full(3, SCALE_M)
    header.offsets = np.zeros(3)
    header.generating_software = "jaxscan"
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name, np.int32 if name in ("step", "row") else np.float32, description)
            for name, description in _EXTRA.items()
        ]
    )
    las = laspy.LasData(header)
    las.xyz = points.xyz.astype(np.float64)
    las.red, las.green, las.blue = points.rgb.astype(np.uint16).T * np.uint16(257)
    las.intensity = np.clip(np.round(points.intensity * 257), 0, 65535).astype(np.uint16)
    las.return_number = np.ones(len(points.step), np.uint8)
    las.number_of_returns = np.ones(len(points.step), np.uint8)
    las.user_data = points.laser
    for name in _EXTRA:
        las[name] = values[name]
    las.write(str(path))
