"""Raw frames in shards: every frame that the journal names exists at any moment, and is read without a copy."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files import recording
from jaxscan.files.capture import open_capture
from jaxscan.files.recording import SHARD_BYTES, ShardStore, create_capture, resume_capture

from .conftest import FRAMES, header, journal


def begin(path, **keys):
    return create_capture(path, header(), storage="npy", **keys)


def fill(capture, count, start=0):
    for k in range(start, start + count):
        capture.append(angle_deg=0.1 * k, on=FRAMES[2 * k], off=FRAMES[2 * k + 1])


@pytest.fixture
def small(monkeypatch):
    """Shards of four records."""
    monkeypatch.setattr(recording, "SHARD_RECORDS", 4)


@pytest.mark.parametrize("durable", [True, False])
def test_what_is_written_is_read(tmp_path, small, durable):
    with begin(tmp_path / "room", durable=durable) as capture:
        fill(capture, 10)
    path = tmp_path / "room"
    assert [line["on"] for line in journal(path)] == [f"on/{k // 4:06d}.npy#{k % 4}" for k in range(10)]
    assert sorted(os.listdir(path / "off")) == ["000000.npy", "000001.npy", "000002.npy"]
    # Ordinary files of NumPy, and the last no longer than it has to be.
    shards = [np.load(path / "on" / f"{k:06d}.npy") for k in range(3)]
    assert [len(shard) for shard in shards] == [4, 4, 2]
    assert np.array_equal(np.concatenate(shards), FRAMES[0:20:2])
    read = open_capture(path)
    for k in range(10):
        on, off = read.frames(k)
        assert np.array_equal(on, FRAMES[2 * k]) and np.array_equal(off, FRAMES[2 * k + 1])
        assert on.flags.writeable


@pytest.mark.parametrize("size", [1, 2, 3, 4, 8, 100])
def test_chunks_within_a_shard_are_not_copied(tmp_path, small, size):
    with begin(tmp_path / "room", durable=False) as capture:
        fill(capture, 10)
    start = 0
    for chunk in open_capture(tmp_path / "room").chunks(size):
        stop = min(start + size, 10)
        for frames, side in ((chunk.on, 0), (chunk.off, 1)):
            assert np.array_equal(frames, FRAMES[2 * start + side : 2 * stop : 2])
            # A view of the file cannot be written to; a copy can.
            assert frames.flags.writeable == (start // 4 != (stop - 1) // 4)
        start = stop
    assert start == 10


def test_a_view_outlives_the_capture(tmp_path):
    with begin(tmp_path / "room", durable=False) as capture:
        fill(capture, 4)
    (chunk,) = open_capture(tmp_path / "room").chunks(4)
    shutil.rmtree(tmp_path / "room")
    assert not chunk.on.flags.writeable and np.array_equal(chunk.on, FRAMES[0:8:2])


def test_each_side_is_mapped_or_decoded_by_itself(tmp_path):
    with begin(tmp_path / "room", durable=False) as capture:
        fill(capture, 4)
    path = tmp_path / "room"
    from jaxscan.vision import encode_png

    (path / "off/2.png").write_bytes(encode_png(FRAMES[20]))
    lines = journal(path)
    lines[2]["off"] = "off/2.png"
    (path / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (chunk,) = open_capture(path).chunks(4)
    assert not chunk.on.flags.writeable and chunk.off.flags.writeable
    assert np.array_equal(chunk.off, [FRAMES[1], FRAMES[3], FRAMES[20], FRAMES[7]])


def test_a_retake_is_appended_and_read_in_its_place(tmp_path):
    with begin(tmp_path / "room") as capture:
        fill(capture, 4)
        capture.flush()
        before = (tmp_path / "room/on/000000.npy").read_bytes()
        capture.append(angle_deg=0.15, on=FRAMES[30], off=FRAMES[31], i=1)
    read = open_capture(tmp_path / "room")
    assert journal(tmp_path / "room")[-1]["on"] == "on/000000.npy#4"
    (chunk,) = read.chunks(4)
    assert np.array_equal(chunk.on, [FRAMES[0], FRAMES[30], FRAMES[4], FRAMES[6]])
    # The images of the first takes, behind the header, are as they were.
    after = (tmp_path / "room/on/000000.npy").read_bytes()
    assert after[128 : 128 + 4 * 24] == before[128 : 128 + 4 * 24]


@pytest.mark.parametrize(
    ("shape", "count", "length"),
    [
        ((1024, 1280), 1, 32),
        ((1024, 1280, 3), 1, 16),
        ((2048, 2448, 3), 1, 4),
        ((9000, 9000), 1, 1),
        ((1024, 1280), 3, 48),
    ],
)
def test_the_size_of_shards(tmp_path, shape, count, length):
    (tmp_path / "on").mkdir()
    shards = ShardStore(tmp_path, shape, durable=False, digests=False)
    names = []
    for _ in range(length // count + 1):
        names += shards.names("on", "", count)
        shards.take("on", count)
    assert names[length - 1] == f"on/000000.npy#{length - 1}" and names[length] == "on/000001.npy#0"
    assert length == count or length * np.prod(shape) <= SHARD_BYTES


def test_what_a_crash_leaves_is_a_capture(tmp_path, small):
    """At every moment, of which these are a few: the files as they are, without the end of the writer."""
    path = tmp_path / "room"
    with begin(path) as capture:
        for k in range(7):
            fill(capture, 1, start=k)
            capture.flush()
            crashed = shutil.copytree(path, tmp_path / f"crashed{k}")
            # The next record was on its way: its images are there, of its line a part, of its shard only the name.
            whole = (crashed / "frames.jsonl").read_bytes()
            (crashed / "frames.jsonl").write_bytes(whole + whole[:20])
            (crashed / f"on/{k // 4 + 1:06d}.npy").touch()
            read = open_capture(crashed)
            assert len(read) == k + 1 and "cut off" in read.notes[0]
            streamed = np.concatenate([chunk.off for chunk in read.chunks(4)])
            assert np.array_equal(streamed, FRAMES[1 : 2 * k + 2 : 2])
            with resume_capture(crashed) as resumed:
                fill(resumed, 1, start=k + 1)
            assert np.array_equal(open_capture(crashed).frames(k + 1)[0], FRAMES[2 * k + 2])


def test_a_record_that_does_not_fit_leaves_no_gap(tmp_path):
    with begin(tmp_path / "room") as capture:
        for bad in ({"time": object()}, {"on": FRAMES[0].T}, {"angle_deg": None}):
            with pytest.raises(CaptureError):
                capture.append(**{"angle_deg": 0.0, "on": FRAMES[0], **bad})
        capture.append(angle_deg=0.0, on=FRAMES[0])
    assert journal(tmp_path / "room")[0]["on"] == "on/000000.npy#0"
    assert os.listdir(tmp_path / "room/off") == []


def test_resuming(tmp_path, small):
    path = tmp_path / "room"
    with begin(path) as capture:
        fill(capture, 6)
    before = {file: hashlib.sha256(file.read_bytes()).digest() for file in path.glob("o*/*.npy")}
    with (path / "frames.jsonl").open("ab") as file:
        file.write(b'{"i": 6, "ang')
    # A crash may leave a shard that the journal does not know.
    (path / "on/000002.npy").write_bytes(b"\x93NUMPY")
    with resume_capture(path) as capture:
        fill(capture, 3, start=6)
        capture.append(angle_deg=0.0, on=FRAMES[30], off=FRAMES[31], i=0)
    assert [line["on"] for line in journal(path)[7:]] == [f"on/000003.npy#{k}" for k in range(4)]
    assert {file: hashlib.sha256(file.read_bytes()).digest() for file in before} == before
    read = open_capture(path)
    streamed = np.concatenate([chunk.on for chunk in read.chunks(4)])
    assert np.array_equal(streamed, [FRAMES[30], *FRAMES[2:18:2]])
    # Which storage goes on may be said; nothing is written over either way.
    with resume_capture(path, storage="png") as capture:
        fill(capture, 1, start=9)
    assert journal(path)[-1]["on"] == "on/000009.png" and len(open_capture(path)) == 10
    with resume_capture(path) as capture:
        fill(capture, 1, start=10)
    assert journal(path)[-1]["on"] == "on/000010.png"


def test_a_shard_that_is_exchanged_while_it_is_read(tmp_path):
    with begin(tmp_path / "room", durable=False) as capture:
        fill(capture, 4)
    read = open_capture(tmp_path / "room")
    np.save(tmp_path / "shorter.npy", FRAMES[:2])
    (tmp_path / "shorter.npy").rename(tmp_path / "room/on/000000.npy")
    with pytest.raises(CaptureError, match=r"on/000000\.npy#3: the shard has only 2 images"):
        next(read.chunks(4))
    with pytest.raises(CaptureError, match=r"on/000000\.npy#2"):
        read.frames(2)


def test_more_shards_than_may_be_open(folder):
    """A process has about a thousand files; a capture may have more shards."""
    import resource

    for i in range(80):
        np.save(folder.path / f"{i}.npy", FRAMES[i % 40][None])
        folder.record(i, on=f"{i}.npy#0", off=None)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 200
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(used + 60, soft), hard))
    try:
        chunks = open_capture(folder.path).chunks(5)
        streamed = np.concatenate([np.array(chunk.on) for chunk in chunks])
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert np.array_equal(streamed, FRAMES[np.arange(80) % 40])


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["npy", "png", "zstd"])
def test_a_killed_writer_leaves_a_capture_of_the_records_before(tmp_path, storage):
    """Frame k is filled with k: every frame that is read is complete, and resuming appends after it."""
    code = f"""
import numpy as np
from jaxscan.files.capture import CaptureHeader
from jaxscan.files import recording
from jaxscan.files.recording import create_capture
head = CaptureHeader(kind="sweep", camera={{"width": 640, "height": 480, "pixel_format": "mono8"}}, laser=[{{}}])
with create_capture({str(tmp_path / "room")!r}, head, storage={storage!r}) as capture:
    for k in range(100_000):
        frame = np.full((480, 640), k % 251, np.uint8)
        capture.append(angle_deg=0.01 * k, on=frame, off=frame)
"""
    path = tmp_path / "room"
    process = subprocess.Popen([sys.executable, "-c", code])
    try:
        deadline = time.monotonic() + 120
        while not (path / "frames.jsonl").is_file() or (path / "frames.jsonl").stat().st_size < 4000:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    read = open_capture(path)
    found = [value for chunk in read.chunks(32) for value in zip(chunk.on, chunk.off, strict=True)]
    assert len(found) == len(read) > 30
    for k, (on, off) in enumerate(found):
        assert (on == k % 251).all() and (off == k % 251).all()
    with resume_capture(path) as capture:
        frame = np.full((480, 640), 7, np.uint8)
        assert capture.append(angle_deg=1.0, on=frame, off=frame) == len(found)
    assert (open_capture(path).frames(len(found))[0] == 7).all()
