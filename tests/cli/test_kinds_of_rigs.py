"""Rigs of every kind through capture, calibrate, reconstruct and measure, on pictures of plain NumPy.

Lengths may be 5 of their own sigmas off, and sigmas must be of the size that 0.1 px at 260 px and 0.2 m of baseline
make at 1.2 m: a few millimetres a point, under a millimetre for the mean of hundreds.
"""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxscan
from jaxscan.errors import MeasurementError

from . import plain_rig


TURNS = (-12.0, -5.0, 4.0, 12.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("rigs")


@pytest.fixture
def calibrated(folder, run):
    """A calibration of one of the captures below, with what `calibrate` printed; made once."""

    def make(name, capture, *words):
        path, said = folder / f"{name}.json", folder / f"{name}.txt"
        if not path.exists():
            ran = run("calibrate", capture, "-o", path, "--no-redetect", *words)
            assert ran.code == 0, ran.err
            said.write_text(ran.out)
        return path, said.read_text()

    return make


def boards(folder, name, *arguments, **keys):
    path = folder / name
    return path if path.exists() else plain_rig.board_capture(path, *arguments, **keys)


def reconstructed(run, folder, sweep, calibration, name):
    ran = run("reconstruct", sweep, "-c", calibration, "-o", folder / f"cloud-{name}.npz")
    assert ran.code == 0, ran.err
    return jaxscan.load_cloud(folder / f"cloud-{name}.npz")


def imported(run, capture, lines, *words):
    """The images of a capture, brought in as another program's, with a table of places."""
    path, table = capture.with_name(f"{capture.name}-imported"), capture.with_suffix(".csv")
    table.write_text("\n".join(lines) + "\n")
    patterns = ("--on", "on/*.png", "--off", "off/*.png")
    ran = run("import", capture, "-o", path, *patterns, *(table if word is ... else word for word in words))
    assert ran.code == 0, ran.err
    return path


def journal(capture):
    return [json.loads(line) for line in (capture / "frames.jsonl").read_text().splitlines()]


def assert_camera(path):
    calibration = jaxscan.load_calibration(path)
    sigma = dict(zip(calibration.order, np.sqrt(np.diag(calibration.covariance)), strict=True))
    truth = {"fx": plain_rig.FOCAL, "fy": plain_rig.FOCAL, "cx": plain_rig.CENTRE[0], "cy": plain_rig.CENTRE[1]}
    for name, true in truth.items():
        assert abs(float(getattr(calibration.camera, name)) - true) < 5 * sigma[name] < 5
    return calibration


@pytest.mark.more
def test_a_linear_stage(folder, run, refused, calibrated):
    capture = boards(folder, "linear", "linear", positions=(-0.1, -0.03, 0.04, 0.1))
    # As a spreadsheet writes it in half of Europe.
    lines = [
        f"{one['on']};{1000 * one['position_m']:g};{one['placement']}".replace(".", ",") for one in journal(capture)
    ]
    lines = ["image;mm;placement", *(line.replace(",png", ".png") for line in lines)]
    words = ("--carries", "linear", "--positions", ...)
    capture = imported(run, capture, lines, *words, "--board", "chessboard 7x5 70mm")
    path, said = calibrated("linear", capture)
    assert said.startswith("solving for camera, sheet and direction of travel\n")
    table = json.loads(path.read_text())["turntable"]
    assert table["carries"] == "linear" and "point_m" not in table
    calibration = assert_camera(path)
    sigma = dict(zip(calibration.order, np.sqrt(np.diag(calibration.covariance)), strict=True))
    stage = calibration.scanner.turntable
    # Two components, each of its sigma.
    off = np.linalg.norm(np.cross(stage.direction, plain_rig.TRAVEL))
    assert off < 5 * np.hypot(sigma["travel.t1"], sigma["travel.t2"]) < 0.01
    assert abs(float(stage.gain) - 1.0) < 5 * sigma["gain"] < 0.005
    sweep = plain_rig.sweep_capture(folder / "linear-sweep", "linear", np.linspace(-0.2, 0.2, 17).round(4).tolist())
    sweep = imported(run, sweep, [f"{1000 * one['position_m']:g}" for one in journal(sweep)], *words)
    cloud = reconstructed(run, folder, sweep, path, "linear")
    # The frame is that of the camera at position 0.
    found = jaxscan.measure_distance(
        cloud, np.array([0.0, 0.0, 1.0]), np.array([-0.22, 0.0, 1.2]), radius_m=0.06, scanner=calibration.scanner
    )
    assert abs(found.plane_to_plane_m - 0.2) < 5 * found.plane_to_plane_sigma_m < 0.01
    flat = jaxscan.measure_plane(cloud, np.array([-0.22, 0.0, 1.2]), radius_m=0.1)
    assert flat.rms_m < 0.003 and abs(flat.normal[2]) > 0.999
    normals = np.asarray(cloud.normals)[np.asarray(cloud.valid)]
    assert np.median(normals[:, 2]) < -0.99
    # Points of one stage are not those of a table.
    turning = plain_rig.sweep_capture(folder / "turning-sweep", "scanner", [0.0, 5.0])
    message = refused("reconstruct", turning, "-c", path, "-o", folder / "no.npz")
    assert 'says carries = "scanner", the calibration "linear"' in message


def flat_points(cloud):
    """Errors along the ray [sigma] of points that are 3 px and more from an edge; and [m]."""
    valid = np.asarray(cloud.valid)
    record = np.broadcast_to(np.asarray(cloud.record)[:, None], valid.shape)[valid]
    seen = (np.asarray(cloud.xyz, float)[valid] - plain_rig.BASE[1]) @ plain_rig.BASE[0]
    turn, at = (np.array(part)[record] for part in zip(*map(plain_rig.hand_camera, range(17)), strict=True))
    into = lambda rays: np.einsum("nji,nj->ni", turn, rays)
    pixel = into(seen - at)[:, :2] / into(seen - at)[:, 2:]

    def hit(off):
        ray = np.einsum("nij,nj->ni", turn, np.column_stack([pixel + off / plain_rig.FOCAL, np.ones(len(pixel))]))
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        block = (1.0 - at[:, 2]) / ray[:, 2]
        x, y, _ = (at + block[:, None] * ray).T
        on = (np.abs(x) < 0.12) & (np.abs(y) < 0.15)
        return on, np.where(on, block, (1.2 - at[:, 2]) / ray[:, 2])

    on, depth = hit(np.zeros(2))
    offsets = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), -1).reshape(-1, 2)
    flat = np.all([hit(off)[0] == on for off in offsets], axis=0)
    error = np.linalg.norm(seen - at, axis=1) - depth
    sigma = np.hypot(*(np.asarray(part, float)[valid] for part in (cloud.sigma_random, cloud.sigma_systematic)))
    assert flat.sum() > 0.9 * len(flat)
    return error[flat] / sigma[flat], error[flat]


@pytest.mark.more
def test_a_camera_on_a_hand(folder, run, refused, calibrated):
    path, said = calibrated("hand", plain_rig.hand_boards(folder / "hand"))
    assert said.startswith("solving for camera, sheet and place of the camera on the hand\n")
    first, after = " ".join(said.split()).split(" within one profile, and each pose of the hand adds ")
    assert "Good to " in first and "Each pose of the hand is off by" in after
    assert_camera(path)
    sweep = plain_rig.hand_sweep(folder / "hand-sweep")
    poses = np.reshape([one["pose"] for one in journal(sweep)], (-1, 3, 4))
    numbers = np.hstack([1000 * poses[:, :, 3], Rotation.from_matrix(poses[:, :, :3]).as_rotvec()])
    lines = [f"{one['on']}, " + ", ".join(map(str, row)) for one, row in zip(journal(sweep), numbers, strict=True)]
    words = ("--carries", "poses", "--poses", ..., "--pose-format", "rotvec", "--pose-unit", "mm")
    sweep = imported(run, sweep, lines, *words)
    cloud = reconstructed(run, folder, sweep, path, "hand")
    z, error = flat_points(cloud)
    # Most of the error is shared by all points: one draw, as that of a length.
    assert 1.4826 * np.median(np.abs(z)) < 1.25 and np.mean(np.abs(z) > 5) < 0.001
    assert np.sqrt(np.mean(error**2)) < 1e-3
    base = lambda *point: plain_rig.BASE[0] @ np.array(point) + plain_rig.BASE[1]
    scanner = jaxscan.load_scanner(path)
    places = base(0.0, 0.0, 1.0), base(-0.22, 0.0, 1.2)
    with pytest.raises(MeasurementError, match="a cloud does not hold the hand's poses"):
        jaxscan.measure_distance(cloud, *places, radius_m=0.06, scanner=scanner)
    scanner = scanner.along(jaxscan.open_capture(sweep).poses)
    found = jaxscan.measure_distance(cloud, *places, radius_m=0.06, scanner=scanner)
    assert abs(found.plane_to_plane_m - 0.2) < 5 * found.plane_to_plane_sigma_m < 0.01
    assert "is that of a camera on a hand" in refused("recalibrate", sweep, "-c", path, "-o", folder / "no.json")
    assert "a camera that turns" in refused("panorama", sweep, "-c", path, "-o", folder / "no.jpg")


@pytest.mark.more
def test_a_profile_scanner(folder, run, refused, calibrated):
    capture = boards(folder, "profile", "nothing", placements=0, free=12)
    path, said = calibrated("profile", capture)
    assert said.startswith("solving for camera and sheet\n") and "no axis" not in said
    assert "turntable" not in json.loads(path.read_text())
    calibration = assert_camera(path)
    sweep = plain_rig.sweep_capture(folder / "profile-sweep", "nothing", [0.0, 0.0])
    cloud = reconstructed(run, folder, sweep, path, "profile")
    block, wall = np.array([-0.0412, 0.0, 1.0]), np.array([-0.0907, 0.3, 1.2])
    found = jaxscan.measure_distance(cloud, block, wall, radius_m=0.02, scanner=calibration.scanner)
    assert abs(found.value_m - np.linalg.norm(wall - block)) < 5 * found.sigma_m + 1e-3 < 0.02
    assert np.asarray(cloud.valid).sum(1).min() > 200
    assert not np.asarray(cloud.normals).any()
    moving = plain_rig.sweep_capture(folder / "moving-sweep", "scanner", [0.0, 5.0])
    assert "camera and sheet without a motion" in refused("reconstruct", moving, "-c", path, "-o", folder / "no.npz")


@pytest.mark.more
def test_a_camera_alone(folder, run, refused, calibrated):
    capture = boards(folder, "camera", "", lit=False, placements=0)
    path, said = calibrated("camera", capture)
    first, sheet, axis, *_ = said.splitlines()
    assert first == "solving for camera alone"
    assert sheet.startswith("no sheet: the header lists no [[laser]]")
    said = " ".join(said.split())
    assert axis.startswith("no axis: no board placement was seen from two table angles")
    assert "4 placements at 9 table angles each" in said
    assert_camera(path)
    sweep = plain_rig.sweep_capture(folder / "camera-sweep", "nothing", [0.0])
    message = refused("reconstruct", sweep, "-c", path, "-o", folder / "no.npz")
    assert "holds a camera alone, without a laser sheet" in message


@pytest.mark.more
def test_a_camera_and_an_axis_and_then_a_sheet(folder, run, refused, calibrated):
    capture = boards(folder, "axis", "scanner", lit=False, positions=TURNS)
    path, said = calibrated("axis", capture)
    assert said.startswith("solving for camera and axis\nno sheet: the header lists no [[laser]]")
    calibration = assert_camera(path)
    table = calibration.scanner.turntable
    assert np.linalg.norm(np.cross(table.direction, plain_rig.AXIS)) < 5e-3
    sweep = plain_rig.sweep_capture(folder / "axis-sweep", "scanner", np.linspace(-24, 24, 17).tolist())
    message = refused("reconstruct", sweep, "-c", path, "-o", folder / "no.npz")
    assert "holds camera and axis, without a laser sheet" in message
    # Boards that never stood still, with the axis of before: a whole rig.
    lit = boards(folder, "lit", "scanner", placements=0, free=12)
    whole, said = calibrated("whole", lit, "--axis", path)
    assert said.startswith("solving for camera, sheet and axis; held: axis\n")
    cloud = reconstructed(run, folder, sweep, whole, "whole")
    scanner = jaxscan.load_scanner(whole)
    to_scanner = np.asarray(scanner.scanner_from_camera())
    block, wall = ((to_scanner @ [*point, 1.0])[:3] for point in ([0.0, 0.0, 1.0], [-0.25, 0.0, 1.2]))
    found = jaxscan.measure_distance(cloud, block, wall, radius_m=0.06, scanner=scanner)
    # The axis is held, so its error of before is in no sigma: a milliradian over 0.3 m.
    assert abs(found.plane_to_plane_m - 0.2) < 5 * found.plane_to_plane_sigma_m + 1e-3 < 0.02


def test_known_parts_that_cannot_be_meant(folder, refused):
    capture = boards(folder, "profile", "nothing", placements=0, free=12)
    camera = folder / "small.yaml"
    camera.write_text(
        "image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [500, 0, 320, 0, 500, 240, 0, 0, 1]\nD: []\n"
    )
    for words, message in (
        (["--camera", camera], "known camera has images of 640 x 480 px, the capture of 320 x 256 px"),
        (["--sheet", "1", "0", "0.2"], "--sheet: found 1 0 0.2, expected 4 numbers"),
        (["--sheet", "0", "0", "0", "1"], "--sheet: normal of the plane"),
        (["--axis", "0", "0", "0", "0", "1", "0"], "--axis: the header says that nothing moves"),
        (["--refine", "camera"], "--refine camera: --camera is missing"),
        (["--camera", folder / "none.png"], "none.png"),
    ):
        said = refused("calibrate", capture, "-o", folder / "no.json", *words)
        assert message in said, said


def test_two_records_are_refused_before_any_image_is_read(folder, refused):
    few = folder / "few"
    plain_rig.board_capture(few, "", lit=False, free=2, placements=0)
    for image in (few / "off").iterdir():
        image.write_bytes(image.read_bytes()[:200])
    assert "The captures have 2 view(s) of the board, and a camera needs at least 3" in refused(
        "calibrate", few, "-o", folder / "no.json"
    )


@pytest.mark.more
def test_laser_on_and_off_exchanged(folder, refused):
    capture = folder / "exchanged"
    plain_rig.board_capture(capture, "nothing", free=5, placements=0)
    (capture / "on").rename(capture / "kept")
    (capture / "off").rename(capture / "on")
    (capture / "kept").rename(capture / "off")
    message = refused("calibrate", capture, "-o", folder / "no.json")
    assert "laser on and laser off are exchanged: 5 of 5 boards have the line in the laser-off image" in message


@pytest.mark.parametrize("carries, said", [("", True), ("object", False)])
def test_what_an_axis_is_taken_for_is_said(folder, run, carries, said):
    few = folder / f"few-{carries}"
    plain_rig.board_capture(few, carries, lit=False, free=2, placements=0)
    ran = run("calibrate", few, "-o", folder / "no.json", "--axis", "0", "0", "0.4", "0", "-1", "0")
    assert ran.code == 1 and ("so --axis is that of a table that carries the scanner" in ran.out) == said, ran.out
