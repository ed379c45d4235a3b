"""Structured changes of a capture's journal."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


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


def two(records: list[Line], rng: Rng) -> tuple[int, int]:
    """Two different records."""
    one, other = rng.choice(len(records), 2, replace=False)
    return int(one), int(other)


def one_angle(records: list[Line], rng: Rng) -> None:
    """One angle is off by 0.1 to 30 degrees."""
    size = 10 ** rng.uniform(-1.0, 1.5)
    records[rng.integers(len(records))]["angle_deg"] += float(size * rng.choice([-1, 1]))


def exchanged_angles(records: list[Line], rng: Rng) -> None:
    """Two records have each other's angle."""
    a, b = (records[k] for k in two(records, rng))
    a["angle_deg"], b["angle_deg"] = b["angle_deg"], a["angle_deg"]


def equal_angles(records: list[Line], rng: Rng) -> None:
    """One record has the angle of the one before."""
    k = int(rng.integers(1, len(records)))
    records[k]["angle_deg"] = records[k - 1]["angle_deg"]


def all_angles(change: Callable[[float, Rng], float]) -> Mutation:
    """A mutation from a change that all angles have."""

    def mutate(place: Place, rng: Rng) -> None:
        seed = int(rng.integers(1 << 30))
        lines = read_lines(place.sweep)
        for line in lines:
            if "i" in line:
                line["angle_deg"] = float(change(line["angle_deg"], np.random.default_rng(seed)))
        write_lines(place.sweep, lines)

    return mutate


def removed(records: list[Line], rng: Rng) -> list[Line]:
    """One to nine records are missing within the sweep."""
    gone = set(rng.choice(np.arange(1, len(records) - 1), rng.integers(1, 10), replace=False).tolist())
    return [line for k, line in enumerate(records) if k not in gone]


def renumbered(records: list[Line], rng: Rng) -> list[Line]:
    """The same, and the rest have new numbers without gaps."""
    left = removed(records, rng)
    return [{**line, "i": k} for k, line in enumerate(left)]


def last_removed(records: list[Line], rng: Rng) -> list[Line]:
    """One to nine records are missing at the end."""
    return records[: -int(rng.integers(1, 10))]


def misspelt(records: list[Line], rng: Rng) -> None:
    """The number of a record is not read."""
    record = records[int(rng.integers(1, len(records) - 1))]
    record["I"] = record.pop("i")


def sides_exchanged(records: list[Line], rng: Rng) -> None:
    """One record names its images the wrong way round."""
    record = records[rng.integers(len(records))]
    record["on"], record["off"] = record["off"], record["on"]


def off_as_on(records: list[Line], rng: Rng) -> None:
    """One record names its laser-off image twice."""
    record = records[rng.integers(len(records))]
    record["on"] = record["off"]


def named_pair(records: list[Line], rng: Rng) -> None:
    """Two records name each other's images."""
    a, b = (records[k] for k in two(records, rng))
    for side in ("on", "off"):
        a[side], b[side] = b[side], a[side]


def named_side(side: str) -> Callable[[list[Line], Rng], None]:
    """A change in which one record names an image of another."""

    def change(records: list[Line], rng: Rng) -> None:
        a, b = two(records, rng)
        records[a][side] = records[b][side]

    return change
