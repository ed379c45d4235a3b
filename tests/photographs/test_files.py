"""What is written: pictures with their metadata, posed photographs as other programs read them; and bad input."""

import dataclasses
import json
import re
import struct
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan import api
from jaxscan.cli.main import main
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.files import CaptureHeader, create_capture
from jaxscan.geometry import Fisheye, Pinhole
from jaxscan.photographs import Panorama, PanoramaFrame, as_rgb, describe_cameras, ideal_camera, undistort
from jaxscan.simulation import make_rig
from jaxscan.vision import decode_image


GUIDE = Path(__file__).resolve().parents[2] / "docs" / "captures.md"


def write_capture(folder, world, *, off=True, size=(320, 240), count=6):
    header = {
        "kind": "sweep",
        "camera": {"width": size[0], "height": size[1], "pixel_format": "rgb8"},
        "turntable": {"carries": "scanner"},
        "laser": [{"name": "red", "colour": "red"}],
    }
    with create_capture(folder, CaptureHeader.model_validate(header), durable=False) as writer:
        for angle, image in list(zip(world.angles, world.images, strict=True))[:count]:
            frame = np.ascontiguousarray(image[: size[1], : size[0]])
            writer.append(angle_deg=float(np.degrees(angle)), on=frame, off=frame if off else None)
    return api.open_capture(folder)


def jpeg_segments(data):
    """Marker and content of every segment before the picture itself."""
    at = 2
    while data[at + 1] != 0xDA:
        (length,) = struct.unpack(">H", data[at + 2 : at + 4])
        yield data[at + 1], data[at + 4 : at + 2 + length]
        at += 2 + length


def small_panorama(distances):
    frame = PanoramaFrame("equirectangular", 40, 12, np.pi / 2 - 4 * 2 * np.pi / 40)
    rgb = np.full((12, 40, 3), (200, 100, 50), np.uint8)
    if not distances:
        return Panorama(frame, rgb)
    metres = np.linspace(0, 70, 480, dtype=np.float32).reshape(12, 40)
    return Panorama(frame, rgb, metres, np.broadcast_to(np.array([1.0, 0.0, -1.0]), rgb.shape))


def test_a_jpeg_says_where_on_the_sphere_it_lies(tmp_path):
    (path,) = api.save_panorama(small_panorama(False), tmp_path / "room.jpg")
    data = path.read_bytes()
    found = decode_image(data, name="", rank=3, size=(40, 12))
    np.testing.assert_allclose(found.astype(int), np.broadcast_to([200, 100, 50], found.shape), atol=4)
    segments = list(jpeg_segments(data))
    (xmp,) = (content for marker, content in segments if marker == 0xE1)
    assert xmp.startswith(b"http://ns.adobe.com/xap/1.0/\0")
    fields = dict(re.findall(r'GPano:(\w+)="(\w+)"', xmp.decode()))
    assert fields == {
        "UsePanoramaViewer": "True",
        "ProjectionType": "equirectangular",
        "FullPanoWidthPixels": "40",
        "FullPanoHeightPixels": "20",
        "CroppedAreaImageWidthPixels": "40",
        "CroppedAreaImageHeightPixels": "12",
        "CroppedAreaLeftPixels": "0",
        "CroppedAreaTopPixels": "4",
    }


def test_distances_are_in_millimetres_and_say_so(tmp_path):
    cv2 = pytest.importorskip("cv2")
    paths = api.save_panorama(small_panorama(True), tmp_path / "room.png")
    assert [path.name for path in paths] == ["room.png", "room.depth.png", "room.normals.png"]
    assert b"XML:com.adobe.xmp" in paths[0].read_bytes()
    depth = cv2.imread(str(paths[1]), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    expected = np.minimum(np.rint(1000 * small_panorama(True).distance_m), 65535)
    np.testing.assert_array_equal(depth, expected)
    assert b"millimetres" in paths[1].read_bytes()
    np.testing.assert_array_equal(decode_image(paths[2].read_bytes(), name="", rank=3, size=None)[3, 3], [255, 128, 0])


def reads(content, index, points):
    """Pixels of points as a reader of transforms.json computes them: OpenGL's camera, OpenCV's lens."""
    world_from_camera = np.array(content["frames"][index]["transform_matrix"])
    x, y, z = (np.linalg.inv(world_from_camera) @ np.c_[points, np.ones(len(points))].T)[:3]
    x, y = x / -z, -y / -z
    if content["camera_model"] == "OPENCV_FISHEYE":
        r = np.hypot(x, y)
        theta = np.arctan(r)
        scale = theta * (1 + sum(content[f"k{k}"] * theta ** (2 * k) for k in (1, 2, 3, 4))) / r
        x, y = x * scale, y * scale
    else:
        r2, (p1, p2) = x * x + y * y, (content["p1"], content["p2"])
        radial = 1 + r2 * (content["k1"] + r2 * (content["k2"] + r2 * content["k3"]))
        x, y = (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
    return np.stack([content["fl_x"] * x + content["cx"], content["fl_y"] * y + content["cy"]], -1)


CAMERAS = {
    "pinhole": lambda given: dataclasses.replace(given, distortion=np.array([-0.05, 0.01, 1e-3, -2e-3, 0.003])),
    "fisheye": lambda given: Fisheye(
        given.fx, given.fy, given.cx, given.cy, np.array([0.02, -0.01, 3e-3, -1e-3]), 320, 240
    ),
}


@pytest.mark.parametrize("model", CAMERAS)
def test_known_points_are_where_the_poses_say(world, model):
    scanner = dataclasses.replace(world.scanner, camera=CAMERAS[model](world.scanner.camera))
    content = json.loads(
        json.dumps(describe_cameras(scanner, world.angles[:12].tolist(), [f"{k}.png" for k in range(12)]))
    )
    points = np.array([[1.9, 0.1, 0.2], [1.5, -0.3, -0.4], [2.5, 0.3, 0.5]])
    for index in (0, 5, 11):
        camera = make_rig(world.config).pose(float(world.angles[index]))
        turned = [camera.inverse().apply(point) for point in points]
        expected = np.array([scanner.camera.project(jnp.asarray(point)) for point in turned])
        # In files the first pixel's centre is (0.5, 0.5).
        np.testing.assert_allclose(reads(content, index, points) - 0.5, expected, atol=2e-3)


def test_what_the_file_cannot_describe_is_written_undistorted(tmp_path, world):
    camera = dataclasses.replace(world.scanner.camera, distortion=np.array([-0.05, 0, 0, 0, 0, 0.01, 0, 0]))
    rational = dataclasses.replace(world.scanner, camera=camera)
    with pytest.raises(CalibrationError, match="write undistorted images"):
        describe_cameras(rational, [0.0], ["a.png"])
    capture = write_capture(tmp_path / "capture", world, count=4)
    assert api.export_photographs(capture, rational, tmp_path / "out") == 4
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert {content[name] for name in ("k1", "k2", "k3", "p1", "p2")} == {0}
    assert content["camera_model"] == "OPENCV"
    first = (tmp_path / "out" / content["frames"][0]["file_path"]).read_bytes()
    assert decode_image(first, name="", rank=3, size=(content["w"], content["h"])).shape == (240, 320, 3)


def test_undistorted_images_show_the_same_ray_at_its_new_place():
    camera = Pinhole(
        *(np.array(value) for value in (200.0, 201.0, 80.5, 61.0)), np.array([-0.2, 0.05, 0, 0, 0]), 160, 120
    )
    ideal = ideal_camera(camera)
    v, u = np.mgrid[:120, :160]
    image = np.stack([u, v, np.zeros_like(u)], -1).astype(np.uint8)
    found = np.asarray(undistort(image, camera, ideal))
    for q in ((20.0, 30.0), (80.0, 60.0), (140.0, 100.0)):
        seen = np.asarray(camera.project(ideal.unproject(np.array(q))))
        np.testing.assert_allclose(found[int(q[1]), int(q[0]), :2], seen, atol=0.6)


@pytest.mark.parametrize("tile", ["rggb", "bggr", "grbg", "gbrg"])
def test_colours_of_a_bayer_frame(tile):
    colour = {"r": 200, "g": 120, "b": 40}
    frame = np.tile(np.array([[colour[k] for k in tile[:2]], [colour[k] for k in tile[2:]]], np.uint8), (6, 8))
    found = as_rgb(frame, f"bayer_{tile}8")
    np.testing.assert_array_equal(found, np.broadcast_to([200, 120, 40], (12, 16, 3)).astype(np.uint8))


def by_hand(folder, width, height):
    (text,) = re.findall(r"```json\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    data = json.loads(text)
    data["camera"] |= {"width": width, "height": height}
    (folder / "hand.json").write_text(json.dumps(data))
    return folder / "hand.json"


def refused(words, capsys):
    assert main([str(word) for word in words]) == 1
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1, said
    return said


def test_bad_input_is_one_line(tmp_path, world, capsys):
    calibration = by_hand(tmp_path, 320, 240)
    write_capture(tmp_path / "without", world, off=False)
    write_capture(tmp_path / "small", world, size=(300, 200))
    write_capture(tmp_path / "good", world)
    (tmp_path / "flat.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        "1 2 3\n2 2 3\n"
    )
    to = ["-c", calibration, "-o", tmp_path / "room.jpg"]
    assert "has no laser-off images" in refused(["panorama", tmp_path / "without", *to], capsys)
    assert "300 x 200 px, but the calibration is for 320 x 240 px" in refused(
        ["panorama", tmp_path / "small", *to], capsys
    )
    assert "has no grid" in refused(["panorama", tmp_path / "good", *to, "--cloud", tmp_path / "flat.ply"], capsys)
    assert '".gif"' in refused(["panorama", tmp_path / "good", "-c", calibration, "-o", tmp_path / "a.gif"], capsys)
    assert "at least one" in refused(["panorama", tmp_path / "good", "-c", calibration], capsys)
    assert "go into an .e57 only" in refused(["panorama", tmp_path / "good", *to, "--photographs"], capsys)
    assert not (tmp_path / "room.jpg").exists()


def test_the_command_writes_all(tmp_path, world, capsys):
    calibration = by_hand(tmp_path, 320, 240)
    write_capture(tmp_path / "good", world)
    words = ["panorama", tmp_path / "good", "-c", calibration, "-o", tmp_path / "room.png", "--width", "300"]
    words += ["--projection", "cylinder", "--transforms", tmp_path / "posed", "--json", tmp_path / "out.json"]
    assert main([str(word) for word in words]) == 0, capsys.readouterr()
    result = json.loads((tmp_path / "out.json").read_text())
    assert result["format"] == "jaxscan-panorama/1" and result["photographs"] == 6 and result["width_px"] == 300
    assert len(list((tmp_path / "posed" / "images").iterdir())) == 6


@pytest.mark.more
def test_fewer_faces_have_a_texture_too(tmp_path, world, capsys):
    write_capture(tmp_path / "good", world)
    api.save_cloud(world.cloud, tmp_path / "room.ply")
    words = ["mesh", tmp_path / "room.ply", "-c", by_hand(tmp_path, 320, 240), "--texture", tmp_path / "good"]
    words += ["--faces", "500", "-o", tmp_path / "room.glb", "--json", tmp_path / "out.json"]
    assert main([str(word) for word in words]) == 0, capsys.readouterr()
    result = json.loads((tmp_path / "out.json").read_text())
    assert 4 < result["faces"] <= 500 and min(result["texture_px"]) > 100


def test_a_capture_without_laser_off_images_keeps_the_colours_of_stripes(tmp_path, world):
    assert not api.has_photographs(write_capture(tmp_path / "without", world, off=False))
    capture = write_capture(tmp_path / "good", world)
    assert api.has_photographs(capture)
    # A scanner that stands still sees one profile, whose points have no neighbours on a surface.
    assert not api.has_photographs(
        dataclasses.replace(capture, records=tuple(dataclasses.replace(one, angle=0.0) for one in capture.records))
    )
    with pytest.raises(CaptureError, match="no laser-off images"):
        api.colour_cloud(world.cloud, api.open_capture(tmp_path / "without"), world.scanner)
    coloured = api.colour_cloud(world.cloud, capture, world.scanner)
    assert coloured.rgb.shape == world.cloud.rgb.shape
    assert not np.any(coloured.rgb[~world.cloud.valid])
