"""`jaxscan import`: the images of other programs, paired, written and refused."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest

from jaxscan.files.capture import open_capture, verify_capture
from jaxscan.stripes import level_exposures, split_levels


DATA = Path(__file__).resolve().parents[1] / "data"
RNG = np.random.default_rng(11)
FRAMES = RNG.integers(0, 256, (16, 10, 12), np.uint8)


def save(folder, names, frames=FRAMES):
    """Grey images of random pixels, so that each is known by its pixels."""
    for name, frame in zip(names, frames, strict=False):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), frame)
    return folder


@pytest.fixture
def pairs(tmp_path):
    """Laser-on images l_0 ... l_11 and laser-off images b_0 ... b_11, without leading zeros."""
    frames = RNG.integers(0, 256, (24, 10, 12), np.uint8)
    save(tmp_path / "pairs", [f"l_{k}.png" for k in range(12)], frames[:12])
    save(tmp_path / "pairs", [f"b_{k}.png" for k in range(12)], frames[12:])
    return tmp_path / "pairs", frames


PATTERNS = ("--on", "l_*.png", "--off", "b_*.png")


def test_pairs_by_patterns(pairs, run, tmp_path):
    folder, frames = pairs
    ran = run("import", folder, "-o", tmp_path / "room", *PATTERNS, "--step-deg", "0.9", "--json", "-")
    assert ran.code == 0, ran.err
    assert "l_0.png ... l_11.png" in ran.err and "b_0.png ... b_11.png" in ran.err and "12 records" in ran.err
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-import/1" and result["records"] == 12 and result["kind"] == "sweep"
    capture = open_capture(tmp_path / "room")
    assert capture.notes == () and not verify_capture(tmp_path / "room")
    np.testing.assert_allclose(np.degrees(capture.angles), 0.9 * np.arange(12))
    (chunk,) = capture.chunks(12)
    # l_2 comes before l_10.
    assert np.array_equal(chunk.on, frames[:12]) and np.array_equal(chunk.off, frames[12:])
    first = json.loads((tmp_path / "room" / "frames.jsonl").read_text().splitlines()[0])
    assert first["source"] == {"on": ["l_0.png"], "off": ["b_0.png"]}


def test_show_writes_nothing(pairs, run, tmp_path):
    folder, _ = pairs
    ran = run("import", folder, "--show", *PATTERNS, "--step-deg", "0.9", "-o", tmp_path / "room")
    assert ran.code == 0 and "nothing is written" in ran.out and "12  l_0.png ... l_11.png" in ran.out
    assert not (tmp_path / "room").exists()
    assert sorted(os.listdir(tmp_path)) == ["pairs"]


def test_a_missing_image_shifts_no_angle(pairs, run, tmp_path):
    folder, _ = pairs
    for name in ("l_5.png", "b_5.png"):
        (folder / name).unlink()
    ran = run("import", folder, "-o", tmp_path / "room", *PATTERNS, "--step-deg", "2")
    assert ran.code == 0 and "1 of which are missing" in ran.out
    angles = np.degrees(open_capture(tmp_path / "room").angles)
    np.testing.assert_allclose(angles, [0, 2, 4, 6, 8, 12, 14, 16, 18, 20, 22])


def test_counts_that_differ_are_told_by_name(pairs, refused, tmp_path):
    folder, _ = pairs
    (folder / "b_7.png").unlink()
    message = refused("import", folder, "-o", tmp_path / "room", *PATTERNS, "--step-deg", "1")
    assert "found 12 laser on images and 11 laser off images" in message and "without a partner: l_7.png" in message
    assert not (tmp_path / "room").exists()


def test_the_words_of_names_tell_the_roles(run, tmp_path):
    names = [f"scan/{role}_{k:03d}.png" for k in range(4) for role in ("laser", "background", "texture")]
    save(tmp_path / "in", names)
    ran = run("import", tmp_path / "in", "-o", tmp_path / "room", "--step-deg", "90", "--carries", "object")
    assert ran.code == 0 and "read from the words" in ran.out and "texture images (4) are not used" in ran.out
    capture = open_capture(tmp_path / "room")
    assert len(capture) == 4 and capture.carries == "object"
    (chunk,) = capture.chunks(4)
    assert np.array_equal(chunk.on, FRAMES[0:12:3]) and np.array_equal(chunk.off, FRAMES[1:12:3])


def test_two_lasers(run, tmp_path):
    names = [f"laser_{side}_{k}.png" for side in ("L", "R") for k in range(3)] + [
        f"background_{k}.png" for k in range(3)
    ]
    save(tmp_path / "in", names)
    assert run("import", tmp_path / "in", "-o", tmp_path / "room", "--step-deg", "5").code == 0
    capture = open_capture(tmp_path / "room")
    assert [laser.name for laser in capture.lasers] == ["left", "right"]
    assert [record.lasers for record in capture.records] == [(0,), (1,)] * 3
    (chunk,) = capture.chunks(6)
    assert np.array_equal(chunk.on[0::2], FRAMES[:3]) and np.array_equal(chunk.on[1::2], FRAMES[3:6])
    assert np.array_equal(chunk.off, FRAMES[[6, 6, 7, 7, 8, 8]])
    patterns = ("--on", "laser_L_*", "laser_R_*", "--off", "background_*", "--lasers", "a", "b")
    assert run("import", tmp_path / "in", "-o", tmp_path / "two", *patterns, "--step-deg", "5").code == 0
    assert [laser.name for laser in open_capture(tmp_path / "two").lasers] == ["a", "b"]


def test_the_layout_of_fabscan(run, tmp_path):
    """The names that FabScanPi gives, after its source."""
    scan = "20200101-101010"
    names = [f"{scan}/raw_laser_raw/{scan}_{k:03d}.jpg" for k in range(5)]
    save(tmp_path / "fabscan", names + [f"{scan}/color_raw/{scan}_{k:03d}.jpg" for k in range(4)])
    ran = run("import", tmp_path / "fabscan", "-o", tmp_path / "a")
    assert ran.code == 0 and "the layout is that of FabScanPi" in ran.out and "JPEG" in ran.out
    capture = open_capture(tmp_path / "a")
    # One laser picture more than the pictures of a turn.
    np.testing.assert_allclose(np.degrees(capture.angles), [0, 90, 180, 270, 360])
    assert not capture.records[0].off and any("JPEG" in note for note in capture.notes)
    assert capture.lasers[0].colour == "red"


def test_what_is_not_recognised_is_listed_with_a_command(refused, tmp_path):
    save(tmp_path / "in", [f"a{k}.png" for k in range(5)] + [f"b{k}.png" for k in range(3)])
    message = refused("import", tmp_path / "in", "-o", tmp_path / "room")
    assert "'a*.png' (5: a0.png ... a4.png); 'b*.png' (3: b0.png ... b2.png)" in message
    stage = refused("import", tmp_path / "in", "-o", tmp_path / "room", "--carries", "linear", "--step-mm", "2")
    assert "--on 'a*.png' --off 'b*.png' --carries linear --step-mm 1" in stage
    assert f"jaxscan import {tmp_path / 'in'} --on 'a*.png' --off 'b*.png' --step-deg 0.9" in message


def test_angles_from_a_file(pairs, run, refused, tmp_path):
    folder, _ = pairs
    angles = tmp_path / "angles.txt"
    angles.write_text("# degrees\n" + "".join(f"{3.5 * k}\n" for k in range(12)))
    assert run("import", folder, "-o", tmp_path / "a", *PATTERNS, "--angles", angles).code == 0
    np.testing.assert_allclose(np.degrees(open_capture(tmp_path / "a").angles), 3.5 * np.arange(12))
    angles.write_text("".join(f"l_{k}.png; {k * k}\n" for k in reversed(range(12))))
    assert run("import", folder, "-o", tmp_path / "b", *PATTERNS, "--angles", angles).code == 0
    np.testing.assert_allclose(np.degrees(open_capture(tmp_path / "b").angles), np.arange(12.0) ** 2)
    wrong = ("import", folder, "-o", tmp_path / "c", *PATTERNS, "--angles", angles)
    for text, said in (
        ("1\n2\n", "found 2 lines, expected one for each of 12 images"),
        ("1\nnan\n", "line 2: found 'nan'"),
        ("l_0.png 1\n2\n", "some lines have a name"),
        ("l_0.png 1\n", "no line for l_1.png"),
        ("1 2 3 4\n", "line 1"),
        ("-\n" * 12, "a place is unknown"),
    ):
        angles.write_text(text)
        assert said in refused(*wrong)


def test_a_linear_stage_and_a_scanner_that_stands_still(pairs, run, refused, tmp_path):
    folder, _ = pairs
    stage = ("--carries", "linear")
    assert run("import", folder, "-o", tmp_path / "a", *PATTERNS, *stage, "--step-mm", "2.5").code == 0
    np.testing.assert_allclose(open_capture(tmp_path / "a").angles, 0.0025 * np.arange(12))
    (tmp_path / "mm.txt").write_text("".join(f"{k * k}\n" for k in range(12)))
    assert run("import", folder, "-o", tmp_path / "b", *PATTERNS, *stage, "--positions", tmp_path / "mm.txt").code == 0
    np.testing.assert_allclose(open_capture(tmp_path / "b").angles, 0.001 * np.arange(12) ** 2)
    assert run("import", folder, "-o", tmp_path / "c", *PATTERNS, "--carries", "nothing").code == 0
    assert open_capture(tmp_path / "c").carries == "nothing"
    words = ("import", folder, "-o", tmp_path / "d", *PATTERNS)
    assert "--step-mm: is needed" in refused(*words, *stage)
    assert "--step-deg: is for --carries scanner or object" in refused(*words, *stage, "--step-deg", "1")
    assert "--step-mm: is for --carries linear" in refused(*words, "--step-mm", "1")


def test_positions_of_a_spreadsheet(pairs, run, refused, tmp_path):
    folder, _ = pairs
    for name, lines in (
        ("comma", ['"image","position_mm"', *(f'"l_{k}.png",{k}.25' for k in range(12))]),
        ("semicolon", ["\ufeffBild;Position (mm)", *(f"l_{k}.png;{k},25" for k in range(12))]),
    ):
        (tmp_path / f"{name}.csv").write_text("\r\n".join(lines), encoding="utf-8")
        words = ("--carries", "linear", "--positions", tmp_path / f"{name}.csv")
        assert run("import", folder, "-o", tmp_path / name, *PATTERNS, *words).code == 0
        np.testing.assert_allclose(open_capture(tmp_path / name).angles, 0.001 * (np.arange(12) + 0.25))
    (tmp_path / "plain.csv").write_text("".join(f"{k},25\n" for k in range(12)))
    words = ("--carries", "linear", "--positions", tmp_path / "plain.csv")
    assert "found two numbers in a line" in refused("import", folder, "-o", tmp_path / "no", *PATTERNS, *words)


def test_poses_of_a_hand(pairs, run, refused, tmp_path):
    folder, _ = pairs
    poses, hand = tmp_path / "poses.txt", ("--carries", "poses")
    words = ("import", folder, "-o", tmp_path / "a", *PATTERNS, *hand)
    assert "--poses: is needed" in refused(*words)
    assert "--poses: is for --carries poses" in refused(*words[:-2], "--poses", poses)
    assert "--pose-unit: is for --carries poses" in refused(*words[:-2], "--step-deg", "1", "--pose-unit", "mm")
    assert "--step-deg: is for --carries scanner or object" in refused(*words, "--step-deg", "1")
    poses.write_text("".join(f"{10 * k} 0 5 0 0 {k}\n" for k in range(12)))
    assert "line 1: found '0 0 5 0 0 0', expected one of --pose-format rotvec" in refused(*words, "--poses", poses)
    millimetres = ("--poses", poses, "--pose-format", "rpy", "--pose-unit", "mm")
    ran = run(*words, *millimetres)
    assert ran.code == 0, ran.err
    assert "poses: from poses.txt, within a box of 0.11 m, turned by up to 11 degrees" in " ".join(ran.out.split())
    capture = open_capture(tmp_path / "a")
    assert capture.carries == "poses" and "turned" not in run("info", tmp_path / "a").out
    np.testing.assert_allclose(capture.poses[:, :3, 3], [[0.01 * k, 0, 0.005] for k in range(12)], atol=1e-12)
    angle = np.radians(np.arange(12))
    np.testing.assert_allclose(capture.poses[:, 1, 0], np.sin(angle), atol=1e-12)
    # TUM, by name, in another order.
    poses.write_text("# time and pose\n" + "".join(f"l_{k}.png {k} 0 0 {k} 0 0 0 1\n" for k in reversed(range(12))))
    assert run("import", folder, "-o", tmp_path / "b", *PATTERNS, *hand, "--poses", poses).code == 0
    np.testing.assert_array_equal(open_capture(tmp_path / "b").poses[:, 2, 3], np.arange(12))
    for text, said in (
        ("0 0 0 0 0 0 0 1\n", "found 1 lines, expected one for each of 12 images"),
        ("0 0 0 0 0 0 0 3\n", "line 1: found '0 0 0 0 0 0 0 3', found no rigid motion"),
        ("-\n" * 12, "line 1"),
        ("1 " * 100_000, "line 1"),
    ):
        poses.write_text(text)
        assert said in refused("import", folder, "-o", tmp_path / "c", *PATTERNS, *hand, "--poses", poses)


def test_a_board_that_a_hand_goes_round(run, tmp_path):
    save(tmp_path / "in", [f"v{k}.png" for k in range(4)])
    poses = tmp_path / "poses.txt"
    poses.write_text("0 1 2 3 0 0 0 1\n-\n0 2 2 3 0 0 0 1\n0 3 2 3 0 0 0 1\n")
    words = ("--board", "chessboard 6x4 25mm", "--carries", "poses", "--poses", poses)
    ran = run("import", tmp_path / "in", "-o", tmp_path / "a", *words)
    assert ran.code == 0 and "the board stood still" in ran.out
    records = open_capture(tmp_path / "a").records
    assert [record.placement for record in records] == [0, None, 0, 0] and records[1].pose is None


def test_placements_of_a_board(run, tmp_path):
    save(tmp_path / "in", [f"v{k}.png" for k in range(6)])
    board = ("--board", "chessboard 6x4 25mm")
    (tmp_path / "angles.txt").write_text("0 0\n10 0\n20 0\n0 1\n10 1\n- \n")
    assert run("import", tmp_path / "in", "-o", tmp_path / "a", *board, "--angles", tmp_path / "angles.txt").code == 0
    records = open_capture(tmp_path / "a").records
    assert [record.placement for record in records] == [0, 0, 0, 1, 1, None] and records[5].angle is None
    ran = run("import", tmp_path / "in", "-o", tmp_path / "b", *board, "--step-deg", "10")
    assert ran.code == 0 and "the board stood still" in ran.out
    assert {record.placement for record in open_capture(tmp_path / "b").records} == {0}


def test_a_board_that_is_not_understood(refused, tmp_path):
    save(tmp_path / "in", ["1.png"])
    message = refused("import", tmp_path / "in", "-o", tmp_path / "a", "--board", "chessboard 11x6 13")
    assert 'expected "chessboard 11x6 13mm"' in message


def test_a_bracket_and_its_response(run, refused, tmp_path):
    """The response of a gamma camera is learned from the exposures that the patterns name."""
    v, u = np.mgrid[0:60, 0:80] / 12.0
    level = 5 + 240 * (0.5 + 0.5 * np.sin(u + np.sin(v))) ** 2
    for k in range(2):
        for side, factor in (("l", 1.0), ("b", 0.9)):
            for ms in (2, 8):
                code = 255 * (np.clip(level * factor * ms / 8 / 255, 0, 1)) ** (1 / 2.2)
                save(tmp_path / "in", [f"{side}_{ms}ms_{k}.png"], [np.rint(code).astype(np.uint8)])
    patterns = "--on l_2ms_* l_8ms_* --off b_2ms_* b_8ms_* --exposures-ms 2 8 --step-deg 1"
    bracket = patterns.split()
    ran = run("import", tmp_path / "in", "-o", tmp_path / "a", *bracket, "--response", "learn")
    assert ran.code == 0, ran.err
    capture = open_capture(tmp_path / "a")
    assert capture.exposures == (0.002, 0.008)
    kind, gamma = capture.response.split()
    assert kind == "gamma" and abs(float(gamma) - 2.2) <= 0.05
    assert "response learned" in ran.out
    single = ("--on", "l_2ms_*", "--step-deg", "1", "--response", "learn")
    assert "needs images of several exposures" in refused("import", tmp_path / "in", "-o", tmp_path / "b", *single)
    few = ("--on", "l_2ms_*", "--exposures-ms", "2", "8", "--step-deg", "1")
    assert "expected a pattern for each exposure" in refused("import", tmp_path / "in", "-o", tmp_path / "b", *few)


def test_properties_that_no_image_says(pairs, run, tmp_path):
    folder, _ = pairs
    words = ("--response", "srgb", "--shutter", "rolling", "--up", "+u", "--stripe-axis", "columns")
    ran = run(
        "import", folder, "-o", tmp_path / "a", *PATTERNS, "--step-deg", "1", *words, "--pixel-format", "bayer_rggb8"
    )
    assert ran.code == 0, ran.err
    capture = open_capture(tmp_path / "a")
    assert capture.response == "srgb" and capture.up == "+u" and capture.pixel_format == "bayer_rggb8"
    assert capture.lasers[0].stripe_axis == "columns"
    assert any("the shutter is rolling" in note for note in capture.notes)


@pytest.mark.parametrize(("suffix", "codec"), [(".avi", "FFV1"), (".avi", "MJPG"), (".mp4", "mp4v")])
def test_videos(run, tmp_path, suffix, codec):
    """Frames of a laser-on and a laser-off video, every second one; coded without loss they are exact."""
    (tmp_path / "in").mkdir()
    v, u = np.mgrid[0:48, 0:64]
    frames = [np.stack([(u * 3 + 9 * k) % 256, v * 4, np.full_like(u, 10 * k)], -1).astype(np.uint8) for k in range(9)]
    for name, light in (("laser", frames), ("background", [frame // 2 for frame in frames])):
        writer = cv2.VideoWriter(
            str(tmp_path / "in" / (name + suffix)), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 10, (64, 48)
        )
        if not writer.isOpened():
            pytest.skip(f"OpenCV cannot write {codec} here")
        for frame in light:
            writer.write(frame[..., ::-1])
        writer.release()
    ran = run("import", tmp_path / "in", "-o", tmp_path / "room", "--step-deg", "3", "--every", "2")
    assert ran.code == 0, ran.err
    assert f"laser{suffix}#0 ... laser{suffix}#8" in ran.out and f"laser{suffix} has 9 frames" in ran.out
    capture = open_capture(tmp_path / "room")
    np.testing.assert_allclose(np.degrees(capture.angles), 3.0 * np.arange(5))
    assert any("video" in note for note in capture.notes)
    (chunk,) = capture.chunks(5)
    # Codecs with losses halve the resolution of colours, and some lose half a frame's levels.
    error = np.abs(chunk.on.astype(int) - np.array(frames[::2]))
    assert np.median(error) <= (1 if codec == "FFV1" else 12)


CICLOP = {
    "camera": (["--board", "chessboard 11x6 13mm"], "calibration", 16),
    "scene": ([], "sweep", 1),
    "pattern": (["--board", "chessboard 11x6 13mm"], "calibration", 3),
    ".": (
        "--boards camera/* --on pattern/laser-0* --off pattern/laser-background* --board".split()
        + ["chessboard 11x6 13mm"],
        "calibration",
        18,
    ),
}


@pytest.mark.parametrize("folder", CICLOP)
def test_the_ciclop_in_one_command(run, tmp_path, folder):
    words, kind, records = CICLOP[folder]
    ran = run("import", DATA / "ciclop" / folder, "-o", tmp_path / "a", *words)
    assert ran.code == 0, ran.err
    capture = open_capture(tmp_path / "a")
    assert capture.header.kind == kind and len(capture) == records and capture.image_size == (960, 1280)
    lit = [record for record in capture.records if record.on]
    assert len(lit) == {"camera": 0, "scene": 1, "pattern": 2, ".": 2}[folder]
    if lit:
        on, off = capture.frames(0)
        # The laser is red and in one of the two.
        assert on[..., 0].astype(int).max() > off[..., 0].max() and (on.astype(int) - off)[..., 0].max() > 100
    assert any("JPEG" in note for note in capture.notes) == (folder in ("camera", "."))


DEEP = RNG.integers(0, 4096, (8, 10, 12), np.uint16)


@pytest.mark.parametrize(
    ("stored", "bits", "said"),
    [
        (DEEP, 12, "12 bits: the largest sample is"),
        (DEEP * 16, 12, "12 bits at the top of 16: the last 4 are always empty"),
        (DEEP // 4 * 64, 10, "10 bits at the top of 16"),
        (DEEP * 16 + 5, 16, "16 bits: the largest sample is"),
        (DEEP // 16 * 257, None, "8 bits: all samples are multiples of 257"),
        (DEEP // 16 * 256, None, "8 bits at the top of 16"),
    ],
)
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_images_of_16_bits(run, tmp_path, stored, bits, said, suffix):
    names = [f"{side}_{k}.{suffix}" for side in ("laser", "background") for k in range(4)]
    folder = save(tmp_path / "in", names, stored)
    ran = run("import", folder, "-o", tmp_path / "room", "--step-deg", "5")
    assert ran.code == 0 and said in ran.out, ran.err
    capture = open_capture(tmp_path / "room")
    assert capture.header.camera.bits == bits and not verify_capture(tmp_path / "room")
    (chunk,) = capture.chunks(4)
    if bits is None:
        np.testing.assert_array_equal(chunk.on, (DEEP // 16)[:4])
        return
    assert capture.exposures == level_exposures(bits)
    samples = stored if bits == 16 else stored // (16 if said.startswith("12 bits at") else 1)
    samples = stored // 64 if bits == 10 else samples
    for k, frame in enumerate(samples[:4]):
        np.testing.assert_array_equal(chunk.on[k], [image for image, _ in split_levels(frame, bits)])


def test_bits_that_are_said(run, refused, tmp_path):
    folder = save(tmp_path / "in", [f"laser_{k}.png" for k in range(4)], DEEP // 8)
    words = ("import", folder, "--step-deg", "5", "-o")
    assert run(*words, tmp_path / "a", "--bits", "12").code == 0
    assert open_capture(tmp_path / "a").header.camera.bits == 12
    cv2.imwrite(str(folder / "laser_2.png"), DEEP[0] + 1000)
    assert "--bits 10: found samples up to" in refused(*words, tmp_path / "b", "--bits", "10")
    plain = save(tmp_path / "plain", ["laser_0.png", "laser_1.png"])
    assert "found 8 bits in laser_0.png" in refused(
        "import", plain, "-o", tmp_path / "c", "--step-deg", "5", "--bits", "12"
    )
    mixed = save(tmp_path / "mixed", [f"laser_{k}.png" for k in range(40)], [DEEP[0]] * 40)
    cv2.imwrite(str(mixed / "laser_2.png"), DEEP[0] * 15)
    ran = run("import", mixed, "-o", tmp_path / "d", "--step-deg", "5")
    assert ran.code == 1 and "laser_2.png: found samples up to" in ran.err
    cv2.imwrite(str(mixed / "laser_2.png"), FRAMES[0])
    ran = run("import", mixed, "-o", tmp_path / "e", "--step-deg", "5")
    assert ran.code == 1 and "found 8 bits, expected 16" in ran.err and not (tmp_path / "e").exists()


def test_boards_of_12_bits_keep_them(run, tmp_path):
    folder = save(tmp_path / "in", ["1.png", "2.png"], DEEP)
    ran = run("import", folder, "-o", tmp_path / "boards", "--board", "chessboard 6x4 25mm")
    assert ran.code == 0 and "kept in 3 levels of 8 bits" in ran.out
    capture = open_capture(tmp_path / "boards")
    kept = [image for image, _ in split_levels(DEEP[0], 12)]
    np.testing.assert_array_equal(capture.frames(0)[1], kept)
    np.testing.assert_array_equal(capture.pictures(0)[1], kept[0])


def test_colours_of_ink_are_no_damage(refused, tmp_path):
    for name, suffix in (("laser_0.jpg", "JPEG"), ("laser_0.tif", "TIFF")):
        folder = tmp_path / suffix
        folder.mkdir()
        PIL.Image.new("CMYK", (32, 24), (10, 20, 30, 40)).save(folder / name)
        message = refused("import", folder, "-o", tmp_path / "room", "--step-deg", "5")
        assert "found the colours CMYK, expected grey or RGB; convert it" in message and "damaged" not in message


def test_images_that_are_not_read_are_named(run, refused, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    for k in range(3):
        (folder / f"IMG_{k}.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    message = refused("import", folder, "-o", tmp_path / "room")
    assert "3 .heic files are not read: convert them" in message
    save(folder, [f"laser_{k}.png" for k in range(4)])
    ran = run("import", folder, "-o", tmp_path / "room", "--step-deg", "5")
    assert ran.code == 0 and "3 .heic files are not read" in ran.out
    os.rename(folder / "IMG_0.HEIC", folder / "laser_0.png")
    assert "laser_0.png: found HEIC or AVIF" in refused("import", folder, "-o", tmp_path / "b", "--step-deg", "5")


def test_two_scans_in_one_folder(run, refused, tmp_path):
    folder = tmp_path / "scans"
    for scan in ("monday", "tuesday"):
        save(folder, [f"{scan}/{side}_{k}.png" for side in ("laser", "background") for k in range(4)])
    message = refused("import", folder, "-o", tmp_path / "room", "--step-deg", "5")
    assert "monday/laser_*.png (4), tuesday/laser_*.png (4)" in message and "expected one scan" in message
    assert run("import", folder / "monday", "-o", tmp_path / "room", "--step-deg", "5").code == 0
    patterns = ("--on", "*/laser_*", "--off", "*/background_*")
    ran = run("import", folder, "-o", tmp_path / "both", "--step-deg", "5", *patterns)
    assert ran.code == 0 and "tuesday/laser_*.png (4); is this one scan?" in ran.out


def test_folders_that_a_camera_fills_one_after_the_other(run, tmp_path):
    save(
        tmp_path / "in", [*(f"100CAM/laser_{k}.png" for k in range(4)), *(f"101CAM/laser_{k}.png" for k in range(4, 8))]
    )
    ran = run("import", tmp_path / "in", "-o", tmp_path / "room", "--step-deg", "5")
    assert ran.code == 0 and "100CAM/laser_*.png (4), 101CAM/laser_*.png (4); is this one scan?" in ran.out


@pytest.mark.parametrize(
    ("numbers", "said", "last"),
    [
        (["101502", "101508", "101515", "101521", "101528"], "do not count steps", 20),
        (["101550", "101555", "101600", "101605", "101610"], "do not count steps", 20),
        (["20260301101550", "20260301101600", "20260301101610"], "do not count steps", 10),
        (["0", "10", "20", "40"], "by the numbers in the names, 1 of which are missing", 20),
        (["0", "2", "3", "5"], "2 of which are missing", 25),
    ],
)
def test_times_are_no_steps(run, tmp_path, numbers, said, last):
    save(tmp_path / "in", [f"laser_{number}.png" for number in numbers])
    ran = run("import", tmp_path / "in", "-o", tmp_path / "room", "--step-deg", "5")
    assert ran.code == 0 and said in ran.out
    assert np.degrees(open_capture(tmp_path / "room").angles[-1]) == pytest.approx(last)


def test_more_steps_missing_than_there_are(refused, tmp_path):
    save(tmp_path / "in", [f"laser_{number}.png" for number in (0, 1, 2, 3, 40, 41)])
    message = refused("import", tmp_path / "in", "-o", tmp_path / "room", "--step-deg", "5")
    assert "36 of 42 steps would be missing" in message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.replace(b"\xff\xc0\x00\x0b\x08", b"\xff\xc1\x00\x0b\x0c"), "found a JPEG of 12 bits"),
        (lambda data: data.replace(b"\xff\xc0\x00\x0b\x08", b"\xff\xc3\x00\x0b\x08"), "found a JPEG of lossless"),
        (lambda data: b"II+\0" + bytes(60), "found BigTIFF"),
        (lambda data: b"P5 12 10 255\n" + bytes(120), "found PGM or PPM"),
    ],
)
def test_kinds_of_pictures_are_no_damage(refused, tmp_path, change, words):
    folder = save(tmp_path / "in", ["laser_0.jpg"])
    data = (folder / "laser_0.jpg").read_bytes()
    assert change(data) != data
    (folder / "laser_0.jpg").write_bytes(change(data))
    message = refused("import", folder, "-o", tmp_path / "room")
    assert words in message and "damaged" not in message and "convert it" in message
