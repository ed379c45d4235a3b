"""Decoding ahead: the same frames as one by one, in bounded memory, and no threads left over."""

import threading
import time
import tracemalloc
import weakref

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files.capture import open_capture
from jaxscan.files.capture.images import RecordFrames, decode_ahead


class Made(RecordFrames):
    """Frames that a function fills, none of them in memory before."""

    def __init__(self, load):
        self.load = load

    def mapped(self, start, stop):
        return None

    def examine(self, record):
        raise AssertionError("nothing is mapped")


def decoding_threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("jaxscan-decode")]


@pytest.mark.parametrize("size", [1, 3, 7, 100])
def test_chunks_are_the_frames_in_order(folder, size):
    for i in range(7):
        folder.record(i)
    capture = open_capture(folder.path)
    chunks = list(capture.chunks(size))
    assert [len(chunk.on) for chunk in chunks] == [min(size, 7 - start) for start in range(0, 7, size)]
    for key, each in ((0, "on"), (1, "off")):
        streamed = np.concatenate([getattr(chunk, each) for chunk in chunks])
        assert np.array_equal(streamed, np.stack([capture.frames(index)[key] for index in range(7)]))
    assert not decoding_threads()
    with pytest.raises(ValueError, match="at least 1"):
        capture.chunks(0)


def test_early_close_leaves_no_threads(folder):
    for i in range(9):
        folder.record(i)
    chunks = open_capture(folder.path).chunks(2)
    # Nothing starts before the first chunk is asked for.
    assert not decoding_threads()
    next(chunks)
    assert decoding_threads()
    chunks.close()
    assert not decoding_threads()


def test_an_error_comes_where_its_chunk_would_have_come(folder):
    for i in range(6):
        folder.record(i)
    (folder.path / "off/000003.png").write_bytes(b"\x89PNG\r\n\x1a\nrubbish")
    chunks = open_capture(folder.path).chunks(2)
    assert len(next(chunks).on) == 2
    with pytest.raises(CaptureError, match="off/000003"):
        next(chunks)
    assert not decoding_threads()


def test_no_more_than_three_chunks_exist():
    """Three and that of the caller."""
    ended, alive = [], []

    def load(record, target):
        weakref.finalize(target.base, ended.append, record)
        alive.append(1 + record - len(ended))
        time.sleep(0.001)

    for _ in decode_ahead(40, 1, (4, 6), Made(load), None):
        pass
    assert len(alive) == 40 and max(alive) <= 4


def test_jax_may_borrow_the_memory_of_a_chunk():
    def load(record, target):
        target[...] = record

    lent = [jnp.asarray(chunk.on) for chunk in decode_ahead(30, 2, (64, 64), Made(load), None)]
    for start, frames in zip(range(0, 30, 2), lent, strict=True):
        assert np.asarray(frames)[:, 0, 0].tolist() == [start, start + 1]


def test_the_next_chunk_is_decoded_while_the_caller_computes():
    begun = threading.Event()

    def load(record, target):
        if record == 4:
            begun.set()

    chunks = decode_ahead(6, 2, (4, 6), Made(load), None)
    next(chunks)
    # The caller has asked for nothing more, and yet it happens; the limit only ends a failure.
    assert begun.wait(timeout=30)
    chunks.close()


def test_a_shard_is_not_loaded_whole(folder):
    # 120 MB in a sparse file of images 1000 times as large as those of the other tests.
    shape = (500, 400, 600)
    np.lib.format.open_memmap(folder.path / "on.npy", mode="w+", dtype=np.uint8, shape=shape)[0, 0, 0] = 7
    for i in range(20):
        folder.record(i, on=f"on.npy#{25 * i}", off=None)
    text = (folder.path / "capture.toml").read_text()
    (folder.path / "capture.toml").write_text(text.replace("= 6\n", "= 600\n").replace("= 4\n", "= 400\n"))
    tracemalloc.start()
    try:
        capture = open_capture(folder.path)
        chunks = capture.chunks(2)
        assert next(chunks).on[0, 0, 0] == 7
        for chunk in chunks:
            assert not chunk.on.any()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # Three chunks of 0.48 MB and Python's own; the 20 frames that are read would be 4.8 MB.
    assert peak < 3e6
