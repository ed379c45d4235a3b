"""Changes of clouds whose containers have checksums, headers and words: E57, LAS and LAZ, PCD, XYZ and PTX."""

import os
import random
import re
import struct

from jaxscan.files.clouds.e57 import PAGE, PAYLOAD

from ..files.e57s import paged, payload_of
from .draft import VICTIM_PLACE
from .nasty import nasty_number, nasty_text, near, pick
from .texts import change_bytes, change_lines


def change_e57(rng: random.Random, data: bytes) -> bytes:
    """An E57 file with another head, other XML or other points, all pages with right checksums; or other bytes."""
    kind = rng.randrange(10)
    if kind == 0:
        return change_bytes(rng, data)
    logical = bytearray(payload_of(data))
    _, _, _, place, length, _ = struct.unpack_from("<IIQQQQ", data, 8)
    # Physical places count the checksums.
    start = place - place // PAGE * 4
    if kind == 1:
        field = rng.choice((8, 12, 16, 24, 32, 40))
        struct.pack_into("<Q" if field >= 16 else "<I", logical, field, _field(rng, 64 if field >= 16 else 32))
        return paged(logical)
    if kind < 4:
        # The points: packets of binary data with sizes of their own.
        at = rng.choice((rng.randrange(48, 200), rng.randrange(48, start)))
        some = rng.choice((bytes([logical[at] ^ 1 << rng.randrange(8)]), rng.randbytes(4), b"\xff" * 8, b"\0" * 8))
        logical[at : at + len(some)] = some
        return paged(logical[: len(payload_of(data))])
    text = bytes(logical[start : start + length])
    new = change_xml(rng, text)
    struct.pack_into("<Q", logical, 32, len(new))
    logical[start:] = new
    pages = -(-len(logical) // PAYLOAD)
    struct.pack_into("<Q", logical, 16, pages * PAGE)
    return paged(logical)


def _field(rng: random.Random, bits: int) -> int:
    return rng.choice((0, 1, 48, 1023, 1024, 4096, 2**31, 2**32 - 1, 2**63, 2**64 - 1, rng.getrandbits(bits))) % 2**bits


def change_xml(rng: random.Random, text: bytes) -> bytes:
    """XML with definitions, another encoding, deep nesting, or other names and values."""
    body = re.sub(rb"^<\?xml.*?\?>\s*", b"", text)
    name, codec = rng.choice(_ENCODINGS)
    inside = _definitions(rng) if rng.random() < 0.7 else b""
    foreign = f'<?xml version="1.0" encoding="{name}"?>\n'.encode() + inside + body
    deep, tag = rng.choice((10, 64, 65, 100, 1000, 5000)), rng.choice((b"a", b"data3D", b"vectorChild", b"x:y"))
    nested = b"<%s>" % tag * deep + b"</%s>" % tag * rng.choice((deep, deep, deep - 1, 0))
    attributes = b"".join(b' a%d="1"' % k for k in range(rng.choice((100, 2000, 20_000))))
    return pick(
        rng,
        lambda: _declaration(rng) + _definitions(rng) + body,
        # In letters that a look at the bytes does not know.
        lambda: foreign.decode("utf-8", "replace").encode(codec, "replace"),
        lambda: _declaration(rng) + body.replace(b"</e57Root>", nested + b"</e57Root>"),
        *[lambda: _declaration(rng) + _other_part(rng, body)] * 4,
        lambda: body.replace(b"<e57Root", b"<e57Root" + attributes, 1),
        lambda: change_bytes(rng, text),
    )


def _other_part(rng: random.Random, body: bytes) -> bytes:
    """One number or text, in an element or an attribute, a whole element, or its name is another one."""
    found = list(re.finditer(rb">([^<>]+)<|\"([^\"<>]*)\"", body))
    if found and rng.random() < 0.5:
        hit = rng.choice(found)
        group = 1 if hit[1] is not None else 2
        return body[: hit.start(group)] + _value(rng, hit[group]) + body[hit.end(group) :]
    hit = rng.choice(list(re.finditer(rb"<(\w[\w:]*)[^<>]*>(?:[^<>]*</\1>)?", body)))
    new = (b"", hit[0] * 2, hit[0] * 300, hit[0].replace(hit[1], b"x"), hit[0].replace(b"Float", b"Integer"))
    return body[: hit.start()] + rng.choice(new) + body[hit.end() :]


_ENCODINGS = (
    *(("ebcdic-cp-us", "cp037"), ("UTF-16", "utf-16"), ("UTF-16LE", "utf-16-le"), ("UCS-4", "utf-32-be")),
    *(("ISO-8859-1", "latin-1"), ("UTF-8", "utf-8-sig"), ("windows-1252", "cp1252"), ("x" * 300, "utf-8")),
)


def _declaration(rng: random.Random) -> bytes:
    return rng.choice((b'<?xml version="1.0" encoding="UTF-8"?>\n', b"", b'<?xml version="1.1"?>', b"\n\n"))


def _definitions(rng: random.Random) -> bytes:
    """Entities that unfold, that name a file, or that lead to another machine."""
    place = rng.choice(("file://" + os.environ.get(VICTIM_PLACE, "/etc/hostname"), "http://127.0.0.1:9/a"))
    bomb = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 9}">' for k in range(1, rng.choice((4, 9))))
    return rng.choice(
        (
            f'<!DOCTYPE e57Root [<!ENTITY e0 "xxxxxxxx">{bomb}]>',
            f'<!DOCTYPE e57Root SYSTEM "{place}">',
            f'<!DOCTYPE e57Root [<!ENTITY % x SYSTEM "{place}"> %x;]>',
            f'<!DOCTYPE e57Root [<!ENTITY x SYSTEM "{place}">]>',
            f'<?xml-stylesheet href="{place}"?>',
            f'<!DOCTYPE e57Root PUBLIC "x" "{place}"><!ATTLIST e57Root a CDATA "1">',
        )
    ).encode()


def _value(rng: random.Random, old: bytes) -> bytes:
    if rng.random() < 0.4:
        try:
            number = float(old)
            return str(near(rng, int(number) if number == int(number) else number)).encode()
        except (ValueError, OverflowError):
            pass
    text = rng.choice((str(nasty_number(rng)), nasty_text(rng), "&lt;&#27;[31m", "&#0;", "&unknown;"))
    return text.encode("utf-8", "surrogatepass")


_LAS_FIELDS = (
    *((24, "B"), (25, "B"), (94, "<H"), (96, "<I"), (100, "<I"), (104, "<B"), (105, "<H"), (107, "<I")),
    *((place, "<d") for place in (131, 139, 147, 155, 163, 171, 179)),
    *((227, "<Q"), (247, "<Q")),
)


def change_las(rng: random.Random, data: bytes) -> bytes:
    """A LAS or LAZ file with another field in its head, or other bytes in its head, records or points."""
    if rng.random() < 0.3:
        return change_bytes(rng, data)
    changed = bytearray(data)
    if rng.random() < 0.3:
        # Records between head and points, and the beginning of compressed points.
        at = rng.randrange(94, min(3000, len(data) - 8))
        changed[at : at + 4] = rng.choice((rng.randbytes(4), b"\xff" * 4, b"\0" * 4))
        return bytes(changed)
    at, kind = rng.choice(_LAS_FIELDS)
    if kind == "<d":
        (old,) = struct.unpack_from(kind, data, at)
        value: float = rng.choice((-old, 0.0, float(nasty_number(rng)), near(rng, old)))
    else:
        value = _field(rng, 8 * struct.calcsize(kind))
    struct.pack_into(kind, changed, at, value)
    return bytes(changed)


def change_words(rng: random.Random, data: bytes, lines: int | None = None) -> bytes:
    """A text with one word of its first lines (of any, without a number) changed, or with lines changed."""
    if rng.random() < 0.2:
        return change_bytes(rng, data)
    parts = data.split(b"\n")
    head, rest = parts[:lines], [] if lines is None else parts[lines:]
    if rng.random() < 0.2:
        return b"\n".join([change_lines(rng, b"\n".join(head)), *rest])
    at = rng.randrange(len(head))
    words = head[at].split(b" ")
    word = rng.randrange(len(words))
    words[word : word + 1] = rng.choice(([], [_value(rng, words[word]), words[word]], [_value(rng, words[word])]))
    return b"\n".join([*head[:at], b" ".join(words), *head[at + 1 :], *rest])


def change_pcd(rng: random.Random, data: bytes) -> bytes:
    """A PCD file with its head or its bytes changed."""
    end = data.find(b"\nDATA ")
    return change_words(rng, data, data[: end + 1].count(b"\n") + 1) if end > 0 else change_bytes(rng, data)


def change_ptx(rng: random.Random, data: bytes) -> bytes:
    """A PTX file with its ten lines of head changed, or a line of points."""
    return change_words(rng, data, rng.choice((10, 10, None)))


def change_xyz(rng: random.Random, data: bytes) -> bytes:
    """A table of points with a word, a line or a byte changed."""
    return change_words(rng, data, rng.choice((1, None)))
