"""Panoramas: where rays are, seams, straight lines, distances, and a turn without a cloud."""

import numpy as np
import pytest

import jaxscan
from jaxscan.api import began
from jaxscan.errors import CalibrationError, CloudError
from jaxscan.files import CaptureHeader, create_capture
from jaxscan.files.clouds import About, StoredCloud
from jaxscan.geometry import LaserSheet, LinearStage, Pinhole, Scanner, Turntable
from jaxscan.photographs import Panorama, Photograph, Photographs, make_panorama, panorama_frame
from jaxscan.photographs.colour import fill_holes
from jaxscan.reconstruction import PointCloud
from jaxscan.vision import decode_image
from tests.photographs.rendered import BAR_AT, BAR_HALF, BAR_SLOPE, WALL_X


@pytest.fixture(scope="module")
def panorama(world):
    return make_panorama(world.photographs, panorama_frame(world.scanner, width=1000), world.cloud)


@pytest.mark.parametrize("projection", ["equirectangular", "cylinder"])
def test_rays_and_pixels_are_inverse(world, projection):
    frame = panorama_frame(world.scanner, projection, 200)
    rays = frame.rays()
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)
    v, u = np.mgrid[: frame.height, : frame.width]
    np.testing.assert_allclose(frame.pixels(3 * rays), np.stack([u, v], -1), atol=1e-4)
    # The x axis is in the middle, and what is to the left of it on the left.
    np.testing.assert_allclose(frame.pixels(np.array([1.0, 0.0, 0.0]))[0], 99.5)
    assert frame.pixels(np.array([1.0, 0.5, 0.0]))[0] < 99 and frame.pixels(np.array([1.0, 0.0, 0.2]))[1] < 60


@pytest.mark.more
def test_a_straight_line_is_straight_to_half_a_pixel(world, panorama):
    """The bar on the wall, seen again in every column; its places are carried back to the wall along their rays."""
    frame, rays = panorama.frame, panorama.frame.rays()
    on_wall = rays * (WALL_X / np.maximum(rays[..., :1], 0.05))
    apart = on_wall[..., 2] - BAR_SLOPE * on_wall[..., 1] - BAR_AT
    near = (np.abs(apart) < 3 * BAR_HALF) & (np.abs(on_wall[..., 1]) < 1.2)
    columns = np.flatnonzero(near.sum(0) > 5)
    assert len(columns) > 150
    off = []
    for column in columns:
        rows = np.flatnonzero(near[:, column])
        grey = panorama.rgb[rows, column].astype(float).mean(-1)
        ink = np.clip(grey.max() - grey - 0.15 * np.ptp(grey), 0, None)
        off.append(np.sum(ink * apart[rows, column]) / np.sum(ink))
    pixel_m = frame.per_pixel * WALL_X
    assert np.max(np.abs(off)) < 0.5 * pixel_m


@pytest.mark.more
def test_distances_and_normals_are_those_of_the_wall(world, panorama):
    rays = panorama.frame.rays()
    y, z = np.meshgrid(np.linspace(0.4, 1.0, 12), np.linspace(-0.4, 0.3, 9))
    pixel = np.rint(panorama.frame.pixels(np.stack([np.full_like(y, WALL_X), y, z], -1))).astype(int)
    row, column = pixel[..., 1], pixel[..., 0]
    true = WALL_X / rays[row, column, 0]
    # Half a pixel of panorama and of cloud on a wall that is 30 degrees from head-on.
    np.testing.assert_allclose(panorama.distance_m[row, column], true, atol=0.01)
    np.testing.assert_allclose(panorama.normals[row, column], np.broadcast_to([-1.0, 0, 0], (*y.shape, 3)), atol=0.02)


@pytest.mark.more
def test_without_a_cloud_what_is_as_far_away_as_is_said_is_in_its_place(world):
    frame = panorama_frame(world.scanner, width=600)
    found = make_panorama(world.photographs, frame, distance_m=WALL_X)
    assert found.distance_m is None
    points = np.array([[WALL_X, 0.0, BAR_AT]])
    u, v = frame.pixels(points)[0]
    rows = np.arange(int(v) - 5, int(v) + 7)
    grey = found.rgb[rows, round(u)].astype(float).mean(-1)
    ink = np.clip(grey.max() - grey - 0.15 * np.ptp(grey), 0, None)
    assert abs(np.sum(ink * rows) / np.sum(ink) - v) < 0.7


def round_room(steps=48, lines=40):
    """A turning camera in a round room of even grey, and the room's cloud."""
    camera = Pinhole(*(np.array(value) for value in (90.0, 90.0, 79.5, 59.5)), np.zeros(5), 160, 120)
    table = Turntable.from_axis(np.array([0.0, -1.0, 0.0]), np.array([0.1, 0.0, -0.05]))
    scanner = Scanner.from_parts(camera, _sheet(), table)
    angles = 2 * np.pi * np.arange(steps) / steps
    turn, height = angles[:, None], np.linspace(-1.4, 1.4, lines)[None, :]
    xyz = np.stack(np.broadcast_arrays(2 * np.cos(turn), 2 * np.sin(turn), height), -1).astype(np.float32)
    inward = (xyz * [-0.5, -0.5, 0.0]).astype(np.float32)
    nothing = np.zeros((steps, lines), np.float32)
    cloud = PointCloud(
        xyz=xyz,
        rgb=np.full((steps, lines, 3), 120, np.uint8),
        intensity=nothing,
        normals=inward,
        sigma_random=nothing,
        sigma_systematic=nothing,
        valid=np.ones((steps, lines), bool),
        record=np.arange(steps, dtype=np.int32),
        laser=np.zeros(steps, np.int32),
        angle=angles,
    )
    return scanner, angles, cloud


def _sheet():
    return LaserSheet.from_plane(np.array([1.0, 0.0, 0.1]), 0.3)


@pytest.mark.more
@pytest.mark.parametrize("with_cloud", [True, False])
def test_there_are_no_seams_where_light_is_constant(with_cloud):
    """Also where exposures differ by 20 %: neighbouring pixels differ by 1 grey level at most, all the way round."""
    scanner, angles, cloud = round_room()
    levels = np.rint(120 * (1 + 0.2 * np.random.default_rng(0).uniform(-1, 1, len(angles)))).astype(np.uint8)
    shots = [
        Photograph(float(angle), np.full((120, 160, 3), level, np.uint8))
        for angle, level in zip(angles, levels, strict=True)
    ]
    frame = panorama_frame(scanner, width=360)
    found = make_panorama(Photographs(scanner, shots), frame, cloud if with_cloud else None)
    inner = found.rgb[5:-5].astype(int)
    assert np.max(np.abs(np.diff(inner, axis=1))) <= 1
    assert np.max(np.abs(np.diff(inner, axis=0))) <= 1
    assert np.max(np.abs(inner[:, 0] - inner[:, -1])) <= 1


def test_a_camera_that_does_not_turn_is_refused(world):
    scanner, _, _ = round_room()
    stage = LinearStage.from_direction(np.array([1.0, 0.0, 0.0]))
    with pytest.raises(CalibrationError, match="needs a camera that turns"):
        panorama_frame(Scanner.from_parts(scanner.camera, _sheet(), stage))


def test_holes_are_filled_from_around_them():
    rows, columns = np.mgrid[:37, :50].astype(np.float32)
    picture = np.stack([rows, columns], -1)
    known = np.ones((37, 50), bool)
    known[10:20, 15:30] = False
    found = fill_holes(picture, known)
    np.testing.assert_array_equal(found[known], picture[known])
    # Between the values at its borders, and rising as they do.
    assert np.all(found[~known] > [5, 10]) and np.all(found[~known] < [25, 35])
    assert np.all(np.diff(found[15, 14:31, 1]) > -1e-3)
    np.testing.assert_array_equal(fill_holes(picture, np.zeros_like(known)), 0)


def test_an_e57_has_the_panorama_with_the_pose_of_its_scan(world, tmp_path):
    """By the format's own rule of which pixel a direction is."""
    pye57 = pytest.importorskip("pye57")
    frame = panorama_frame(world.scanner, width=1000)
    rays = frame.rays().astype(np.float64)
    # Colours by which every direction is known.
    drawn = Panorama(frame, np.rint(127 + 120 * rays).astype(np.uint8))
    path = jaxscan.save_scan(StoredCloud(world.cloud, About()), drawn, tmp_path / "scan.e57")
    file = pye57.E57(str(path))
    (node,) = (file.root["images2D"][k] for k in range(file.root["images2D"].childCount()))
    assert node["associatedData3DGuid"].value() == file.root["data3D"][0]["guid"].value()
    assert [node["pose"]["rotation"][axis].value() for axis in "wxyz"] == [1, 0, 0, 0]
    sphere = node["sphericalRepresentation"]
    width, height = sphere["imageWidth"].value(), sphere["imageHeight"].value()
    step = sphere["pixelWidth"].value()
    assert sphere["pixelHeight"].value() == step
    buffer = np.zeros(sphere["jpegImage"].byteCount(), np.uint8)
    sphere["jpegImage"].read(buffer, 0, len(buffer))
    file.close()
    picture = decode_image(buffer.tobytes(), name="jpegImage", rank=3, size=(width, height))
    assert picture.shape == (height, width, 3) and height % 2 == 0
    # JPEG blurs the borders of the picture into the black beyond them.
    rays = rays[16:-16].reshape(-1, 3)
    azimuth, elevation = np.arctan2(rays[:, 1], rays[:, 0]), np.arcsin(rays[:, 2])
    column = np.floor(width / 2 - azimuth / step).astype(int) % width
    row = np.floor(height / 2 - elevation / step).astype(int)
    assert np.abs(picture[row, column] - (127 + 120 * rays)).max() < 6
    # The points are as in a file without a picture.
    np.testing.assert_array_equal(jaxscan.load_cloud(path).xyz, world.cloud.xyz)


def test_an_e57_has_photographs_with_their_poses_and_the_time(world, tmp_path):
    """By the format's own formula of which pixel a point is: the camera looks along its negative z axis."""
    pye57 = pytest.importorskip("pye57")
    frame = panorama_frame(world.scanner, width=200)
    drawn = Panorama(frame, np.zeros((frame.height, 200, 3), np.uint8))
    numbers = [8, 32]
    shots = [Photograph(float(world.angles[k]), world.images[k]) for k in numbers]
    given = Photographs(world.scanner, shots)
    path = tmp_path / "scan.e57"
    jaxscan.save_scan(StoredCloud(world.cloud, About()), drawn, path, photographs=given, started_s=1.7e9)
    file = pye57.E57(str(path))
    scan, pictures = file.root["data3D"][0], file.root["images2D"]
    # 315964800 s from 1970 to the epoch of GPS, and 18 leap seconds since.
    assert scan["acquisitionStart"]["dateTimeValue"].value() == 1.7e9 - 315964800 + 18
    assert pictures.childCount() == 3
    rng = np.random.default_rng(6)
    points = np.stack([np.full(4000, WALL_X), rng.uniform(-1, 1.4, 4000), rng.uniform(-0.6, 0.7, 4000)], -1)
    for number, node in zip(numbers, (pictures[1], pictures[2]), strict=True):
        pinhole, pose = node["pinholeRepresentation"], node["pose"]
        w, x, y, z = (pose["rotation"][axis].value() for axis in "wxyz")
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        eye = np.array([pose["translation"][axis].value() for axis in "xyz"])
        np.testing.assert_allclose(eye, world.eyes()[number], atol=1e-6)
        local = (points - eye) @ rotation
        value = {key: pinhole[key].value() for key in ("focalLength", "pixelWidth", "pixelHeight")}
        middle = [pinhole[f"principalPoint{axis}"].value() for axis in "XY"]
        size = pinhole["imageWidth"].value(), pinhole["imageHeight"].value()
        u = middle[0] - value["focalLength"] / value["pixelWidth"] * local[:, 0] / local[:, 2]
        v = middle[1] + value["focalLength"] / value["pixelHeight"] * local[:, 1] / local[:, 2]
        buffer = np.zeros(pinhole["jpegImage"].byteCount(), np.uint8)
        pinhole["jpegImage"].read(buffer, 0, len(buffer))
        picture = decode_image(buffer.tobytes(), name="jpegImage", rank=3, size=size)
        true, visible = world.truth(points, eye)
        inside = visible & (local[:, 2] < 0) & (u > 4) & (u < size[0] - 5) & (v > 4) & (v < size[1] - 5)
        assert inside.sum() > 500
        found = picture[np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)].astype(float)
        # Wall and print differ by 100 levels; at their edges the lens, the JPEG and half a pixel mix them.
        off = np.abs(found.mean(-1) - true[inside].mean(-1))
        assert np.median(off) < 4 and np.mean(off > 40) < 0.06
    file.close()


@pytest.mark.parametrize("said, expected", [("2026-11-23T10:00:00Z", 1795428000.0), ("today", None), (5, None)])
def test_the_time_is_that_of_the_header(world, tmp_path, said, expected):
    header = {
        "kind": "sweep",
        "camera": {"width": 320, "height": 240, "pixel_format": "rgb8"},
        "turntable": {"carries": "scanner"},
        "laser": [{"name": "red", "colour": "red"}],
        "acquisition": {"started": said},
    }
    with create_capture(tmp_path / "sweep", CaptureHeader.model_validate(header), durable=False) as writer:
        writer.append(angle_deg=0.0, on=world.images[0], off=None)
    assert began(jaxscan.open_capture(tmp_path / "sweep")) == expected


def test_a_cylinder_and_another_format_hold_no_scan(world, tmp_path):
    frame = panorama_frame(world.scanner, "cylinder", 64)
    drawn = Panorama(frame, np.zeros((frame.height, 64, 3), np.uint8))
    stored = StoredCloud(world.cloud, About())
    with pytest.raises(CloudError, match="cylinder"):
        jaxscan.save_scan(stored, drawn, tmp_path / "scan.e57")
    with pytest.raises(CloudError, match=r'"\.ply", expected \.e57'):
        jaxscan.save_scan(stored, drawn, tmp_path / "scan.ply")
    assert not list(tmp_path.iterdir())
