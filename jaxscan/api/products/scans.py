"""A scan in one file: its points, what is seen around it, and when it was taken."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.capture import Capture
from jaxscan.files.clouds import FlatPicture, RoundPicture, StoredCloud, Surroundings, save_cloud_with_pictures
from jaxscan.photographs import OPENGL_FROM_OPENCV, Panorama, Photographs, ideal_camera, poses, undistort


def save_scan(
    stored: StoredCloud,
    panorama: Panorama,
    path: str | Path,
    *,
    photographs: Photographs | None = None,
    started_s: float | None = None,
) -> Path:
    """Write a cloud and its panorama as one E57, the panorama as an image with the pose of the scan.

    Args:
        stored: The cloud [m] of one station, as `read_cloud` returns it.
        panorama: Its panorama, equirectangular.
        path: Its suffix is .e57.
        photographs: Laser-off images that go into the file too, without distortion, each with its pose.
        started_s: When the sweep began, seconds since 1970; see `began`.

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
    single = () if photographs is None else _without_distortion(photographs)
    around = Surroundings(RoundPicture(encode_jpeg(whole), frame.width, 2 * half), single, started_s)
    save_cloud_with_pictures(stored, around, path)
    return path


def began(capture: Capture) -> float | None:
    """When a capture was begun, seconds since 1970; None where the program that took it does not say."""
    said = capture.header.acquisition.get("started")
    try:
        return datetime.fromisoformat(said).timestamp() if isinstance(said, str) else None
    except ValueError:
        return None


def _without_distortion(photographs: Photographs) -> Iterator[FlatPicture]:
    from jaxscan.vision import encode_jpeg

    camera = photographs.scanner.camera
    ideal = ideal_camera(camera)
    centre = float(ideal.cx), float(ideal.cy)
    for angle, image in photographs:
        picture = np.asarray(undistort(image, camera, ideal))
        pose = poses(photographs.scanner, np.array([angle]))[0] @ OPENGL_FROM_OPENCV
        yield FlatPicture(encode_jpeg(picture), ideal.width, ideal.height, float(ideal.fx), centre, pose)
