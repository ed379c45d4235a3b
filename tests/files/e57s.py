"""E57 files made by libE57, and files with another XML in them, with right checksums."""

import contextlib
import struct

import numpy as np

from jaxscan.files.clouds.e57 import PAGE, PAYLOAD, checksums


def paged(payload):
    """Bytes in pages with their checksums."""
    rows = np.frombuffer(payload + bytes(-len(payload) % PAYLOAD), np.uint8).reshape(-1, PAYLOAD)
    return np.concatenate([rows, checksums(rows).astype(">u4")[:, None].view(np.uint8)], 1).tobytes()


def payload_of(data):
    """The same without them."""
    return b"".join(data[k : k + PAYLOAD] for k in range(0, len(data), PAGE))


def xml_of(data):
    place, length = struct.unpack_from("<QQ", data, 24)
    at = place // PAGE * PAYLOAD + place % PAGE
    return payload_of(data)[at : at + length]


def with_xml(data, xml, *, place=None):
    """The file with another XML behind its points; `place` is where the head says that it begins in its page."""
    head = bytearray(payload_of(data))
    at = len(head)
    start = at // PAYLOAD * PAGE if place is None else at // PAYLOAD * PAGE - PAGE + place
    payload = bytes(head) + xml
    size = -(-len(payload) // PAYLOAD) * PAGE
    return paged(payload[:16] + struct.pack("<QQQ", size, start, len(xml)) + payload[40:])


def made(path, columns, *, structure=None, extension=None):
    """A file of libE57 with one scan: columns of (name, node of it, values)."""
    import pye57

    e57 = pye57.libe57
    with contextlib.closing(e57.ImageFile(str(path), "w")) as image:
        image.extensionsAdd("", e57.E57_V1_0_URI)
        if extension:
            image.extensionsAdd(*extension)
        scans = e57.VectorNode(image, True)
        image.root().set("data3D", scans)
        scan, prototype, buffers = e57.StructureNode(image), e57.StructureNode(image), e57.VectorSourceDestBuffer()
        for name, node, values in columns:
            prototype.set(name, node(e57, image))
            buffers.append(e57.SourceDestBuffer(image, name, values, len(values), True, True))
        points = e57.CompressedVectorNode(image, prototype, e57.VectorNode(image, True))
        scan.set("points", points)
        scans.append(scan)
        if structure:
            structure(e57, image, scan)
        with contextlib.closing(points.writer(buffers)) as writer:
            writer.write(len(values))
    return path
