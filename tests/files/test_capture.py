"""Reading captures: correct captures are read, and errors are named."""

import os

import numpy as np
import pytest

from jaxscan.api import observe_boards
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files.capture import open_capture
from jaxscan.geometry import Chessboard
from jaxscan.reconstruction import SweepSource

from .conftest import BOARD, LASER, refused


def test_a_sweep(folder):
    frames = [folder.record(i) for i in range(5)]
    capture = open_capture(folder.path)
    assert isinstance(capture, SweepSource)
    assert len(capture) == 5 and capture.notes == ()
    assert capture.image_size == (6, 4) and capture.pixel_format == "mono8" and capture.carries == "scanner"
    assert capture.lasers[0].name == "red" and capture.board is None
    assert np.array_equal(capture.angles, np.radians([0.1 * i for i in range(5)]))
    assert capture.laser.dtype == np.int32 and not capture.laser.any()
    for index, (on, off) in enumerate(frames):
        found_on, found_off = capture.frames(index)
        assert np.array_equal(found_on, on) and np.array_equal(found_off, off)


def test_a_single_laser_table_and_two_lasers(folder):
    folder.record(0)
    folder.header(rest='[laser]\nname = "only"\nstripe_axis = "columns"\n')
    capture = open_capture(folder.path)
    assert [(line.name, line.stripe_axis) for line in capture.lasers] == [("only", "columns")]
    folder.header(rest=LASER + '[[laser]]\nname = "green"\ncolour = "green"\n')
    # A record that does not say shows all of them.
    assert open_capture(folder.path).laser.tolist() == [0, 1]
    folder.record(1, lasers=["green"])
    folder.record(2, lasers=[0])
    folder.record(3, lasers=["green", "red"])
    capture = open_capture(folder.path)
    assert [record.lasers for record in capture.records] == [(0, 1), (1,), (0,), (0, 1)]
    assert capture.record.tolist() == [0, 0, 1, 2, 3, 3] and capture.record.dtype == np.int32
    assert capture.laser.tolist() == [0, 1, 1, 0, 0, 1] and capture.laser.dtype == np.int32
    # Positions among the records that are left, not their numbers.
    thinned = capture.every(3)
    assert thinned.record.tolist() == [0, 0, 1, 1] and thinned.laser.tolist() == [0, 1, 0, 1]
    folder.record(4, lasers=["blue"])
    folder.refused("line 5", "lasers: found 'blue'", "red, green")
    folder.lines.pop()
    folder.record(4, lasers=[])
    folder.refused("line 5", "lasers: none is lit", "red, green")


def test_without_laser_off_images(folder):
    folder.record(0, off=None)
    folder.record(1, off=None)
    capture = open_capture(folder.path)
    assert capture.frames(0)[1] is None
    assert next(capture.chunks(2)).off is None
    folder.record(2)
    folder.refused("record 0 has no laser-off image", "all, or none")


def test_a_calibration_capture(folder):
    folder.header(kind="calibration", rest=LASER + BOARD)
    folder.record(0, placement=3)
    folder.record(1, on=None, placement=3)
    folder.record(2, off=None)
    folder.line('{"i": 3, "angle_deg": null, "off": "off/000000.png"}')
    capture = open_capture(folder.path)
    assert capture.board == Chessboard(columns=5, rows=4, square=0.03)
    assert [(r.placement, r.lasers, r.angle is None) for r in capture.records] == [
        (3, (0,), False),
        (3, (), False),
        (None, (0,), False),
        (None, (), True),
    ]
    assert capture.frames(1)[0] is None and capture.frames(1)[1] is not None
    with pytest.raises(CaptureError, match="record 3: angle_deg is null"):
        _ = capture.angles
    with pytest.raises(CaptureError, match="record 1: on is null"):
        _ = capture.laser
    with pytest.raises(CaptureError, match="is a calibration capture; only a sweep can be reconstructed"):
        capture.chunks(2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("width = 6", "widht = 6", 'camera.widht: unknown key; the closest known one is "width"'),
        ("width = 6", 'width = "6"', 'camera.width: found "6", expected a valid integer'),
        ('"mono8"', '"bayer_rggb16"', 'pixel_format = "bayer_rggb8" and bits = 16: import them by `jaxscan import`'),
        ("capture/1", "capture/2", 'format: found "jaxscan-capture/2", expected "jaxscan-capture/1"'),
        ('format = "jaxscan-capture/1"', "", "format: missing, so this is no capture"),
        ('kind = "sweep"', 'kind = "calibration"', "board: missing, a calibration capture needs a [board] table"),
        (
            '"scanner"',
            '"camera"',
            'turntable.carries: found "camera", expected "scanner", "object", "linear", "poses" or "nothing"',
        ),
        (LASER, "", "laser: missing, a sweep needs a [[laser]] table"),
        (LASER, LASER + BOARD, "board: found in a sweep"),
    ],
)
def test_wrong_headers(folder, old, new, message):
    folder.record(0)
    text = (folder.path / "capture.toml").read_text()
    assert old in text
    (folder.path / "capture.toml").write_text(text.replace(old, new))
    folder.refused("capture.toml", message)


def test_missing_parts(folder, tmp_path):
    with pytest.raises(CaptureError, match=r"s3:/rooms/hall: no such folder, .*; copy it to a disk first"):
        open_capture("s3://rooms/hall")
    with pytest.raises(CaptureError, match="nowhere: no such folder"):
        open_capture(tmp_path / "nowhere")
    folder.refused("frames.jsonl: no such file")
    folder.line('{"event": "resume"}')
    folder.refused("holds no complete record")
    with pytest.raises(CaptureError, match="found a file, expected a capture's folder"):
        open_capture(folder.path / "capture.toml")
    (folder.path / "capture.toml").unlink()
    folder.refused("capture.toml: no such file")


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("on/000000.png#0", "no such file"),
        ("on/missing.png", "on/missing.png: no such file"),
        ("outside.png", "leads out of the capture's folder"),
        ("outside/secret.png", "leads out of the capture's folder"),
        ("pipe.png", "expected an image file"),
        ("on/" + "a" * 300 + ".png", "File name too long"),
    ],
)
def test_references_that_are_refused(folder, tmp_path, reference, message):
    folder.record(0)
    folder.image("../secret.png", np.zeros((4, 6), np.uint8))
    (folder.path / "outside.png").symlink_to("../secret.png")
    (folder.path / "outside").symlink_to(tmp_path, target_is_directory=True)
    os.mkfifo(folder.path / "pipe.png")
    assert (folder.path / "outside/secret.png").is_file()
    folder.record(1, on=reference)
    folder.refused(message)


@pytest.mark.parametrize("name", ["on/000000.png", "on.npy"])
def test_a_link_out_that_appears_after_opening_is_not_followed(folder, tmp_path, name):
    np.save(folder.path / "on.npy", np.zeros((1, 4, 6), np.uint8))
    folder.record(0)
    folder.record(1, on="on.npy#0")
    capture = open_capture(folder.path)
    (folder.path / name).rename(tmp_path / "outside")
    (folder.path / name).symlink_to(tmp_path / "outside")
    with pytest.raises(CaptureError, match=f"{name}: a link that leads out of the capture's folder"):
        for k in range(2):
            capture.frames(k)


@pytest.mark.parametrize("name", ["capture.toml", "frames.jsonl"])
def test_header_and_journal_are_no_links(folder, tmp_path, name):
    folder.record(0)
    (folder.path / name).rename(tmp_path / "outside")
    (folder.path / name).symlink_to(tmp_path / "outside")
    folder.refused(f"{name}: found a link, expected the file itself")


def test_room_for_frames_is_no_surplus(folder):
    """A writer that is stopped while it shortens a shard leaves whole empty frames behind those of the header."""
    np.save(folder.path / "on.npy", np.ones((2, 4, 6), np.uint8))
    folder.record(0, on="on.npy#1")
    with open(folder.path / "on.npy", "ab") as file:
        file.truncate(128 + 5 * 24)
    assert open_capture(folder.path).frames(0)[0].all()
    with open(folder.path / "on.npy", "ab") as file:
        file.truncate(128 + 5 * 24 + 1)
    folder.refused("found 249 bytes, its header announces 176")


def test_shards(folder):
    stack = np.random.default_rng(4).integers(0, 256, (5, 4, 6), np.uint8)
    np.save(folder.path / "on.npy", stack)
    for i in range(4):
        folder.record(i, on=f"on.npy#{4 - i}")
    capture = open_capture(folder.path)
    assert np.array_equal(np.concatenate([chunk.on for chunk in capture.chunks(3)]), stack[4:0:-1])
    frame = capture.frames(0)[0]
    assert type(frame) is np.ndarray and frame.flags.writeable
    folder.record(4, on="on.npy#5")
    folder.refused("record 4: on.npy#5: the shard has only 5 images")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((3, 4, 6), np.uint16), "found uint16"),
        (np.zeros((3, 6, 4), np.uint8), "found uint8 with shape (3, 6, 4), expected uint8 with shape (n, 4 x 6)"),
        (np.array([{"a": 1}] * 3, object), "not a readable .npy file"),
    ],
)
def test_wrong_shards(folder, array, message):
    np.save(folder.path / "on.npy", array)
    folder.record(0, on="on.npy#0")
    folder.refused("on.npy", message)


@pytest.mark.parametrize("kind", ["truncated", "longer", "archive", "huge", "broken header"])
def test_hostile_shards(folder, kind):
    path = folder.path / "on.npy"
    np.save(path, np.zeros((3, 4, 6), np.uint8))
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[:-1])
    elif kind == "longer":
        path.write_bytes(path.read_bytes() + b"x" * 24)
    elif kind == "archive":
        np.savez(path.with_suffix(".npz"), a=np.zeros(3))
        path.with_suffix(".npz").rename(path)
    elif kind == "huge":
        with open(path, "wb") as file:
            shape = (3_000_000_000, 4, 6)
            np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": shape})
    else:
        path.write_bytes(path.read_bytes().replace(b"(3, 4, 6)", b"((3, 4, 6"))
    folder.record(0, on="on.npy#0")
    folder.refused("on.npy: not a readable .npy file")


def test_damaged_images_are_named_when_they_are_read(folder):
    for i in range(3):
        folder.record(i)
    good = (folder.path / "on/000001.png").read_bytes()
    capture = open_capture(folder.path)

    def read():
        with pytest.raises(CaptureError, match="on/000001") as single:
            capture.frames(1)
        with pytest.raises(CaptureError, match="on/000001") as streamed:
            list(capture.chunks(1))
        assert str(single.value) == str(streamed.value)
        return str(single.value)

    (folder.path / "on/000001.png").write_bytes(good[:-20])
    assert "damaged: it is cut short" in read()
    folder.image("on/000001.png", np.zeros((6, 4), np.uint8))
    assert "found 4 x 6 px, expected 6 x 4 px" in read()
    folder.image("on/000001.png", np.zeros((4, 6, 3), np.uint8))
    assert "found a colour image" in read()
    (folder.path / "on/000001.png").write_bytes(bytes(3 << 20))
    assert "larger than" in read()
    (folder.path / "on/000001.png").write_bytes(b"")
    assert "found an empty file" in read()
    (folder.path / "on/000001.png").unlink()
    assert "no such file" in read()


def test_a_calibration_needs_one_laser_per_record(folder, monkeypatch):
    """Several that are lit at once are fine in a sweep alone."""
    folder.header(kind="calibration", rest=LASER + '[[laser]]\nname = "green"\n' + BOARD)
    folder.record(0, lasers=["green"])
    folder.record(1, on=None)
    folder.record(2)
    capture = open_capture(folder.path)
    refused(CaptureError, lambda: observe_boards([capture]), "record 2: several lasers are lit at once (red, green)")
    # Corners alone do not ask for lasers.
    monkeypatch.setattr("jaxscan.vision.find_corners", lambda image, board: None)
    with pytest.raises(CalibrationError, match="found in none of 3 records"):
        observe_boards([capture], with_stripes=False)
