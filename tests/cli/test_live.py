"""The cloud while it is being scanned is the cloud of the finished capture.

"The cloud" means every field of it, bit by bit: stripes are found by the same compiled function in
chunks of the same size and from the same search, which both learn from the first eight records; a
frame's stripes depend on nothing else beside the frame, so it does not matter in which chunk, when
or how often they are found. Points then come from stripes through the one function that makes them.
"""

import shutil
import threading
import time

import jax
import numpy as np
import pytest

from jaxscan import api
from jaxscan.cli.live import LiveCloud
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import Capture, CaptureHeader, open_capture
from jaxscan.files.recording import create_capture, resume_capture
from jaxscan.geometry import Scanner, stack_lasers
from jaxscan.reconstruction import IncomingStripes
from jaxscan.stripes import learn_noise


pytestmark = pytest.mark.more


FIELDS = ("xyz", "rgb", "intensity", "normals", "sigma_random", "sigma_systematic", "valid", "record", "laser", "angle")


@pytest.fixture
def folder(tiny, tmp_path):
    """The capture without stripes that an earlier reconstruction may have kept."""
    return shutil.copytree(tiny.sweep, tmp_path / "sweep", ignore=shutil.ignore_patterns("stripes.npz"))


@pytest.fixture(scope="module")
def scanner(tiny):
    return api.load_scanner(tiny.calibration)


@pytest.fixture(scope="module")
def expected(tiny, scanner, tmp_path_factory):
    folder = tmp_path_factory.mktemp("expected") / "sweep"
    shutil.copytree(tiny.sweep, folder, ignore=shutil.ignore_patterns("stripes.npz"))
    done = api.reconstruct_capture(open_capture(folder), scanner)
    assert not done.from_cache and done.cloud.valid.sum() > 5000
    return done.cloud


@pytest.fixture
def live(folder, scanner):
    capture = open_capture(folder)
    with LiveCloud(folder, capture.header, scanner, steps=len(capture)) as live:
        yield live


def feed(live, capture, numbers):
    for n in numbers:
        live.add(capture.records[n].i, capture.records[n].angle, *capture.frames(n))


def wait(done, seconds=120.0):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "nothing happens any more"
        time.sleep(0.01)


def assert_same(cloud, expected):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(cloud, name), getattr(expected, name), err_msg=name)


def test_pairs_as_they_come_give_the_cloud_of_the_capture(live, folder, expected, monkeypatch):
    capture = open_capture(folder)
    feed(live, capture, range(30))
    wait(lambda: live.status().records >= 8)
    feed(live, capture, range(30, 60))
    assert live.status().later == 0
    # No frame is read again.
    for name in ("frames", "chunks"):
        monkeypatch.setattr(Capture, name, lambda self, which: pytest.fail("a frame is read"))
    done = live.finish()
    assert (done.live, done.notes) == (True, ())
    assert_same(done.cloud, expected)
    status = live.status()
    assert (status.records, status.later, status.problem) == (60, 0, "")
    assert status.points == int(expected.valid.sum())


def test_noise_and_doubts_are_told_as_by_reconstruct(live, folder, scanner, monkeypatch):
    def doubtful(*frames, **words):
        return learn_noise(*frames, **words)._replace(doubts=("the images look odd",))

    monkeypatch.setattr("jaxscan.reconstruction.extraction.learn_noise", doubtful)
    capture = open_capture(folder)
    feed(live, capture, range(60))
    wait(lambda: live.status().records >= 8)
    done = live.finish()
    assert done.live and done.notes == ("the images look odd",)
    known = api.reconstruct_capture(capture, scanner, cache=False)
    assert "read noise" in done.noise and done.noise == known.noise


def test_lasers_that_take_turns(folder, tiny, scanner, tmp_path):
    """The same frames as of two lasers: of each its own first frames tell the width."""
    capture, sheet = open_capture(folder), scanner.lasers
    twice = stack_lasers([sheet.__class__(*(leaf[0] for leaf in jax.tree.leaves(sheet)))] * 2)
    both = Scanner(scanner.camera, twice, scanner.turntable, laser_names=("left", "right"), up=scanner.up)
    tables = capture.header.model_dump(exclude_none=True)
    header = CaptureHeader(**(tables | {"laser": [{"name": name} for name in both.laser_names]}))
    with create_capture(tmp_path / "two", header) as writer:
        for n, record in enumerate(capture.records):
            on, off = capture.frames(n)
            writer.append(angle_deg=float(np.degrees(record.angle)), on=on, off=off, lasers=[n % 2])
    two = open_capture(tmp_path / "two")
    with LiveCloud(tmp_path / "two", two.header, both, steps=60) as live:
        feed(live, two, range(60))
        done = live.finish()
    known = api.reconstruct_capture(two, both, cache=False)
    assert done.live and done.noise == known.noise and done.noise.count("laser") >= 2
    assert set(np.unique(done.cloud.laser)) == {0, 1}
    assert_same(done.cloud, known.cloud)


def test_frames_of_12_bits_are_read_from_the_disk(folder, scanner, tmp_path):
    """What comes from the camera's pages is in 8 bits; the levels of all bits are in the capture."""
    capture, random = open_capture(folder), np.random.default_rng(0)
    tables = capture.header.model_dump(exclude_none=True)
    tables["camera"]["bits"] = 12
    with create_capture(tmp_path / "deep", CaptureHeader(**tables)) as writer:
        for n, record in enumerate(capture.records):
            finer = [16 * frame.astype(np.uint16) + random.integers(0, 16, frame.shape) for frame in capture.frames(n)]
            on, off = (frame.astype(np.uint16) for frame in finer)
            writer.append(angle_deg=float(np.degrees(record.angle)), on=on, off=off)
    deep = open_capture(tmp_path / "deep")
    with LiveCloud(tmp_path / "deep", deep.header, scanner, steps=60) as live:
        for n, record in enumerate(deep.records):
            live.add(record.i, record.angle, *deep.pictures(n))
        wait(lambda: live.status().records >= 8)
        done = live.finish()
    known = api.reconstruct_capture(deep, scanner, cache=False)
    assert done.live and done.noise == known.noise and known.cloud.valid.sum() > 5000
    assert_same(done.cloud, known.cloud)


def test_points_are_counted_while_pairs_still_come(live, folder):
    feed(live, open_capture(folder), range(40))
    wait(lambda: live.status().points > 1000)
    assert 8 <= live.status().records <= 40


def test_whatever_the_order(live, folder, expected):
    # Those from which is learned come last, and some twice.
    order = [*range(8, 60), *range(59, 29, -1), *range(7, -1, -1)]
    feed(live, open_capture(folder), order)
    done = live.finish()
    assert done.live
    assert_same(done.cloud, expected)


def test_what_is_on_the_disk_already_is_taken_along(folder, scanner, expected):
    capture = open_capture(folder)
    with LiveCloud(folder, capture.header, scanner, steps=60) as live:
        assert live.add_from_disk() == 60
        wait(lambda: live.status().records >= 50)
        done = live.finish()
    assert done.live
    assert_same(done.cloud, expected)


def test_a_computer_that_does_not_keep_up_makes_nobody_wait(folder, scanner, monkeypatch):
    going, compute = threading.Event(), IncomingStripes.compute

    def slowly(self, pairs):
        assert going.wait(120)
        compute(self, pairs)

    monkeypatch.setattr(IncomingStripes, "compute", slowly)
    capture = open_capture(folder)
    pairs = [capture.frames(n) for n in range(60)]
    settings = api.ReconstructSettings(chunk_records=8)
    with LiveCloud(folder, capture.header, scanner, steps=60, settings=settings) as live:
        start = time.monotonic()
        for n, (on, off) in enumerate(pairs):
            live.add(n, capture.records[n].angle, on, off)
        # Sixty copies of 160 kB; waiting for the disk or for a chunk would end in `going.wait`.
        assert time.monotonic() - start < 30
        # Eight in the queue, eight in the chunk that is being computed.
        assert live.status().later >= 60 - 16
        going.set()
        done = live.finish()
    assert done.live
    # Chunks of another size are another compiled function, with other last places.
    assert_same(done.cloud, api.reconstruct_capture(capture, scanner, settings=settings).cloud)


def test_a_retake_replaces_the_pair(live, folder, scanner, expected):
    capture = open_capture(folder)
    feed(live, capture, range(60))
    # Record 30 is taken again, with the frames of record 31.
    on, off = capture.frames(31)
    with resume_capture(folder) as writer:
        writer.append(i=30, angle_deg=float(np.degrees(capture.records[30].angle)), on=on, off=off)
    live.add(30, capture.records[30].angle, on, off)
    done = live.finish()
    assert done.live
    assert not np.array_equal(done.cloud.xyz[30], expected.xyz[30])
    assert_same(done.cloud, api.reconstruct_capture(open_capture(folder), scanner).cloud)


def test_where_the_first_records_change_all_is_reconstructed(live, folder, scanner):
    capture = open_capture(folder)
    feed(live, capture, range(60))
    on, off = capture.frames(1)
    with resume_capture(folder) as writer:
        writer.append(i=0, angle_deg=float(np.degrees(capture.records[0].angle)), on=on, off=off)
    live.add(0, capture.records[0].angle, on, off)
    done = live.finish()
    assert not done.live and "first records" in done.notes[0]
    (folder / "stripes.npz").unlink(missing_ok=True)
    assert_same(done.cloud, api.reconstruct_capture(open_capture(folder), scanner).cloud)


def test_an_interrupted_sweep_gives_the_cloud_of_what_there_is(folder, scanner):
    journal = folder / "frames.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:40]))
    capture = open_capture(folder)
    with LiveCloud(folder, capture.header, scanner, steps=60) as live:
        feed(live, capture, range(40))
        done = live.finish()
    # In a sweep of 40 records a chunk has 32 too.
    assert done.live
    assert_same(done.cloud, api.reconstruct_capture(open_capture(folder), scanner).cloud)


def test_too_few_records_to_learn_from(folder, scanner):
    journal = folder / "frames.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:5]))
    capture = open_capture(folder)
    with LiveCloud(folder, capture.header, scanner, steps=60) as live:
        feed(live, capture, range(5))
        done = live.finish()
    assert not done.live
    (folder / "stripes.npz").unlink(missing_ok=True)
    assert_same(done.cloud, api.reconstruct_capture(open_capture(folder), scanner).cloud)


def test_what_goes_wrong_in_the_thread_is_told_and_made_good(live, folder, expected, monkeypatch):
    def fail(self, pairs):
        raise CaptureError("the sky fell")

    monkeypatch.setattr(IncomingStripes, "learn", fail)
    feed(live, open_capture(folder), range(60))
    wait(lambda: live.status().problem)
    assert live.status().problem == "the sky fell"
    done = live.finish()
    assert not done.live and "the sky fell" in done.notes[0]
    assert_same(done.cloud, expected)


def test_a_mistake_in_the_code_is_not_hidden(live, folder, monkeypatch):
    monkeypatch.setattr(IncomingStripes, "learn", lambda self, pairs: 1 / 0)
    feed(live, open_capture(folder), range(10))
    with pytest.raises(ZeroDivisionError):
        live.finish()


def test_another_camera_is_refused_before_anything_moves(folder, scanner):
    header = open_capture(folder).header
    camera = header.camera.model_copy(update={"width": 640})
    with pytest.raises(CalibrationError, match="320 x 256"):
        LiveCloud(folder, header.model_copy(update={"camera": camera}), scanner, steps=60)
