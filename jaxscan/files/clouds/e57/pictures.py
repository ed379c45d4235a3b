"""Pictures of a scan in E57: one all around it, in the format's spherical representation."""

import uuid
from typing import Any, NamedTuple

import numpy as np


class RoundPicture(NamedTuple):
    """A whole turn as seen from the scanner's origin: its x axis in the middle, azimuth falling to the right.

    Rows are equal steps of elevation, as wide as those of azimuth, and the horizon is half way down.
    """

    jpeg: bytes
    width: int
    height: int
    """Pixels."""


def append_picture(e57: Any, image: Any, picture: RoundPicture, scan: Any) -> None:
    """Append a picture that was taken where a scan was.

    Args:
        e57: The binding of libE57.
        image: The file, with its scans.
        picture: What is seen from the origin of the scan.
        scan: Its node, whose pose and identity the picture takes.
    """
    pictures = image.root()["images2D"]
    node, sphere, pose = (e57.StructureNode(image) for _ in range(3))
    node.set("guid", e57.StringNode(image, f"{{{uuid.uuid4()}}}"))
    node.set("name", e57.StringNode(image, "panorama"))
    node.set("description", e57.StringNode(image, "laser-off images of the sweep, blended"))
    node.set("associatedData3DGuid", e57.StringNode(image, scan["guid"].value()))
    for part, axes in (("rotation", "wxyz"), ("translation", "xyz")):
        copied = e57.StructureNode(image)
        for axis in axes:
            copied.set(axis, e57.FloatNode(image, scan["pose"][part][axis].value()))
        pose.set(part, copied)
    node.set("pose", pose)
    blob = e57.BlobNode(image, len(picture.jpeg))
    sphere.set("jpegImage", blob)
    for key, pixels in (("imageWidth", picture.width), ("imageHeight", picture.height)):
        sphere.set(key, e57.IntegerNode(image, pixels))
    for key in ("pixelWidth", "pixelHeight"):
        sphere.set(key, e57.FloatNode(image, 2 * np.pi / picture.width))
    node.set("sphericalRepresentation", sphere)
    pictures.append(node)
    # A blob has a place in the file only when its node has one.
    blob.write(np.frombuffer(picture.jpeg, np.uint8).copy(), 0, len(picture.jpeg))
