"""Laser-off images as photographs: colours of clouds, panoramas, posed images, and a scan with its panorama."""

import dataclasses
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from jaxscan.api.stages import Stage, Stages, megapixels
from jaxscan.errors import CalibrationError, CaptureError, CloudError, OutputError
from jaxscan.files.capture import Capture
from jaxscan.files.clouds import FlatPicture, RoundPicture, StoredCloud, Surroundings, save_cloud_with_pictures
from jaxscan.files.disk import check_writable, make_folder, reported, whole_folder, write_atomically, write_together
from jaxscan.geometry import Scanner
from jaxscan.photographs import (
    OPENGL_FROM_OPENCV,
    Panorama,
    Photograph,
    Photographs,
    Projection,
    Use,
    as_rgb,
    choose_evenly,
    colour_points,
    describe_cameras,
    enough_photographs,
    ideal_camera,
    is_describable,
    make_occluder,
    make_panorama,
    panorama_frame,
    poses,
    undistort,
)
from jaxscan.reconstruction import PointCloud, Progress, colour_exposure, in_scanner_frame


ENOUGH = 4
"""Photographs by which a sweep is coloured, at the least."""
SUFFIXES = (".jpg", ".jpeg", ".png")
DEPTH_UNIT = "Distance from the scanner's origin in millimetres, 16 bit; 0 where it is unknown."
NORMAL_UNIT = "Normals in the scanner's frame: red, green and blue are 127.5 (1 + x, y, z); 128 128 128 where unknown."


@dataclass(frozen=True)
class CapturedPhotographs:
    """The laser-off images of a capture, read one after the other when they are needed."""

    capture: Capture
    records: tuple[int, ...]
    """Positions in the capture."""
    progress: Progress = None

    def __iter__(self) -> Iterator[Photograph]:
        return self.where(lambda angle: True)

    def where(self, wanted: Callable[[float], bool]) -> Iterator[Photograph]:
        """The photographs whose angle is wanted; the others are not read."""
        angles = self.capture.angles
        for done, record in enumerate(self.records):
            if wanted(float(angles[record])):
                yield Photograph(float(angles[record]), self._image(record))
            if self.progress is not None:
                self.progress(done + 1, len(self.records))

    def _image(self, record: int) -> np.ndarray:
        frame = self.capture.off_frame(record)
        if frame is None:
            raise CaptureError(f"{self.capture.path}: record {self.capture.records[record].i} has no laser-off image.")
        one = frame if len(self.capture.exposures) == 1 else frame[colour_exposure(self.capture)]
        return as_rgb(one, self.capture.pixel_format)


def has_photographs(capture: Capture) -> bool:
    """Whether a capture has laser-off images in usable number, and from several places: those of a scanner that stands
    still show what it sees behind its one profile, and no surface."""
    several = len(capture) >= ENOUGH and len(np.unique(capture.angles)) > 1
    return several and all(record.off for record in capture.records)


def chosen_photographs(capture: Capture, scanner: Scanner, use: Use) -> tuple[int, ...]:
    """Records whose laser-off images are looked at: all, or enough of them, evenly spread over the sweep."""
    period = 2 * np.pi if scanner.turntable.carries in ("scanner", "object") else None
    return tuple(choose_evenly(capture.angles, enough_photographs(scanner, use), period=period).tolist())


def photograph_notes(capture: Capture, scanner: Scanner, use: Use) -> list[str]:
    """What a user should know about the choice of photographs; nothing where all are looked at."""
    chosen = len(chosen_photographs(capture, scanner, use))
    if chosen == len(capture) or not all(record.off for record in capture.records):
        return []
    return [f"{chosen} of {len(capture)} laser-off images are looked at, evenly spread over the sweep; they overlap."]


def open_photographs(
    capture: Capture, scanner: Scanner, use: Use = "pictures", *, progress: Progress = None
) -> Photographs:
    """The laser-off images of a sweep: all, or so many evenly spread over its way as suffice.

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        use: What they are for: points need fewer than pictures.
        progress: Called with (images read, images in all).

    Raises:
        CaptureError: If it has none.
        CalibrationError: If the calibration is for images of another size.
    """
    if not all(record.off for record in capture.records):
        raise CaptureError(f"{capture.path}: has no laser-off images, and photographs of the room are such.")
    scanner = scanner.along(capture.poses)
    size = scanner.camera.width, scanner.camera.height
    if capture.image_size != size:
        raise CalibrationError(
            f"{capture.path}: has images of {capture.image_size[0]} x {capture.image_size[1]} px, but the calibration "
            f"is for {size[0]} x {size[1]} px."
        )
    return Photographs(scanner, CapturedPhotographs(capture, chosen_photographs(capture, scanner, use), progress))


def colour_cloud(cloud: PointCloud, capture: Capture, scanner: Scanner, *, progress: Progress = None) -> PointCloud:
    """A cloud whose points have their colours from all photographs of the sweep that show them.

    Args:
        cloud: Points with the colours of their stripes; those keep it that no photograph shows.
        capture: The sweep that it is of.
        scanner: The rig that took it.
        progress: Called with (work done, work in all).

    Returns:
        The cloud with other colours, in the camera's own response.

    Raises:
        CaptureError: If the sweep has no laser-off images, or one cannot be read.
        CalibrationError: If the calibration is for images of another size.
        CloudError: If the cloud has no grid.
    """
    images = megapixels(*capture.image_size, len(chosen_photographs(capture, scanner, "points")))
    # Seconds of one processor, as of the other stages.
    told = Stages(progress, (Stage(2.3, 0.045 * images),)).part(0)
    photographs = open_photographs(capture, scanner, "points", progress=told)
    own, _ = in_scanner_frame(cloud)
    occluder = make_occluder(own, scanner.along(capture.poses))
    points = own.points()
    found, _ = colour_points(photographs, points.xyz, points.normals, occluder=occluder, start=points.rgb)
    rgb = np.zeros_like(np.asarray(cloud.rgb))
    rgb[points.step, points.row] = found
    absent = tuple(name for name in cloud.lacks if name != "rgb")
    return dataclasses.replace(cloud, rgb=rgb, absent=absent or None)


def draw_panorama(
    capture: Capture,
    scanner: Scanner,
    *,
    cloud: PointCloud | None = None,
    projection: Projection = "equirectangular",
    width: int | None = None,
    progress: Progress = None,
) -> Panorama:
    """All photographs of a sweep as one picture, as seen from the scanner's origin.

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        cloud: The sweep's cloud, by whose distances parallax is removed.
        projection: "equirectangular" or "cylinder".
        width: Width of a whole turn [px]; the camera's own resolution where not given.
        progress: Called with (images read, images in all).

    Returns:
        The picture, with distances and normals of its pixels if a cloud was given.

    Raises:
        CaptureError: If the sweep has no laser-off images, or one cannot be read.
        CalibrationError: If the camera does not turn, or the calibration is for images of another size.
        CloudError: If the cloud has no grid.
    """
    frame = panorama_frame(scanner, projection, width)
    cloud = None if cloud is None else in_scanner_frame(cloud)[0]
    return make_panorama(open_photographs(capture, scanner, progress=progress), frame, cloud)


def panorama_paths(path: Path, *, with_cloud: bool) -> list[Path]:
    """The files that `save_panorama` writes."""
    return [path, *(path.with_name(f"{path.stem}.{name}.png") for name in ("depth", "normals") if with_cloud)]


def check_panorama_path(path: Path, *, with_cloud: bool) -> None:
    """Check that a panorama can be written under this name, before it is made.

    Raises:
        OutputError: If the suffix is unknown, or nothing can be written there.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f'{path}: cannot write "{path.suffix}", known are {", ".join(SUFFIXES)}.')
    for one in panorama_paths(path, with_cloud=with_cloud):
        check_writable(one, error=OutputError)


def save_panorama(panorama: Panorama, path: str | Path) -> list[Path]:
    """Write a panorama as JPEG or PNG with the metadata by which viewers show it round, and what was made with it.

    With distances, `<stem>.depth.png` (16 bit, millimetres) and `<stem>.normals.png` in the same geometry.

    Args:
        panorama: As `draw_panorama` makes it.
        path: Its suffix is .jpg, .jpeg or .png.

    Returns:
        The files.

    Raises:
        OutputError: If one cannot be written.
    """
    # Here, so that reconstructing does not load OpenCV.
    from jaxscan.vision import encode_jpeg, encode_picture_png

    path = Path(path)
    check_panorama_path(path, with_cloud=panorama.distance_m is not None)
    xmp = _gpano(panorama)
    as_jpeg = path.suffix.lower() != ".png"
    try:
        pictures = [encode_jpeg(panorama.rgb, xmp=xmp) if as_jpeg else encode_picture_png(panorama.rgb, xmp=xmp)]
    except ValueError as problem:
        raise OutputError(f"{path}: cannot be written: {problem}.") from problem
    if panorama.distance_m is not None and panorama.normals is not None:
        millimetres = np.clip(np.rint(1e3 * panorama.distance_m), 0, 65535).astype(np.uint16)
        normals = np.rint(127.5 * (1 + np.clip(panorama.normals, -1, 1))).astype(np.uint8)
        pictures.append(encode_picture_png(millimetres, xmp=xmp, about=DEPTH_UNIT))
        pictures.append(encode_picture_png(normals, xmp=xmp, about=NORMAL_UNIT))
    paths = panorama_paths(path, with_cloud=panorama.distance_m is not None)
    write_together(dict(zip(paths, pictures, strict=True)), error=OutputError)
    return paths


def export_photographs(
    capture: Capture, scanner: Scanner, folder: str | Path, *, undistorted: bool = False, progress: Progress = None
) -> int:
    """Write photographs as PNG in `<folder>/images`, and their poses as `<folder>/transforms.json`.

    Args:
        capture: The sweep.
        scanner: The calibrated rig.
        folder: Made where it is missing.
        undistorted: Whether images are written as a camera without distortion would have taken them; always where the
            file cannot describe the lens.
        progress: Called with (images read, images in all).

    Returns:
        Number of images.

    Raises:
        CaptureError: If the sweep has no laser-off images, or one cannot be read.
        CalibrationError: If the table carries the object, or the calibration is for images of another size.
        OutputError: If a file cannot be written.
    """
    from jaxscan.vision import encode_picture_png

    photographs, folder = open_photographs(capture, scanner, progress=progress), Path(folder)
    camera, ideal = scanner.camera, ideal_camera(scanner.camera)
    undistorted = undistorted or not is_describable(camera)
    if undistorted:
        scanner = dataclasses.replace(scanner, camera=ideal, covariance=None)
    angles, names = list[float](), list[str]()
    with reported(f"{folder}: cannot be written", error=OutputError), whole_folder(folder) as part:
        make_folder(part / "images")
        for number, (angle, image) in enumerate(photographs):
            name = f"images/{number:06d}.png"
            picture = np.asarray(undistort(image, camera, ideal)) if undistorted else image
            write_atomically(part / name, encode_picture_png(picture), error=OutputError, durable=False)
            angles.append(angle)
            names.append(name)
        content = json.dumps(describe_cameras(scanner, angles, names), indent=2, allow_nan=False) + "\n"
        write_atomically(part / "transforms.json", content.encode(), error=OutputError, durable=False)
    return len(names)


def _gpano(panorama: Panorama) -> str:
    """XMP packet by which viewers know where on the sphere a picture lies."""
    frame = panorama.frame
    fields: dict[str, object] = {"UsePanoramaViewer": "True", "ProjectionType": frame.projection}
    if frame.projection == "equirectangular":
        fields |= {
            "FullPanoWidthPixels": frame.width,
            "FullPanoHeightPixels": frame.width // 2,
            "CroppedAreaImageWidthPixels": frame.width,
            "CroppedAreaImageHeightPixels": frame.height,
            "CroppedAreaLeftPixels": 0,
            "CroppedAreaTopPixels": frame.rows_above,
        }
    else:
        fields["ProjectionType"] = "cylindrical"
    described = "".join(f' GPano:{name}="{value}"' for name, value in fields.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
        f'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/"{described}/></rdf:RDF></x:xmpmeta>'
        '<?xpacket end="r"?>'
    )


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
