"""Kept stripes: they come back as they were, under their own key, or not at all."""

import hashlib
import io
import json
import os
import zipfile

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files.capture import cache_path, cached_stripes, frames_key, open_capture, save_stripes
from jaxscan.files.capture.stripe_cache import load_stripes

from .test_arrays import archive


RNG = np.random.default_rng(7)
ARRAYS = {
    "u": RNG.random((9, 20), dtype=np.float32),
    "saturated": RNG.integers(0, 3, (9, 20), np.uint8),
    "valid": RNG.random((9, 20)) < 0.5,
    "rgb": RNG.integers(0, 256, (9, 20, 3), np.uint8),
    "record": np.arange(9, dtype=np.int32),
    "none": np.zeros((0, 20), np.float32),
}
EMPTY = {"format": "jaxscan-stripes/3", "key": {}, "sha256": hashlib.sha256(b"").hexdigest()}
KEY = {"frames": "sha256:00", "settings": {"k": [1, 2.5, None]}, "version": 3}


@pytest.fixture
def cache(tmp_path):
    save_stripes(tmp_path / "stripes.npz", ARRAYS, KEY)
    return tmp_path / "stripes.npz"


def test_they_come_back(cache):
    arrays, key = load_stripes(cache)
    assert key == KEY and arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype and np.array_equal(arrays[name], array)
        assert arrays[name].flags.writeable
    assert os.listdir(cache.parent) == ["stripes.npz"]


def test_only_under_their_own_key(cache):
    assert np.array_equal(cached_stripes(cache, KEY)["u"], ARRAYS["u"])
    # Keys are compared as JSON: a tuple is a list.
    assert cached_stripes(cache, {**KEY, "settings": {"k": (1, 2.5, None)}}) is not None
    for other in ({}, {**KEY, "version": 4}, {**KEY, "more": None}):
        assert cached_stripes(cache, other) is None
    assert cached_stripes(cache.with_name("nowhere.npz"), KEY) is None


def test_a_newer_one_replaces_it_and_a_failure_does_not(cache, monkeypatch):
    save_stripes(cache, {"u": ARRAYS["u"] + 1}, {"new": True})
    assert cached_stripes(cache, KEY) is None and load_stripes(cache)[1] == {"new": True}

    def full(path, arrays):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("jaxscan.files.capture.stripe_cache.write_arrays", full)
    with pytest.raises(CaptureError, match="No space left"):
        save_stripes(cache, ARRAYS, KEY)
    assert load_stripes(cache)[1] == {"new": True} and os.listdir(cache.parent) == ["stripes.npz"]


@pytest.mark.parametrize(
    "arrays", [{"key": np.zeros(1)}, {"u": np.array([object()])}, {"u": np.array(["a"])}, {"u": np.zeros(1, complex)}]
)
def test_only_numbers_are_kept(tmp_path, arrays):
    with pytest.raises(ValueError, match="must hold numbers"):
        save_stripes(tmp_path / "stripes.npz", arrays, KEY)
    with pytest.raises(ValueError, match="JSON"):
        save_stripes(tmp_path / "stripes.npz", {}, {"x": float("nan")})
    assert os.listdir(tmp_path) == []


def test_any_cut_and_any_changed_byte_of_the_arrays_is_noticed(cache):
    whole = cache.read_bytes()
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        cache.write_bytes(whole[:length])
        with pytest.raises(CaptureError, match=r"stripes\.npz"):
            load_stripes(cache)
        assert cached_stripes(cache, KEY) is None
    start = whole.index(ARRAYS["u"].tobytes())
    for at in (start, start + 300, start + ARRAYS["u"].nbytes - 1):
        cache.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(CaptureError, match="CRC"):
            load_stripes(cache)
        assert cached_stripes(cache, KEY) is None


@pytest.mark.parametrize("seed", range(8))
def test_rubbish_is_refused_or_harmless(cache, seed):
    data = bytearray(cache.read_bytes())
    rng = np.random.default_rng(seed)
    for at in rng.integers(0, len(data), 8):
        data[at] = rng.integers(256)
    cache.write_bytes(bytes(data))
    try:
        arrays, _ = load_stripes(cache)
    except CaptureError as problem:
        assert "\n" not in str(problem)
    else:
        # The damaged byte does not matter, as a time in the archive.
        assert arrays.keys() == ARRAYS.keys()
        assert all(np.array_equal(arrays[name], array) for name, array in ARRAYS.items())


def npy(array):
    text = io.BytesIO()
    np.save(text, array)
    return text.getvalue()


def test_hostile_archives(tmp_path):
    path = tmp_path / "stripes.npz"
    about = npy(np.frombuffer(json.dumps(EMPTY).encode(), np.uint8))
    archive(path, [("key.npy", about)])
    assert load_stripes(path) == ({}, {})
    archive(path, [("key.npy", about), ("u.npy", npy(np.zeros(3)))])
    with pytest.raises(CaptureError, match="does not hold the arrays that it lists"):
        load_stripes(path)
    archive(path, [("key.npy", about), ("u.npy", npy(np.array(["text"])))])
    with pytest.raises(CaptureError, match="does not hold the arrays that it lists"):
        load_stripes(path)
    archive(path, [("key.npy", about), ("u.npy", npy(np.zeros(1 << 22)))], zipfile.ZIP_DEFLATED)
    with pytest.raises(CaptureError, match="compressed"):
        load_stripes(path)
    for text in (
        b"",
        b"{",
        b"[]",
        b'{"format": "jaxscan-stripes/3", "key": {}}',
        b'{"format": "jaxscan-stripes/3"}',
    ):
        archive(path, [("key.npy", npy(np.frombuffer(text, np.uint8)))])
        with pytest.raises(CaptureError):
            load_stripes(path)
    archive(path, [("key.npy", npy(np.zeros((2, 2))))])
    with pytest.raises(CaptureError, match="holds no stripes"):
        load_stripes(path)


@pytest.mark.parametrize("leads_to", ["victim", "nowhere"])
def test_a_link_is_neither_read_nor_written_through(tmp_path, leads_to):
    """A capture of a stranger may hold a link that leads to any file of the user."""
    (tmp_path / "capture").mkdir()
    save_stripes(tmp_path / "victim", ARRAYS, KEY)
    before, cache = (tmp_path / "victim").read_bytes(), tmp_path / "capture" / "stripes.npz"
    cache.symlink_to(tmp_path / leads_to)
    with pytest.raises(CaptureError, match="found a link, expected the file itself"):
        load_stripes(cache)
    assert cached_stripes(cache, KEY) is None
    save_stripes(cache, {"u": np.zeros(3)}, KEY)
    assert not cache.is_symlink() and cached_stripes(cache, KEY)["u"].shape == (3,)
    assert (tmp_path / "victim").read_bytes() == before and not (tmp_path / "nowhere").exists()


def test_the_key_of_the_frames(folder):
    for k in range(4):
        folder.record(k)
    np.save(folder.path / "off.npy", np.zeros((2, 4, 6), np.uint8))
    folder.record(4, off="off.npy#1")

    def key(every=1):
        return frames_key(open_capture(folder.path).every(every))

    keys = [key()]
    assert keys[0] == key() and keys[0].startswith("sha256:")
    # The cache itself lies beside the frames and is not one of them.
    save_stripes(cache_path(open_capture(folder.path)), ARRAYS, KEY)
    (folder.path / "on/other.png").write_bytes(b"")
    assert key() == keys[0]
    keys.append(key(every=2))
    image = folder.path / "off/000002.png"
    status = os.stat(image)
    os.utime(image, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
    keys.append(key())
    image.write_bytes(image.read_bytes() + b"\0")
    os.utime(image, ns=(status.st_atime_ns, status.st_mtime_ns))
    keys.append(key())
    os.utime(folder.path / "off.npy", ns=(0, 5))
    keys.append(key())
    folder.line('{"event": "resume"}')
    keys.append(key())
    folder.header(rest='[[laser]]\nname = "red"\n[plan]\nsteps = 9\n')
    keys.append(key())
    assert len(set(keys)) == len(keys) == 7
    capture = open_capture(folder.path)
    image.unlink()
    with pytest.raises(CaptureError, match=r"off/000002\.png: cannot be read"):
        frames_key(capture)
