"""`jaxscan convert` of captures: raw shards and back."""

import json

import cv2
import numpy as np
import pytest

from jaxscan.files.capture import CaptureHeader, open_capture
from jaxscan.files.recording import create_capture


FRAMES = np.random.default_rng(8).integers(0, 256, (8, 4, 6), np.uint8)


@pytest.fixture
def room(tmp_path):
    camera = {"width": 6, "height": 4, "pixel_format": "mono8"}
    head = CaptureHeader(kind="sweep", camera=camera, laser=[{"name": "red"}])
    with create_capture(tmp_path / "room", head, durable=False) as capture:
        for k in range(4):
            capture.append(angle_deg=float(k), on=FRAMES[2 * k], off=FRAMES[2 * k + 1], microsteps=k)
    return tmp_path / "room"


def test_there_and_back(room, run, tmp_path):
    ran = run("convert", room, tmp_path / "fast", "--storage", "npy", "--json", "-")
    assert ran.code == 0 and "4 records, npy" in ran.err
    assert json.loads(ran.out) == {
        "format": "jaxscan-convert/1",
        "source": str(room),
        "capture": str(tmp_path / "fast"),
        "storage": "npy",
        "records": 4,
    }
    assert (tmp_path / "fast/on/000000.npy").is_file()
    assert run("convert", tmp_path / "fast", tmp_path / "back", "--storage", "zstd").code == 0
    *lines, seal = (json.loads(line) for line in (tmp_path / "back/frames.jsonl").read_text().splitlines())
    bare = [{key: value for key, value in line.items() if key != "sha256"} for line in lines]
    assert bare == [json.loads(line) for line in (room / "frames.jsonl").read_text().splitlines()]
    assert seal["event"] == "seal" and seal["sealed_records"] == 4
    (chunk,) = open_capture(tmp_path / "back").chunks(4)
    assert np.array_equal(chunk.off, FRAMES[1::2])


def test_every_frame_is_there_as_png_after_one_command(room, run, tmp_path):
    """Read by OpenCV, as any other program would."""
    assert run("convert", room, tmp_path / "pictures", "--storage", "png").code == 0
    for k, side in enumerate(("on", "off") * 4):
        found = cv2.imread(str(tmp_path / f"pictures/{side}/{k // 2:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(found, FRAMES[k])


def test_what_is_refused(room, refused, run, tmp_path):
    assert "is the same file as INPUT" in refused("convert", room, room, "--storage", "npy")
    assert "--storage: is needed" in refused("convert", room, tmp_path / "a")
    assert "--format: is for calibrations" in refused("convert", room, tmp_path / "a", "--format", "ros")
    assert "create it first" in refused("convert", room, tmp_path / "no" / "a", "--storage", "npy")
    (tmp_path / "cloud.ply").write_text("ply")
    cloud = ("convert", tmp_path / "cloud.ply", tmp_path / "a.npz")
    assert "--storage: is for captures" in refused(*cloud, "--storage", "png")
    missing = ("convert", room, tmp_path / "a", "--storage", "npy", "--json", tmp_path / "nowhere" / "a.json")
    assert "create it first" in refused(*missing)
    (tmp_path / "folder").mkdir()
    assert "capture.toml: no such file" in refused("convert", tmp_path / "folder", tmp_path / "a", "--storage", "npy")
    assert run("convert", room, tmp_path / "a", "--storage", "tiff").code == 2
    assert not (tmp_path / "a").exists()


@pytest.mark.more
def test_a_cloud_does_not_depend_on_the_storage(tiny, run, tmp_path):
    assert run("convert", tiny.sweep, tmp_path / "fast", "--storage", "npy").code == 0
    clouds = []
    for name, capture in (("files", tiny.sweep), ("shards", tmp_path / "fast")):
        target = tmp_path / f"{name}.npz"
        assert run("reconstruct", capture, "-c", tiny.calibration, "-o", target).code == 0
        with np.load(target) as arrays:
            clouds.append(dict(arrays))
    assert all(np.array_equal(clouds[0][name], array) for name, array in clouds[1].items())
    assert clouds[1]["valid"].any()
