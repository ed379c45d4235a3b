"""Repacking: the same records with the same keys, their images stored in another way."""

import os

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files import recording
from jaxscan.files.capture import SEAL, open_capture
from jaxscan.files.recording import repack_capture

from .conftest import BOARD, LASER, journal


def records_of(path):
    """The lines of a journal that we wrote, without digests and seal."""
    *values, end = journal(path)
    assert (
        end["event"] == "seal"
        and set(end["source"]) == {SEAL}
        and all("sha256" in value for value in values if "i" in value)
    )
    return [{key: value for key, value in line.items() if key != "sha256"} for line in values]


def without_names(line):
    def bare(value):
        return [{**one, "file": 0} for one in value] if isinstance(value, list) else value and 0

    return {key: bare(value) if key in ("on", "off") else value for key, value in line.items()}


def same(source, target):
    """Every record and every image of two captures."""
    first, second = open_capture(source), open_capture(target)
    assert first.header == second.header
    assert [(r.i, r.angle, r.placement, r.lasers) for r in first.records] == [
        (r.i, r.angle, r.placement, r.lasers) for r in second.records
    ]
    for k in range(len(first)):
        for one, other in zip(first.frames(k), second.frames(k), strict=True):
            assert (one is None) == (other is None)
            assert one is None or np.array_equal(one, other)
    return first, second


def test_there_and_back(folder, tmp_path):
    text = (folder.path / "capture.toml").read_text()
    (folder.path / "capture.toml").write_text(f"# by hand\n{text}[acquisition]\nx = [1, 2.50]\n")
    # Keys that are also names in the program.
    odd = {"fields": {"a": None}, "images": [], "number": 1, "angle": "x"}
    for k in range(5):
        folder.record(k, time="2024-01-01T00:00:00Z", microsteps=7 * k, lasers=["red"], **odd)
    done = []
    fast = tmp_path / "fast"
    repack_capture(folder.path, fast, storage="npy", progress=lambda *counts: done.append(counts))
    assert done == [(k + 1, 5) for k in range(5)]
    assert [line["off"] for line in records_of(fast)] == [f"off/000000.npy#{k}" for k in range(5)]
    assert (fast / "capture.toml").read_bytes() == (folder.path / "capture.toml").read_bytes()
    assert [without_names(line) for line in records_of(fast)] == [without_names(line) for line in journal(folder.path)]
    same(folder.path, fast)
    (chunk,) = open_capture(fast).chunks(5)
    assert not chunk.on.flags.writeable
    repack_capture(fast, tmp_path / "packed", storage="zstd")
    assert [line["off"] for line in records_of(tmp_path / "packed")] == [f"off/{k:06d}.zst" for k in range(5)]
    same(folder.path, tmp_path / "packed")
    repack_capture(tmp_path / "packed", tmp_path / "back", storage="png")
    assert records_of(tmp_path / "back") == journal(folder.path)
    same(folder.path, tmp_path / "back")


def test_retakes_events_and_a_torn_line(folder, tmp_path):
    for k in (1, 0, 2):
        folder.record(k)
    folder.line('{"event": "fault", "why": [1]}')
    folder.record(3)
    folder.line('{"event": "resume"}')
    folder.record(1, note="again", off="off/000000.png")
    folder.line('{"i": 9, "ang')
    _, target = same(folder.path, repack_capture(folder.path, tmp_path / "fast", storage="npy").path)
    assert target.notes == ()
    order = [line.get("i", line.get("event")) for line in records_of(target.path)]
    assert order == [0, 1, 2, "fault", 3, "resume"] and journal(target.path)[1]["note"] == "again"
    assert [line["on"] for line in journal(target.path) if "i" in line] == [f"on/000000.npy#{k}" for k in range(4)]


def test_a_calibration_with_lists_and_missing_keys(folder, tmp_path):
    folder.header(kind="calibration", rest=LASER + BOARD)
    folder.record(0, placement=2)
    folder.record(1, on=None)
    folder.line('{"i": 2, "off": "off/000000.png"}')
    pair = [{"file": f"on/{k:06d}.png", "exposure_s": 0.1, "gain": k} for k in range(2)]
    folder.record(3, on=pair, off=None)
    target = tmp_path / "fast"
    repack_capture(folder.path, target, storage="npy")
    same(folder.path, target)
    assert records_of(target)[2] == {"i": 2, "off": "off/000000.npy#2"}
    assert records_of(target)[3]["on"] == [
        {"file": "on/000000.npy#1", "exposure_s": 0.1, "gain": 0},
        {"file": "on/000000.npy#2", "exposure_s": 0.1, "gain": 1},
    ]


def test_an_existing_target_and_a_missing_folder(folder, tmp_path):
    folder.record(0)
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").symlink_to("nowhere")
    for name in ("empty", "broken", "room"):
        with pytest.raises(CaptureError, match=f"{name}: exists; choose another folder"):
            repack_capture(folder.path, tmp_path / name, storage="npy")
    with pytest.raises(CaptureError, match="create it first"):
        repack_capture(folder.path, tmp_path / "no" / "where", storage="npy")
    assert sorted(os.listdir(tmp_path)) == ["broken", "empty", "room"]


@pytest.mark.parametrize("broken", ["image", "disk", "interrupt"])
def test_nothing_is_left_behind(folder, tmp_path, monkeypatch, broken):
    for k in range(6):
        folder.record(k)

    def progress(done, total):
        if broken == "interrupt" and done == 3:
            raise KeyboardInterrupt

    def full(self, name, image):
        raise CaptureError(f"{name}: cannot be written: No space left on device.")

    if broken == "image":
        (folder.path / "on/000004.png").write_bytes(b"\x89PNG\r\n\x1a\nrubbish")
    if broken == "disk":
        monkeypatch.setattr(recording.ShardStore, "write", full)
    before = sorted(os.listdir(folder.path / "on"))
    with pytest.raises((CaptureError, KeyboardInterrupt)) as caught:
        repack_capture(folder.path, tmp_path / "fast", storage="npy", progress=progress)
    assert {"image": "on/000004.png", "disk": "No space left", "interrupt": ""}[broken] in str(caught.value)
    assert os.listdir(tmp_path) == ["room"] and sorted(os.listdir(folder.path / "on")) == before


def test_a_capture_that_grows_meanwhile_is_refused(folder, tmp_path, monkeypatch):
    folder.record(0)
    capture = open_capture(folder.path)
    monkeypatch.setattr("jaxscan.files.recording.open_capture", lambda path: capture)
    folder.record(1)
    with pytest.raises(CaptureError, match="has changed while it was read"):
        repack_capture(folder.path, tmp_path / "fast", storage="npy")
    assert os.listdir(tmp_path) == ["room"]
