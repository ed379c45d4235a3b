"""Pictures of a scan in E57: one all around it, and photographs by a camera without distortion."""

import uuid
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from jaxscan.geometry import quaternion


class RoundPicture(NamedTuple):
    """A whole turn as seen from the scanner's origin: its x axis in the middle, azimuth falling to the right.

    Rows are equal steps of elevation, as wide as those of azimuth, and the horizon is half way down.
    """

    jpeg: bytes
    width: int
    height: int
    """Pixels."""


class FlatPicture(NamedTuple):
    """A photograph by a camera without distortion."""

    jpeg: bytes
    width: int
    height: int
    """Pixels."""
    focal_px: float
    centre: tuple[float, float]
    """Principal point (u, v) [px], from the centre of the first pixel."""
    pose: np.ndarray
    """T_scanner_camera [4, 4], metres; the camera's x right, y up, z backward, as the format has it."""


class Surroundings(NamedTuple):
    """What is known of a scan beside its points."""

    panorama: RoundPicture
    photographs: Iterable[FlatPicture] = ()
    """Asked for one after the other."""
    started_s: float | None = None
    """When the scan began, seconds since 1970; None where it is not known."""


def append_panorama(e57: Any, image: Any, picture: RoundPicture, scan: Any) -> None:
    """Append a picture that was taken where a scan was.

    Args:
        e57: The binding of libE57.
        image: The file, with its scans.
        picture: What is seen from the origin of the scan.
        scan: Its node, whose pose and identity the picture takes.
    """
    node, sphere, pose = (e57.StructureNode(image) for _ in range(3))
    for part, axes in (("rotation", "wxyz"), ("translation", "xyz")):
        copied = e57.StructureNode(image)
        for axis in axes:
            copied.set(axis, e57.FloatNode(image, scan["pose"][part][axis].value()))
        pose.set(part, copied)
    node.set("pose", pose)
    for key in ("pixelWidth", "pixelHeight"):
        sphere.set(key, e57.FloatNode(image, 2 * np.pi / picture.width))
    node.set("sphericalRepresentation", sphere)
    _append(e57, image, (node, sphere), picture, scan, ("panorama", "laser-off images of the sweep, blended"))


def append_photograph(e57: Any, image: Any, picture: FlatPicture, scan: Any, *, number: int, T_file_scan: Any) -> None:
    """Append a photograph of a scan, in the format's pinhole representation."""
    node, pinhole, pose = (e57.StructureNode(image) for _ in range(3))
    placed = np.asarray(T_file_scan, np.float64) @ picture.pose
    values = {"rotation": zip("wxyz", quaternion(placed[:3, :3]), strict=True)}
    for part, numbers in (*values.items(), ("translation", zip("xyz", placed[:3, 3].tolist(), strict=True))):
        made = e57.StructureNode(image)
        for axis, value in numbers:
            made.set(axis, e57.FloatNode(image, value))
        pose.set(part, made)
    node.set("pose", pose)
    # Only ratios matter: the sensor's pixels are taken to be a micrometre.
    sizes = {"focalLength": 1e-6 * picture.focal_px, "pixelWidth": 1e-6, "pixelHeight": 1e-6}
    middle = {"principalPointX": picture.centre[0], "principalPointY": picture.centre[1]}
    for key, value in {**sizes, **middle}.items():
        pinhole.set(key, e57.FloatNode(image, value))
    node.set("pinholeRepresentation", pinhole)
    _append(e57, image, (node, pinhole), picture, scan, (f"photograph {number}", "laser-off image, without distortion"))


def _append(
    e57: Any, image: Any, nodes: tuple[Any, Any], picture: RoundPicture | FlatPicture, scan: Any, words: tuple[str, str]
) -> None:
    """Name a picture's node, fill in its representation, and write it."""
    node, shown = nodes
    node.set("guid", e57.StringNode(image, f"{{{uuid.uuid4()}}}"))
    node.set("name", e57.StringNode(image, words[0]))
    node.set("description", e57.StringNode(image, words[1]))
    node.set("associatedData3DGuid", e57.StringNode(image, scan["guid"].value()))
    blob = e57.BlobNode(image, len(picture.jpeg))
    shown.set("jpegImage", blob)
    for key, pixels in (("imageWidth", picture.width), ("imageHeight", picture.height)):
        shown.set(key, e57.IntegerNode(image, pixels))
    image.root()["images2D"].append(node)
    # A blob has a place in the file only when its node has one.
    blob.write(np.frombuffer(picture.jpeg, np.uint8).copy(), 0, len(picture.jpeg))
