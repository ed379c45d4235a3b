"""Writing captures: every image that the journal names is on the disk."""

import errno
import functools
import os
import threading

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files import recording
from jaxscan.files.capture import header_toml, open_capture, parse_header
from jaxscan.files.recording import create_capture, resume_capture

from .conftest import CAMERA, FRAMES, header, journal


def nested(depth):
    value = []
    for _ in range(depth - 1):
        value = [value]
    return value


@pytest.mark.parametrize("durable", [True, False])
def test_what_is_written_is_read(tmp_path, durable):
    with create_capture(tmp_path / "new" / "room", header(), durable=durable) as capture:
        for k in range(6):
            assert capture.append(angle_deg=0.1 * k, on=FRAMES[2 * k], off=FRAMES[2 * k + 1], microsteps=k) == k
        capture.event("pause", reason="door")
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("jaxscan-encode")]
    path = tmp_path / "new" / "room"
    assert [line.get("i", line.get("event")) for line in journal(path)] == [0, 1, 2, 3, 4, 5, "pause"]
    assert journal(path)[2] == {
        "i": 2,
        "angle_deg": 0.2,
        "on": "on/000002.zst",
        "off": "off/000002.zst",
        "microsteps": 2,
    }
    assert sorted(os.listdir(path)) == ["capture.toml", "frames.jsonl", "off", "on"]
    read = open_capture(path)
    assert read.header == header()
    (chunk,) = read.chunks(6)
    assert np.array_equal(chunk.on, FRAMES[:12:2]) and np.array_equal(chunk.off, FRAMES[1:12:2])
    assert np.array_equal(read.angles, np.radians([0.1 * k for k in range(6)]))


def test_a_calibration_in_colour(tmp_path):
    images = FRAMES[:6].reshape(2, 4, 6, 3)
    head = header("calibration", camera={**CAMERA, "pixel_format": "rgb8"}, turntable={"carries": "object"})
    with create_capture(tmp_path / "boards", head) as capture:
        capture.append(angle_deg=None, off=images[0], placement=1)
        capture.append(angle_deg=5, on=images[1], placement=1, lasers=["red"])
    read = open_capture(tmp_path / "boards")
    assert read.carries == "object"
    assert np.array_equal(read.frames(0)[1], images[0]) and read.frames(0)[0] is None
    assert np.array_equal(read.frames(1)[0], images[1]) and read.records[1].placement == 1


@pytest.mark.parametrize(
    "head",
    [
        header(plan={"steps": 3600}, acquisition={"who": "me", "list": [1, {"a": 2.5}]}),
        header(laser=[{"name": "red"}, {"name": "g n", "colour": "green", "stripe_axis": "columns"}]),
        header("calibration", laser=[], turntable={"carries": "object"}),
    ],
)
def test_headers_come_back(head):
    assert parse_header(header_toml(head), name="capture.toml") == head


def test_a_retake_keeps_the_first_take_until_the_line_is_written(tmp_path):
    with create_capture(tmp_path / "room", header()) as capture:
        capture.append(angle_deg=0.0, on=FRAMES[0])
        capture.append(angle_deg=1.0, on=FRAMES[1])
        assert capture.append(angle_deg=0.5, on=FRAMES[2], i=0) == 0
        assert capture.append(angle_deg=2.0, on=FRAMES[3]) == 2
    assert len({line["on"] for line in journal(tmp_path / "room")}) == 4
    read = open_capture(tmp_path / "room")
    assert np.array_equal(read.frames(0)[0], FRAMES[2]) and read.angles[0] == np.radians(0.5)


def test_lines_follow_images_in_order(tmp_path, monkeypatch):
    """While the first image is not written, later lines wait, however fast their images are."""
    release, original = threading.Event(), recording.write_atomically

    def slow(path, content, **keys):
        if path.name == "000000.zst":
            assert release.wait(timeout=30)
        original(path, content, **keys)

    monkeypatch.setattr(recording, "write_atomically", slow)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    with create_capture(tmp_path / "room", header()) as capture:
        for k in range(4):
            capture.append(angle_deg=float(k), on=FRAMES[k])
        assert journal(tmp_path / "room") == []
        release.set()
        capture.flush()
        assert [line["i"] for line in journal(tmp_path / "room")] == [0, 1, 2, 3]


def test_a_full_disk_is_one_clear_error_and_keeps_what_is_complete(tmp_path, monkeypatch):
    original = recording.write_atomically

    def full(path, content, **keys):
        if path.name == "000002.zst":

            def content(_):
                raise OSError(errno.ENOSPC, "No space left on device")

        original(path, content, **keys)

    capture = create_capture(tmp_path / "room", header())
    monkeypatch.setattr(recording, "write_atomically", full)
    for k in range(2):
        capture.append(angle_deg=float(k), on=FRAMES[k])
    # It is said as soon as it is known.
    with pytest.raises(CaptureError, match=r"on/000002\.zst: cannot be written: No space left on device"):
        capture.append(angle_deg=2.0, on=FRAMES[2])
        capture.flush()
    # The record after a lost one must not slip in, and closing is quiet: the error has been raised.
    with pytest.raises(CaptureError, match="No space left"):
        capture.append(angle_deg=3.0, on=FRAMES[3])
    capture.close()
    assert len(open_capture(tmp_path / "room")) == 2
    assert sorted(os.listdir(tmp_path / "room" / "on")) == ["000000.zst", "000001.zst"]


def test_an_interrupt_keeps_the_records_so_far(tmp_path):
    with pytest.raises(KeyboardInterrupt), create_capture(tmp_path / "room", header()) as capture:
        capture.append(angle_deg=0.0, on=FRAMES[0])
        raise KeyboardInterrupt
    assert len(open_capture(tmp_path / "room")) == 1
    with pytest.raises(CaptureError, match="closed"):
        capture.append(angle_deg=0.0, on=FRAMES[0])


def test_an_existing_folder_is_refused(tmp_path):
    create_capture(tmp_path / "room", header()).close()
    before = (tmp_path / "room" / "capture.toml").read_bytes()
    with pytest.raises(CaptureError, match=r"room: exists and is not empty"):
        create_capture(tmp_path / "room", header(plan={"steps": 3}))
    assert (tmp_path / "room" / "capture.toml").read_bytes() == before
    (tmp_path / "empty").mkdir()
    create_capture(tmp_path / "empty", header()).close()
    (tmp_path / "file").write_text("")
    with pytest.raises(CaptureError, match="file: cannot be created"):
        create_capture(tmp_path / "file", header())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"angle_deg": None, "on": FRAMES[0]}, "a sweep needs angle_deg"),
        ({"angle_deg": 1.0}, "a sweep needs angle_deg and a laser-on image"),
        ({"angle_deg": float("nan"), "on": FRAMES[0]}, "not finite"),
        (
            {"angle_deg": 1.0, "on": FRAMES[0].T},
            r"on: found uint8 with shape \(6, 4\), expected uint8 with shape \(4, 6\)",
        ),
        ({"angle_deg": 1.0, "on": FRAMES[0], "off": FRAMES[0].astype(float)}, "off: found float64"),
        ({"angle_deg": 1.0, "on": FRAMES[0], "i": -1}, "negative"),
        ({"angle_deg": 1.0, "on": FRAMES[0], "time": object()}, "only JSON values"),
        ({"angle_deg": 1.0, "on": FRAMES[0], "note": "x" * 70_000}, "more than 65536"),
        ({"angle_deg": 1.0, "on": FRAMES[0], "note": nested(5000)}, "nested too deeply"),
    ],
)
def test_records_that_do_not_fit(tmp_path, keys, message):
    with create_capture(tmp_path / "room", header()) as capture:
        with pytest.raises(CaptureError, match=message):
            capture.append(**keys)
        # Nothing of it is left, and the next record is as good as ever.
        assert capture.append(angle_deg=0.0, on=FRAMES[0]) == 0
    assert os.listdir(tmp_path / "room" / "on") == ["000000.zst"]
    assert len(open_capture(tmp_path / "room")) == 1


@pytest.mark.parametrize("end", ["whole", "no newline", "torn", "rubbish"])
def test_resuming_after_a_crash(tmp_path, end):
    path = tmp_path / "room"
    with create_capture(path, header()) as capture:
        for k in range(3):
            capture.append(angle_deg=float(k), on=FRAMES[k])
        capture.append(angle_deg=0.5, on=FRAMES[3], i=0)
    data = (path / "frames.jsonl").read_bytes()
    torn = {"whole": data, "no newline": data[:-1], "torn": data + b'{"i": 3, "ang', "rubbish": data + bytes(9) + b"\n"}
    (path / "frames.jsonl").write_bytes(torn[end])
    with resume_capture(path) as capture:
        assert capture.append(angle_deg=3.0, on=FRAMES[4]) == 3
        capture.append(angle_deg=0.25, on=FRAMES[5], i=0)
    read = open_capture(path)
    assert read.notes == () and [record.i for record in read.records] == [0, 1, 2, 3]
    assert np.array_equal(read.frames(0)[0], FRAMES[5]) and np.array_equal(read.frames(3)[0], FRAMES[4])
    assert [line.get("i", line.get("event")) for line in journal(path)] == [0, 1, 2, 0, "resume", 3, 0]
    # No take was written over another.
    assert len({line["on"] for line in journal(path) if "on" in line}) == 6


def test_resuming_before_the_first_record_and_where_there_is_no_capture(tmp_path):
    create_capture(tmp_path / "room", header()).close()
    with resume_capture(tmp_path / "room") as capture:
        assert capture.append(angle_deg=0.0, on=FRAMES[0]) == 0
    with pytest.raises(CaptureError, match=r"nothing.*no such file"):
        resume_capture(tmp_path / "nothing")
    (tmp_path / "room" / "frames.jsonl").write_bytes(b"{torn\n{torn\n")
    with pytest.raises(CaptureError, match="line 1"):
        resume_capture(tmp_path / "room")


def test_a_capture_is_not_begun_through_a_link(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "on").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(CaptureError, match="on: found a link"):
        create_capture(tmp_path / "room", header())
    assert not list((tmp_path / "elsewhere").iterdir()) and not (tmp_path / "room" / "capture.toml").exists()


@pytest.mark.parametrize("storage", ["zstd", "png", "npy"])
def test_resuming_writes_through_no_link(tmp_path, storage):
    """A capture of a stranger may hold links under all the names that the next records will have."""
    path = tmp_path / "room"
    with create_capture(path, header(), storage=storage) as capture:
        for k in range(2):
            capture.append(angle_deg=float(k), on=FRAMES[k], off=FRAMES[k])
    (tmp_path / "victim").write_bytes(b"precious")
    names = [f"{k:06d}{retake}" for k in range(8) for retake in ("", "-1", "_0")]
    for side in ("on", "off"):
        for name in (
            *[name + end for name in names for end in (".zst", ".png")],
            *[f"{k:06d}.npy" for k in range(1, 6)],
        ):
            if not (path / side / name).exists():
                leads_to = tmp_path / ("victim" if side == "on" else "made")
                (path / side / name).symlink_to(leads_to)
    with resume_capture(path) as capture:
        for k in range(2, 6):
            capture.append(angle_deg=float(k), on=FRAMES[k], off=FRAMES[k])
        capture.append(angle_deg=0.5, on=FRAMES[6], off=FRAMES[6], i=0)
    assert (tmp_path / "victim").read_bytes() == b"precious" and not (tmp_path / "made").exists()
    read = open_capture(path)
    assert [np.array_equal(read.frames(k)[0], FRAMES[k or 6]) for k in range(6)] == [True] * 6


@pytest.mark.parametrize("name", ["on", "off", "frames.jsonl", "capture.toml"])
def test_a_capture_with_a_link_in_place_of_its_own_is_not_resumed(tmp_path, name):
    path = tmp_path / "room"
    create_capture(path, header()).close()
    (path / name).rename(tmp_path / "elsewhere")
    (path / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(CaptureError, match=f"{name}: found a link"):
        resume_capture(path)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (nested(500), "nested too deeply"),
        (functools.reduce(lambda inner, _: {"a": inner}, range(63), 1), "nested too deeply"),
        ("x" * (1 << 20), "the header has 1048"),
    ],
)
def test_a_header_that_could_not_be_read_again_is_not_written(tmp_path, value, message):
    with pytest.raises(CaptureError, match=message):
        create_capture(tmp_path / "room", header(acquisition={"a": value}))
    assert os.listdir(tmp_path) == []
