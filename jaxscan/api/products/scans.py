"""A scan in one file: its points, and what is seen around it."""

from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds import RoundPicture, StoredCloud, save_cloud_with_picture
from jaxscan.photographs import Panorama


def save_scan(stored: StoredCloud, panorama: Panorama, path: str | Path) -> Path:
    """Write a cloud and its panorama as one E57, the panorama as an image with the pose of the scan.

    Args:
        stored: The cloud [m] of one station, as `read_cloud` returns it.
        panorama: Its panorama, equirectangular.
        path: Its suffix is .e57.

    Returns:
        The file.

    Raises:
        CloudError: If the panorama is a cylinder, the suffix another, or the file cannot be written.
        DependencyError: If pye57 is not installed.
    """
    # Here, so that reconstructing does not load OpenCV.
    from jaxscan.vision import encode_jpeg

    path, frame = Path(path), panorama.frame
    if path.suffix.lower() != ".e57":
        raise CloudError(f'{path}: cannot hold a picture; found "{path.suffix}", expected .e57.')
    if frame.projection != "equirectangular":
        raise CloudError(f"{path}: E57 holds equirectangular panoramas; this one is a {frame.projection}.")
    # The format has the horizon in the middle; the camera sees further on one side of it.
    above = round(frame.top / frame.per_pixel)
    half = max(above, frame.height - above)
    whole = np.zeros((2 * half, frame.width, 3), np.uint8)
    whole[half - above : half - above + frame.height] = panorama.rgb
    save_cloud_with_picture(stored, RoundPicture(encode_jpeg(whole), frame.width, 2 * half), path)
    return path
