"""Stripes that are kept beside a capture: when they serve again, and when they must not."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from jaxscan.api import reconstruct_capture
from jaxscan.files.capture import Capture, CaptureHeader, cache_path, load_stripes, open_capture, save_stripes
from jaxscan.files.recording import create_capture
from jaxscan.geometry import LaserSheet, Scanner, stack_lasers
from jaxscan.reconstruction import (
    Extraction,
    ReconstructSettings,
    Seen,
    Sweep,
    extract,
    plan_sweep,
    reconstruct,
    usable_stripes,
)
from jaxscan.stripes import KEPT_FIELDS as KEPT
from jaxscan.stripes import NoiseModel, StripeSettings
from jaxscan.vision import encode_png

from .conftest import small_scanner, stripes_on_plane
from .rendered import pairs, stripe


WIDTH, HEIGHT, RECORDS = 192, 96, 6
NORMAL = np.array([0.9, 0.4, 0.17]) / np.linalg.norm([0.9, 0.4, 0.17])
SETTINGS = ReconstructSettings(min_range_m=1.0, max_range_m=4.0, chunk_records=3)
"""With one size of chunk for the whole capture and half of it: few compilations."""
FIELDS = ("xyz", "rgb", "normals", "sigma_random", "sigma_systematic", "intensity", "valid", "record", "laser", "angle")


@pytest.fixture(scope="module")
def scanner():
    return small_scanner(width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def frames(scanner):
    u, seen = stripes_on_plane(scanner, np.radians(np.arange(RECORDS)), NORMAL, 1.5)
    return pairs(stripe(u, seen, 60.0, WIDTH))


@pytest.fixture
def capture(frames, tmp_path):
    camera = {"width": WIDTH, "height": HEIGHT, "pixel_format": "mono8"}
    header = CaptureHeader(kind="sweep", camera=camera, laser=[{"name": "left"}])
    with create_capture(tmp_path / "room", header) as writer:
        for i, (on, off) in enumerate(zip(*frames, strict=True)):
            writer.append(angle_deg=float(i), on=on, off=off)
    return open_capture(tmp_path / "room")


@pytest.fixture(scope="module")
def stripes(frames, scanner):
    sweep = Sweep(*frames, np.radians(np.arange(RECORDS, dtype=float)))
    return extract(sweep, scanner, settings=SETTINGS).stripes


def moved(scanner, distance):
    """The same rig but for its sheet, which stands elsewhere [m]."""
    sheet = LaserSheet.from_plane(np.array([-1.0, -0.03, 0.30]), distance)
    return Scanner(scanner.camera, stack_lasers([sheet]), scanner.turntable, laser_names=scanner.laser_names)


def assert_same(one, other):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def assert_close(one, other):
    np.testing.assert_array_equal(one.valid, other.valid)
    np.testing.assert_array_equal(one.rgb, other.rgb)
    # One compiled function and two: the last places of float32.
    np.testing.assert_allclose(one.xyz, other.xyz, rtol=1e-5, atol=1e-6)


def test_the_second_time_no_frame_is_read(capture, scanner, monkeypatch):
    first = reconstruct_capture(capture, scanner, settings=SETTINGS)
    assert (first.from_cache, first.kept, first.notes) == (False, True, ())
    assert first.cloud.valid.mean() > 0.99

    def read(self, size):
        raise AssertionError("a frame is read")

    with monkeypatch.context() as patch:
        patch.setattr(Capture, "chunks", read)
        seen = []
        second = reconstruct_capture(
            capture, scanner, settings=SETTINGS, progress=lambda done, total: seen.append((done, total))
        )
        again = reconstruct_capture(open_capture(capture.path), scanner, settings=SETTINGS)
    assert second.from_cache and again.from_cache
    done, total = seen[-1]
    assert done == total > 0
    assert_same(second.cloud, first.cloud)
    assert_same(again.cloud, first.cloud)
    assert_close(first.cloud, reconstruct(capture, scanner, settings=SETTINGS))


@pytest.mark.parametrize(
    "change",
    [
        {"settings": replace(SETTINGS, max_range_m=5.0)},
        {"settings": replace(SETTINGS, stripes=StripeSettings(min_snr=6.0))},
        {"settings": replace(SETTINGS, gate=False)},
        {"settings": replace(SETTINGS, check_steps=True)},
        {"settings": SETTINGS, "noise": NoiseModel(1.5, 30.0)},
    ],
    ids=["range", "stripes", "gate", "steps", "noise"],
)
def test_other_settings_find_other_stripes(capture, scanner, stripes, monkeypatch, change):
    reconstruct_capture(capture, scanner, settings=SETTINGS)
    searched = []

    def search(sweep, scanner, *, settings, noise, progress):
        searched.append((settings, noise))
        return Extraction(stripes)

    # What matters is whether it searches; every search with other settings would be compiled anew.
    monkeypatch.setattr("jaxscan.api.sweeps.extract", search)
    assert not reconstruct_capture(capture, scanner, **change).from_cache
    assert searched == [(change["settings"], change.get("noise"))]
    assert reconstruct_capture(capture, scanner, **change).from_cache
    assert len(searched) == 1


def test_what_does_not_concern_the_stripes_uses_them(capture, scanner):
    reconstruct_capture(capture, scanner, settings=SETTINGS)
    done = reconstruct_capture(capture, scanner, settings=replace(SETTINGS, normals=False))
    assert done.from_cache and not done.cloud.normals.any()


def test_other_frames_are_searched_again(capture, scanner, frames):
    first = reconstruct_capture(capture, scanner, settings=SETTINGS)
    assert not reconstruct_capture(capture.every(2), scanner, settings=SETTINGS).from_cache
    assert not reconstruct_capture(capture, scanner, settings=SETTINGS).from_cache
    (capture.path / "on" / "000003.zst").write_bytes(encode_png(frames[1][3]))
    done = reconstruct_capture(open_capture(capture.path), scanner, settings=SETTINGS)
    assert not done.from_cache
    assert first.cloud.valid[3].mean() > 0.99 and done.cloud.valid[3].mean() < 0.02


def test_another_calibration_uses_what_was_searched_for_this_one(capture, scanner):
    reconstruct_capture(capture, scanner, settings=SETTINGS)
    near = moved(scanner, 0.205)
    done = reconstruct_capture(capture, near, settings=SETTINGS)
    assert done.from_cache
    assert_close(done.cloud, reconstruct(capture, near, settings=SETTINGS))
    assert np.abs(done.cloud.xyz @ NORMAL - 1.5)[done.cloud.valid].min() > 0.005


def test_a_calibration_that_looks_elsewhere_searches_again(capture, scanner, monkeypatch):
    reconstruct_capture(capture, scanner, settings=SETTINGS)

    class Searched(Exception):
        pass

    def search(*args, **kwargs):
        raise Searched

    monkeypatch.setattr("jaxscan.api.sweeps.extract", search)
    assert reconstruct_capture(capture, moved(scanner, 0.205), settings=SETTINGS).from_cache
    # The limits then lie beyond the margin of 40 px.
    with pytest.raises(Searched):
        reconstruct_capture(capture, moved(scanner, 0.75), settings=SETTINGS)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 no archive"])
def test_a_damaged_file_is_replaced(capture, scanner, damage):
    first = reconstruct_capture(capture, scanner, settings=SETTINGS)
    whole = cache_path(capture).read_bytes()
    cache_path(capture).write_bytes(damage or whole[: len(whole) // 2])
    done = reconstruct_capture(capture, scanner, settings=SETTINGS)
    assert (done.from_cache, done.kept) == (False, True)
    assert_same(done.cloud, first.cloud)
    assert reconstruct_capture(capture, scanner, settings=SETTINGS).from_cache


def test_a_place_that_cannot_be_written_is_a_note(capture, scanner):
    cache_path(capture).mkdir()
    done = reconstruct_capture(capture, scanner, settings=SETTINGS)
    assert not done.kept and done.cloud.valid.mean() > 0.99
    (note,) = done.notes
    assert note.startswith("the stripes are not kept for next time: ") and "stripes.npz" in note and "\n" not in note
    assert sorted(path.name for path in capture.path.iterdir()) == [
        *("capture.toml", "frames.jsonl", "off", "on", "stripes.npz")
    ]


def test_better_code_finds_stripes_anew(capture, scanner, monkeypatch):
    reconstruct_capture(capture, scanner, settings=SETTINGS)
    monkeypatch.setattr("jaxscan.api.sweeps.code_digest", lambda: "sha256:another")
    assert not reconstruct_capture(capture, scanner, settings=SETTINGS).from_cache


def test_kept_stripes_of_wrong_shapes_are_searched_anew(capture, scanner):
    """The key is right, and the arrays are not those of the sweep."""
    first = reconstruct_capture(capture, scanner, settings=SETTINGS)
    kept, key = load_stripes(cache_path(capture))
    changes = [
        {name: array[:-1] for name, array in kept.items() if len(np.shape(array)) == 2 and name in KEPT},
        {"u": kept["u"][:, :-1]},
        {"record": kept["record"][:-1], "laser": kept["laser"][:-1]},
        {"record": np.array(3, np.int32)},
        {"rgb": kept["rgb"][:, :, :2]},
        {"u": kept["u"].astype(np.float64)},
        {"valid": kept["valid"].astype(np.uint8)},
        {"more": kept["u"]},
        {"searched_0": kept["searched_0"][:1]},
    ]
    plan = plan_sweep(capture, scanner, SETTINGS)
    whole = {name: array for name, array in kept.items() if name not in Seen.names()}
    assert usable_stripes(whole, plan) is not None
    assert all(usable_stripes(whole | change, plan) is None for change in changes)
    save_stripes(cache_path(capture), kept | changes[0], key)
    done = reconstruct_capture(capture, scanner, settings=SETTINGS)
    assert not done.from_cache
    assert_same(done.cloud, first.cloud)


def test_kept_stripes_do_not_serve_a_copy(capture, scanner, tmp_path):
    first = reconstruct_capture(capture, scanner, settings=SETTINGS)
    shutil.copytree(capture.path, tmp_path / "copy", copy_function=shutil.copy2)
    done = reconstruct_capture(open_capture(tmp_path / "copy"), scanner, settings=SETTINGS)
    assert not done.from_cache
    assert_same(done.cloud, first.cloud)


def test_arrays_that_were_exchanged_are_a_miss(capture, scanner):
    """An archive that is whole in itself, with the right key and the right list of arrays."""
    reconstruct_capture(capture, scanner, settings=SETTINGS)
    with np.load(cache_path(capture)) as opened:
        arrays = dict(opened)
    arrays["u"] = arrays["u"] + np.float32(1)
    np.savez(cache_path(capture), **arrays)
    assert not reconstruct_capture(capture, scanner, settings=SETTINGS).from_cache


@pytest.mark.parametrize("named_once", [True, False])
def test_only_copies_of_a_laser_off_image_are_doubted(frames, scanner, tmp_path, named_once):
    """Records may name the same image; the same frame in several files is somebody's mistake."""
    noise = np.random.default_rng(5).integers(0, 4, frames[0].shape, np.uint8)
    on = np.minimum(frames[0], 250) + noise
    off = np.repeat((np.minimum(frames[1], 250) + noise[::-1])[::2], 2, 0)
    camera = {"width": WIDTH, "height": HEIGHT, "pixel_format": "mono8"}
    header = CaptureHeader(kind="sweep", camera=camera, laser=[{"name": "left"}])
    with create_capture(tmp_path / "room", header, digests=False) as writer:
        for i in range(RECORDS):
            writer.append(angle_deg=float(i), on=on[i], off=off[i])
    journal = tmp_path / "room" / "frames.jsonl"
    if named_once:
        text = journal.read_text()
        for i in range(1, RECORDS, 2):
            text = text.replace(f"off/{i:06}.zst", f"off/{i - 1:06}.zst")
        journal.write_text(text)
    capture = open_capture(tmp_path / "room")
    for from_cache in (False, True):
        found = reconstruct_capture(capture, scanner, settings=SETTINGS)
        assert found.from_cache is from_cache
        assert any("laser-off frames of" in note for note in found.notes) is not named_once
