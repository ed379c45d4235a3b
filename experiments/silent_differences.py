"""Whether a change that matters is noticed: mutations of a capture, reconstructed, with and without a seal.

A small sweep is rendered once, as image files, as raw shards and as a mosaic. Each mutation is applied to a copy, which
is then reconstructed. The cloud has changed if at least ten points moved by more than three of their own sigmas,
appeared or vanished. The mutation is noticed if opening or reconstructing ends with an error, or gives a note that the
unchanged capture does not have. "sealed" captures are as jaxscan writes them; from "unsealed" ones all digests and the
seal were taken, so only plausibility is left. The calibration is the true one without covariance, so the sigmas are
those of the stripes alone, the strictest measure.

    python -m experiments.silent_differences [--each N] [--seed S] [--only KIND] [--json FILE] [--results DIR]
"""

import hashlib
import json
import shutil
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

import jaxscan
from experiments.report import command_line, write_json
from experiments.report import table as markdown
from jaxscan.api import reconstruct_capture
from jaxscan.calibration import Calibration
from jaxscan.errors import JaxscanError
from jaxscan.files.calibration import calibration_notes
from jaxscan.files.recording import repack_capture
from jaxscan.reconstruction import PointCloud
from jaxscan.simulation import SimulationConfig, true_scanner


class Place(NamedTuple):
    """Files that a mutation may change."""

    sweep: Path
    calibration: Path
    other: Path
    """A capture of the same rig in another room."""


Rng = np.random.Generator
Mutation = Callable[[Place, Rng], None]
Line = dict[str, Any]


def read_lines(sweep: Path) -> list[Line]:
    """The objects of a journal."""
    return [json.loads(line) for line in (sweep / "frames.jsonl").read_text().splitlines()]


def write_lines(sweep: Path, lines: list[Line]) -> None:
    """Write a journal; lines that did not change keep their bytes."""
    (sweep / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def unseal(sweep: Path) -> None:
    """Take all digests and seals out of a capture, as if other software had written it."""
    lines = [{k: v for k, v in line.items() if k != "sha256"} for line in read_lines(sweep)]
    write_lines(sweep, [line for line in lines if "journal_sha256" not in line])


def journal(change: Callable[[list[Line], Rng], list[Line] | None]) -> Mutation:
    """A mutation from a change of a journal's records; events stay at the end."""

    def mutate(place: Place, rng: Rng) -> None:
        lines = read_lines(place.sweep)
        records = [line for line in lines if "i" in line]
        events = [line for line in lines if "i" not in line]
        found = change(records, rng)
        write_lines(place.sweep, (records if found is None else found) + events)

    return mutate


def two(records: list[Line], rng: Rng) -> tuple[Line, Line]:
    """Two different records."""
    one, other = rng.choice(len(records), 2, replace=False)
    return records[one], records[other]


def one_of(records: list[Line], rng: Rng) -> Line:
    """A record."""
    return records[rng.integers(len(records))]


def one_angle(records: list[Line], rng: Rng) -> None:
    size = 10 ** rng.uniform(-1.0, 1.5)
    one_of(records, rng)["angle_deg"] += float(size * rng.choice([-1, 1]))


def swapped(*keys: str) -> Mutation:
    """Two records have each other's values of keys."""

    def change(records: list[Line], rng: Rng) -> None:
        a, b = two(records, rng)
        for key in keys:
            a[key], b[key] = b[key], a[key]

    return journal(change)


def taken(key: str) -> Mutation:
    """One record has the value of another."""

    def change(records: list[Line], rng: Rng) -> None:
        a, b = two(records, rng)
        a[key] = b[key]

    return journal(change)


def renamed(**new: str) -> Mutation:
    """One record has other images of its own: `new` says which for each side."""

    def change(records: list[Line], rng: Rng) -> None:
        record = one_of(records, rng)
        record |= {side: record[of] for side, of in new.items()}

    return journal(change)


def equal_angles(records: list[Line], rng: Rng) -> None:
    k = int(rng.integers(1, len(records)))
    records[k]["angle_deg"] = records[k - 1]["angle_deg"]


def all_angles(change: Callable[[float, Rng], float]) -> Mutation:
    """A mutation from a change that all angles have."""

    def mutate(records: list[Line], rng: Rng) -> None:
        seed = int(rng.integers(1 << 30))
        for line in records:
            line["angle_deg"] = float(change(line["angle_deg"], np.random.default_rng(seed)))

    return journal(mutate)


def removed(records: list[Line], rng: Rng) -> list[Line]:
    gone = set(rng.choice(np.arange(1, len(records) - 1), rng.integers(1, 10), replace=False).tolist())
    return [line for k, line in enumerate(records) if k not in gone]


def renumbered(records: list[Line], rng: Rng) -> list[Line]:
    return [{**line, "i": k} for k, line in enumerate(removed(records, rng))]


def last_removed(records: list[Line], rng: Rng) -> list[Line]:
    return records[: -int(rng.integers(1, 10))]


def misspelt(records: list[Line], rng: Rng) -> None:
    record = records[int(rng.integers(1, len(records) - 1))]
    record["I"] = record.pop("i")


def _records(sweep: Path) -> list[Line]:
    return [line for line in read_lines(sweep) if "i" in line]


def _copied(*sides: str) -> Mutation:
    def mutate(place: Place, rng: Rng) -> None:
        a, b = two(_records(place.sweep), rng)
        for side in sides:
            (place.sweep / a[side]).write_bytes((place.sweep / b[side]).read_bytes())

    return mutate


def _exchanged(*sides: str) -> Mutation:
    def mutate(place: Place, rng: Rng) -> None:
        a, b = two(_records(place.sweep), rng)
        for side in sides:
            one, other = place.sweep / a[side], place.sweep / b[side]
            first, second = one.read_bytes(), other.read_bytes()
            one.write_bytes(second)
            other.write_bytes(first)

    return mutate


def _foreign(*sides: str) -> Mutation:
    def mutate(place: Place, rng: Rng) -> None:
        record, their = one_of(_records(place.sweep), rng), one_of(_records(place.other), rng)
        for side in sides:
            (place.sweep / record[side]).write_bytes((place.other / their[side]).read_bytes())

    return mutate


def _pixels(change: Callable[[np.ndarray, Rng], np.ndarray], *sides: str) -> Mutation:
    def mutate(place: Place, rng: Rng) -> None:
        record, seed = one_of(_records(place.sweep), rng), int(rng.integers(1 << 30))
        for side in sides:
            path = place.sweep / record[side]
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(path), change(image, np.random.default_rng(seed)))

    return mutate


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
    a, b = two([line for line in lines if "i" in line], rng)
    data = (place.sweep / b["on"]).read_bytes()
    (place.sweep / a["on"]).write_bytes(data)
    if "sha256" in a:
        a["sha256"]["on"] = hashlib.sha256(data).hexdigest()
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
    "journal: angles of two records exchanged": swapped("angle_deg"),
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
    "journal: on and off exchanged in a record": renamed(on="off", off="on"),
    "journal: off named as on": renamed(on="off"),
    "journal: pairs of two records exchanged": swapped("on", "off"),
    "journal: on of another record": taken("on"),
    "journal: off of another record": taken("off"),
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


CONFIG = Path(jaxscan.__file__).parent / "data" / "demo.toml"
EVERY = 4
"""45 of the 180 steps."""
MOVED = 3.0
"""Movement of a point that counts [sigma]."""
POINTS = 10
"""Points that must have moved."""
LIMITS = {"sealed": 0.99, "unsealed": 0.90}
"""Share of the mutations that change the cloud which must be noticed."""


class Outcome(NamedTuple):
    """One mutation."""

    kind: str
    capture: str
    changed: bool
    noticed: bool
    notes: str


def small(pixel_format: str, seed: int, yaw_deg: float) -> SimulationConfig:
    """The rig of the demo with a quarter of its pixels, in a room that is turned."""
    config = jaxscan.load_simulation(CONFIG)
    camera = config.camera.model_copy(
        update={"width": 320, "height": 256, "fx": 205.0, "fy": 205.25, "cx": 161.2, "cy": 127.05}
    )
    sensor = config.sensor.model_copy(update={"pixel_format": pixel_format})
    boards = config.boards.model_copy(update={"free_views": 0, "placements": 0})
    room = config.room.model_copy(update={"yaw_deg": yaw_deg})
    return config.model_copy(update={"camera": camera, "sensor": sensor, "boards": boards, "room": room, "seed": seed})


def make(folder: Path, seed: int) -> Path:
    """All captures and the calibration, once."""
    scanner = true_scanner(small("mono8", seed, 50.0))
    jaxscan.save_calibration(Calibration(scanner.camera, scanner, (), np.zeros((0, 0))), folder / "calibration.json")
    for name, config in (
        ("files", small("mono8", seed, 50.0)),
        ("other", small("mono8", seed + 1, 140.0)),
        ("mosaic", small("bayer_rggb8", seed, 50.0)),
    ):
        jaxscan.simulate(config, folder / "made", every=EVERY)
        # Image files, which the mutations edit; the storage of new captures has a checksum in every frame.
        repack_capture(folder / "made" / "sweep", folder / name, storage="png")
        shutil.rmtree(folder / "made")
    repack_capture(folder / "files", folder / "shards", storage="npy")
    for name in ("files", "shards", "mosaic"):
        shutil.copytree(folder / name, folder / f"{name} unsealed")
        unseal(folder / f"{name} unsealed")
    return folder


def reconstructed(place: Place, cache: bool) -> tuple[PointCloud | None, set[str]]:
    """The cloud, and all notes; no cloud after an error."""
    try:
        capture = jaxscan.open_capture(place.sweep)
        notes = [*calibration_notes(place.calibration), *capture.notes]
        done = reconstruct_capture(capture, jaxscan.load_scanner(place.calibration), cache=cache)
    except JaxscanError as problem:
        return None, {f"error: {problem}"}
    numbers = np.array([record.i for record in capture.records])
    # Records by their own numbers, so that a missing one is missing.
    rows = np.full(int(numbers.max()) + 1, -1)
    rows[numbers] = np.arange(len(numbers))
    return _by_number(done.cloud, rows), {note.replace(str(place.sweep.parent), "") for note in (*notes, *done.notes)}


def _by_number(cloud: PointCloud, rows: np.ndarray) -> Any:
    valid = np.asarray(cloud.valid)[rows] & (rows >= 0)[:, None]
    return np.asarray(cloud.xyz)[rows], np.asarray(cloud.sigma_random)[rows], valid


def differs(one: Any, other: Any) -> bool:
    """Whether enough points have moved, appeared or vanished."""
    if one[0].shape[1:] != other[0].shape[1:]:
        return True
    count = min(len(one[0]), len(other[0]))
    gone = sum(int(cloud[2][count:].sum()) for cloud in (one, other))
    (xyz, sigma, valid), (xyz2, _, valid2) = ([field[:count] for field in cloud] for cloud in (one, other))
    moved = np.linalg.norm(xyz - xyz2, axis=-1) > MOVED * np.maximum(sigma, 1e-9)
    return gone + int(np.count_nonzero(valid != valid2) + np.count_nonzero(moved & valid & valid2)) >= POINTS


def attempt(base: Path, name: str, kind: str, mutate: Mutation, rng: np.random.Generator) -> tuple[Any, set[str]]:
    """A mutated copy, reconstructed."""
    with tempfile.TemporaryDirectory() as scratch:
        place = Place(Path(scratch) / "sweep", Path(scratch) / "calibration.json", base / "other")
        shutil.copytree(base / name, place.sweep)
        shutil.copy(base / "calibration.json", place.calibration)
        cached = kind.startswith("cache")
        if cached:
            reconstructed(place, True)
        mutate(place, rng)
        return reconstructed(place, cached)


def run(base: Path, each: int, seed: int, only: str) -> list[Outcome]:
    """All mutations of all kinds."""
    outcomes: list[Outcome] = []
    for capture, kinds in (("files", PICTURES), ("shards", SHARDS), ("mosaic", COLOURS)):
        chosen = {kind: mutate for kind, mutate in kinds.items() if only in kind}
        matters: dict[tuple[str, int], bool] = {}
        # An error hides how the cloud would have changed; the same mutation of the unsealed capture shows it.
        for state in ("unsealed", "sealed") if chosen else ():
            name = capture if state == "sealed" else f"{capture} unsealed"
            before, usual = attempt(base, name, "", lambda place, rng: None, np.random.default_rng(0))
            if usual:
                print(f"false alarm, {name}: {usual}")
            for kind, mutate in chosen.items():
                if state == "unsealed" and kind.startswith("seal "):
                    continue
                for k in range(each):
                    rng = np.random.default_rng([seed, k, zlib.crc32(kind.encode())])
                    after, notes = attempt(base, name, kind, mutate, rng)
                    changed = matters.get((kind, k), True) if after is None else differs(before, after)
                    matters[kind, k] = changed
                    new = notes - usual
                    outcomes.append(Outcome(kind, state, changed, bool(new), "; ".join(sorted(new))[:300]))
    return outcomes


def table(outcomes: list[Outcome]) -> str:
    """Counts per kind, as Markdown."""
    rows = []
    totals: dict[str, list[int]] = {"sealed": [0, 0], "unsealed": [0, 0]}
    for kind in dict.fromkeys(one.kind for one in outcomes):
        cells = []
        for state in totals:
            own = [one for one in outcomes if one.kind == kind and one.capture == state and one.changed]
            noticed = sum(one.noticed for one in own)
            totals[state] = [totals[state][0] + noticed, totals[state][1] + len(own)]
            cells.append(f"{noticed} of {len(own)}" if own else "–")
        rows.append([kind, *cells])
    parts = [f"{100 * seen / max(of, 1):.1f} % ({seen} of {of})" for seen, of in totals.values()]
    rows.append(["**all**", *(f"**{part}**" for part in parts)])
    return markdown(["kind", "sealed: noticed of changed", "unsealed: noticed of changed"], rows)


def main() -> int:
    """Run, print the table, and say whether the limits are met."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--each", type=int, default=10, help="mutations of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="kinds whose name has this text")
    parser.add_argument("--base", type=Path, help="folder for the rendered captures, used again if it exists")
    parser.add_argument("--results", type=Path, help="folder for silent_differences.md")
    options = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        base = options.base or Path(scratch)
        if not (base / "shards unsealed").exists():
            base.mkdir(parents=True, exist_ok=True)
            make(base, options.seed)
        outcomes = run(base, options.each, options.seed, options.only)
    text = table(outcomes)
    print(text)
    print(f"{len(outcomes)} mutations in {time.perf_counter() - start:.0f} s")
    met = True
    for state, limit in LIMITS.items():
        own = [one for one in outcomes if one.capture == state and one.changed]
        met &= sum(one.noticed for one in own) >= limit * len(own)
    write_json(options.json, [one._asdict() for one in outcomes])
    if options.results:
        command = f"python -m experiments.silent_differences --each {options.each} --seed {options.seed}"
        head = f"# Silent differences\n\nWritten by `{command}`; the file says how each column is counted.\n"
        (options.results / "silent_differences.md").write_text(f"{head}\n{text}\n")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
