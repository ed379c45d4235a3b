"""Structured changes of a capture, its cache and its calibration, as an editor, a bad copy or a stranger makes."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from worlds.journal_mutations import (
    Line,
    Mutation,
    Place,
    Rng,
    all_angles,
    equal_angles,
    exchanged_angles,
    journal,
    last_removed,
    misspelt,
    named_pair,
    named_side,
    off_as_on,
    one_angle,
    read_lines,
    removed,
    renumbered,
    sides_exchanged,
    two,
    write_lines,
)


def _file(record: Line, place: Place, side: str) -> Path:
    return place.sweep / record[side]


def _files(change: Callable[[list[Line], Place, Rng], None]) -> Mutation:
    return lambda place, rng: change([line for line in read_lines(place.sweep) if "i" in line], place, rng)


def _copied(*sides: str) -> Mutation:
    def change(records: list[Line], place: Place, rng: Rng) -> None:
        a, b = two(records, rng)
        for side in sides:
            _file(records[a], place, side).write_bytes(_file(records[b], place, side).read_bytes())

    return _files(change)


def _exchanged(*sides: str) -> Mutation:
    def change(records: list[Line], place: Place, rng: Rng) -> None:
        a, b = two(records, rng)
        for side in sides:
            one, other = _file(records[a], place, side), _file(records[b], place, side)
            first, second = one.read_bytes(), other.read_bytes()
            one.write_bytes(second)
            other.write_bytes(first)

    return _files(change)


def _foreign(*sides: str) -> Mutation:
    def change(records: list[Line], place: Place, rng: Rng) -> None:
        theirs = [line for line in read_lines(place.other) if "i" in line]
        record = records[rng.integers(len(records))]
        their = theirs[rng.integers(len(theirs))]
        for side in sides:
            _file(record, place, side).write_bytes((place.other / their[side]).read_bytes())

    return _files(change)


def _pixels(change: Callable[[np.ndarray, Rng], np.ndarray], *sides: str) -> Mutation:
    def mutate(records: list[Line], place: Place, rng: Rng) -> None:
        record, seed = records[rng.integers(len(records))], int(rng.integers(1 << 30))
        for side in sides:
            path = _file(record, place, side)
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(path), change(image, np.random.default_rng(seed)))

    return _files(mutate)


def _shifted(image: np.ndarray, rng: Rng) -> np.ndarray:
    return np.roll(image, int(rng.choice([-1, 1]) * rng.integers(2, 60)), axis=1)


def _dimmed(image: np.ndarray, rng: Rng) -> np.ndarray:
    return np.rint(image * rng.uniform(0.2, 0.8)).astype(np.uint8)


def _zeroed(image: np.ndarray, rng: Rng) -> np.ndarray:
    image = image.copy()
    rows = int(rng.integers(8, image.shape[0]))
    start = int(rng.integers(0, image.shape[0] - rows + 1))
    image[start : start + rows] = 0
    return image


def _mirrored(image: np.ndarray, rng: Rng) -> np.ndarray:
    return np.flip(image, int(rng.integers(2)))


def _bit_turned(image: np.ndarray, rng: Rng) -> np.ndarray:
    return image ^ np.uint8(1 << rng.integers(4, 8))


def _header(old: str, *new: str) -> Mutation:
    def mutate(place: Place, rng: Rng) -> None:
        path = place.sweep / "capture.toml"
        text = path.read_text()
        if old not in text:
            raise ValueError(f"{old} is not in the header")
        path.write_text(text.replace(old, new[rng.integers(len(new))]))

    return mutate


def _calibration(place: Place, rng: Rng) -> None:
    data = json.loads(place.calibration.read_text())
    factor = 1 + float(10 ** rng.uniform(-2.5, -1.0) * rng.choice([-1, 1]))
    where, key = [(data["camera"], "fx"), (data["lasers"][0], "distance_m"), (data["turntable"], "gain")][
        rng.integers(3)
    ]
    where[key] *= factor
    place.calibration.write_text(json.dumps(data))


def _cache(place: Place, rng: Rng) -> None:
    with np.load(place.sweep / "stripes.npz") as opened:
        arrays = dict(opened)
    arrays["u"] = arrays["u"] + np.float32(rng.uniform(0.5, 5.0))
    np.savez(place.sweep / "stripes.npz", **arrays)


def _rehashed(place: Place, rng: Rng) -> None:
    """Another record's image, with its digest corrected by somebody who does not know of the seal."""
    lines = read_lines(place.sweep)
    records = [line for line in lines if "i" in line]
    a, b = two(records, rng)
    data = _file(records[b], place, "on").read_bytes()
    _file(records[a], place, "on").write_bytes(data)
    if "sha256" in records[a]:
        records[a]["sha256"]["on"] = hashlib.sha256(data).hexdigest()
    write_lines(place.sweep, lines)


def _seal_removed(place: Place, rng: Rng) -> None:
    lines = [line for line in read_lines(place.sweep) if "journal_sha256" not in line]
    one_angle(lines, rng)
    write_lines(place.sweep, lines)


def _shard(change: Callable[[bytearray, int, Rng], bytearray], side: str = "on") -> Mutation:
    def mutate(place: Place, rng: Rng) -> None:
        shards = sorted((place.sweep / side).glob("*.npy"))
        path = shards[rng.integers(len(shards))]
        path.write_bytes(change(bytearray(path.read_bytes()), 128, rng))

    return mutate


def _bytes_changed(data: bytearray, start: int, rng: Rng) -> bytearray:
    for at in rng.integers(start, len(data), 200):
        data[at] = rng.integers(256)
    return data


def _byte_inserted(data: bytearray, start: int, rng: Rng) -> bytearray:
    at = int(rng.integers(start, len(data)))
    return data[:at] + b"\x00" + data[at:]


def _block_lost(data: bytearray, start: int, rng: Rng) -> bytearray:
    """Zeros, as of a block that a disk has lost: 4 to 64 KiB."""
    size = 4096 * int(rng.integers(1, 17))
    at = int(rng.integers(start, len(data) - size))
    data[at : at + size] = bytes(size)
    return data


def _block_moved(data: bytearray, start: int, rng: Rng) -> bytearray:
    size = int(rng.integers(20_000, 80_000))
    a, b = (int(at) for at in rng.integers(start, len(data) - size, 2))
    data[a : a + size] = data[b : b + size]
    return data


PICTURES: dict[str, Mutation] = {
    "journal: one angle changed": journal(one_angle),
    "journal: angles of two records exchanged": journal(exchanged_angles),
    "journal: two equal angles": journal(equal_angles),
    "journal: all angles 0": all_angles(lambda angle, rng: 0.0),
    "journal: angles in radians": all_angles(lambda angle, rng: np.radians(angle)),
    "journal: angles negated": all_angles(lambda angle, rng: -angle),
    "journal: angles scaled by 0.5 to 0.95": all_angles(lambda angle, rng: angle * rng.uniform(0.5, 0.95)),
    "journal: all angles by 360 deg more": all_angles(lambda angle, rng: angle + 360.0),
    "journal: records removed": journal(removed),
    "journal: records removed, the rest renumbered": journal(renumbered),
    "journal: last records removed": journal(last_removed),
    "journal: key i misspelt": journal(misspelt),
    "journal: on and off exchanged in a record": journal(sides_exchanged),
    "journal: off named as on": journal(off_as_on),
    "journal: pairs of two records exchanged": journal(named_pair),
    "journal: on of another record": journal(named_side("on")),
    "journal: off of another record": journal(named_side("off")),
    "images: on copied from another record": _copied("on"),
    "images: off copied from another record": _copied("off"),
    "images: pair copied from another record": _copied("on", "off"),
    "images: on of two records exchanged": _exchanged("on"),
    "images: off of two records exchanged": _exchanged("off"),
    "images: pairs of two records exchanged": _exchanged("on", "off"),
    "images: pair from another capture": _foreign("on", "off"),
    "images: on from another capture": _foreign("on"),
    "images: off from another capture": _foreign("off"),
    "images: pair moved sideways": _pixels(_shifted, "on", "off"),
    "images: pair at another exposure": _pixels(_dimmed, "on", "off"),
    "images: on at another exposure": _pixels(_dimmed, "on"),
    "images: a part of on is black": _pixels(_zeroed, "on"),
    "images: a part of off is black": _pixels(_zeroed, "off"),
    "images: on mirrored": _pixels(_mirrored, "on"),
    "images: off mirrored": _pixels(_mirrored, "off"),
    "images: a bit of off turned": _pixels(_bit_turned, "off"),
    "images: on exchanged, its digest corrected": _rehashed,
    "header: pixel_format": _header('"mono8"', '"bayer_rggb8"', '"bayer_grbg8"'),
    "header: response": _header('response = "linear"', 'response = "srgb"'),
    "header: stripe_axis": _header('stripe_axis = "rows"', 'stripe_axis = "columns"'),
    "header: carries": _header('carries = "scanner"', 'carries = "object"'),
    "calibration: a value changed by hand": _calibration,
    "cache: stripes moved": _cache,
    "seal removed, one angle changed": _seal_removed,
}
"""Of captures with image files."""
SHARDS: dict[str, Mutation] = {
    "shards: 200 bytes changed": _shard(_bytes_changed),
    "shards: a byte inserted": _shard(_byte_inserted),
    "shards: a block copied elsewhere": _shard(_block_moved),
    "shards: a block of on is zeros": _shard(_block_lost),
    "shards: a block of off is zeros": _shard(_block_lost, "off"),
}
"""Of captures with raw frames."""
COLOURS: dict[str, Mutation] = {
    "header: order of a mosaic": _header('"bayer_rggb8"', '"bayer_bggr8"', '"bayer_grbg8"', '"bayer_gbrg8"', '"mono8"'),
    "header: colour of the laser": _header('colour = "red"', 'colour = "green"', 'colour = "blue"'),
}
"""Of captures with the mosaic of a colour camera."""
