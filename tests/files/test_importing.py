"""Folders of strangers: names in natural order, patterns that stay inside, nothing that is no file; and board words."""

import os
import time

import cv2
import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.importing import list_images, parse_board
from jaxscan.files.importing.roles import group, understand
from jaxscan.files.importing.sources import match, natural
from jaxscan.vision.video import is_cut_short


NAMES = sorted(["l_2.png", "l_10.png", "l_1.png", "b_1.png", "a/l_3.png", "x[1].png"], key=natural)


def test_numbers_sort_by_value():
    assert NAMES == ["a/l_3.png", "b_1.png", "l_1.png", "l_2.png", "l_10.png", "x[1].png"]


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("l_*.png", {"l_1.png": (1,), "l_2.png": (2,), "l_10.png": (10,)}),
        ("l_?.png", {"l_1.png": (1,), "l_2.png": (2,)}),
        ("*l_*.png", {"a/l_3.png": ("a", 3), "l_1.png": (1,), "l_2.png": (2,), "l_10.png": (10,)}),
        ("[!l]_*", {"b_1.png": ("b", 1, "png")}),
        ("[ab]*_[0-9].png", {"a/l_3.png": ("a", "l", 3), "b_1.png": ("b", 1)}),
        ("./b_1.png", {"b_1.png": ()}),
        ("*", None),
    ],
)
def test_patterns(pattern, found):
    hits = {one.name: one.key for one in match(pattern, NAMES, "--on")}
    assert set(hits) == set(NAMES if found is None else found)
    assert found is None or hits == found


@pytest.mark.parametrize("pattern", ["../*", "a/../*.png", "/etc/*", "..", "", "C:/x*", "a\\..\\*", "x" * 2000, "a\n*"])
def test_patterns_that_lead_out_are_refused(pattern):
    with pytest.raises(OptionError, match=r"^--on: found .*expected a pattern"):
        match(pattern, NAMES, "--on")


@pytest.mark.parametrize("pattern", ["none*.png", "[z-a]", "[]", "[!]"])
def test_patterns_that_fit_nothing(pattern):
    with pytest.raises(OptionError):
        match(pattern, NAMES, "--on")


def test_a_pattern_takes_no_time():
    """Each piece is tried once: a pattern of many stars cannot be made slow by a name."""
    started = time.perf_counter()
    with pytest.raises(OptionError):
        match("a*" * 400 + "b", ["a" * 200 + ".png"] * 200, "--on")
    assert time.perf_counter() - started < 5.0


@pytest.mark.parametrize(
    ("name", "role", "side", "key"),
    [
        ("laser.png", "on", None, ()),
        ("laser_background.png", "off", None, ()),
        ("laser-background-0-255-255-8-x.png", "off", None, (0, 255, 255, 8, "x")),
        ("scan3/Laser_L_0012.jpg", "on", "left", ("scan", 3, 12)),
        ("texture_5.png", "texture", None, (5,)),
        ("pattern.png", "board", None, ()),
        ("frame7.jpg", None, None, ("frame", 7)),
    ],
)
def test_words_in_names(name, role, side, key):
    found = understand(name)
    assert (found.role, found.side, found.key) == (role, side, key)


def test_groups_of_names():
    found = group(["a1.png", "a2.png", "b1.png"])
    assert [(one.pattern, one.files, one.first, one.last) for one in found] == [
        ("a*.png", 2, "a1.png", "a2.png"),
        ("b*.png", 1, "b1.png", "b1.png"),
    ]


def test_groups_of_which_one_has_the_name_of_another_and_more():
    """`step*.jpg` would name the files of both."""
    names = ["step1.jpg", "step2.jpg", "step_table1.jpg"]
    found = group(names)
    assert [one.pattern for one in found] == ["step[0-9]*.jpg", "step_table*.jpg"]
    assert [(one.name, one.key) for one in match(found[0].pattern, names, "--on")] == [
        ("step1.jpg", (1,)),
        ("step2.jpg", (2,)),
    ]
    assert [one.key for one in match("step[0-9]*.jpg", ["step9.jpg", "step12.jpg"], "--on")] == [(9,), (12,)]


def image(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((8, 9), 100, np.uint8))


def test_links_pipes_and_hidden_folders_are_left_out(tmp_path):
    inside, outside = tmp_path / "in", tmp_path / "secret"
    image(inside / "a1.png")
    image(outside / "s.png")
    (inside / "link.png").symlink_to(outside / "s.png")
    (inside / "linked").symlink_to(outside)
    (inside / "round").symlink_to(inside)
    os.mkfifo(inside / "pipe.png")
    (inside / "folder.png").mkdir()
    image(inside / ".hidden" / "h.png")
    (inside / "note.txt").write_text("no image")
    assert list_images(inside).images == ["a1.png"]


def test_what_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    for path, said in ((tmp_path / "none", "no such folder"), (tmp_path / "file", "found a file")):
        with pytest.raises(CaptureError, match=said):
            list_images(path)


def refusal(capsys, *words):
    assert main([str(word) for word in words]) == 1
    said = capsys.readouterr().err
    assert said.startswith("jaxscan: ") and said.count("\n") == 1
    return said


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda path: path.write_bytes(b""), "an empty file"),
        (lambda path: path.write_bytes(b"GIF89a" + bytes(50)), "found GIF, expected PNG"),
        (lambda path: path.write_bytes(path.read_bytes()[:-20]), "damaged"),
        (lambda path: cv2.imwrite(str(path), np.zeros((8, 10), np.uint8)), "found 10 x 8 px, expected 9 x 8 px"),
        (lambda path: cv2.imwrite(str(path), np.zeros((8, 9, 3), np.uint8)), "found a colour image"),
        (lambda path: cv2.imwrite(str(path), np.zeros((8, 9), np.uint16)), "found 16 bits, expected 8"),
        (lambda path: os.truncate(path, 1 << 33), "larger than"),
    ],
)
def test_images_that_do_not_fit(tmp_path, capsys, damage, said):
    for k in range(3):
        image(tmp_path / "in" / f"laser_{k}.png")
    damage(tmp_path / "in" / "laser_2.png")
    message = refusal(capsys, "import", tmp_path / "in", "-o", tmp_path / "out", "--step-deg", "1")
    assert said in message and "laser_2.png" in message
    # Nothing half written is left.
    assert sorted(os.listdir(tmp_path)) == ["in"]


def test_a_pattern_that_names_two_scans_is_said(tmp_path, capsys):
    for k in range(3):
        image(tmp_path / f"step{k}.png")
        image(tmp_path / f"step_table{k}.png")
    assert main(["import", str(tmp_path), "--show", "--on", "step*", "--step-deg", "1"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "'step*' names 2 kinds of files, one after the other" in said and "is this one scan?" in said
    assert "--on 'step[0-9]*.png' --off 'step_table*.png'" in refusal(capsys, "import", tmp_path, "--show")
    assert main(["import", str(tmp_path), "--show", "--on", "step[0-9]*", "--step-deg", "1"]) == 0
    assert "kinds of files" not in capsys.readouterr().out


@pytest.mark.parametrize(("copies", "taken"), [(3, "Snap_*.png"), (2, None)])
def test_copies_with_painted_corners_are_no_boards(tmp_path, capsys, copies, taken):
    """As many images, in a folder below whose name says what they show, are copies of those above."""
    for k in range(3):
        image(tmp_path / f"Snap_{k:03d}.png")
    for k in range(copies):
        image(tmp_path / "CalibrationGrids" / f"{k}.png")
    assert main(["import", str(tmp_path), "--show", "--board", "chessboard 8x6 40mm"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert ("'Snap_*.png' (3) show the board" in said) is (taken is not None)
    assert ("other images (3) are not used" in said) is (taken is None)


def test_what_is_refused(tmp_path, capsys):
    for k in range(3):
        image(tmp_path / "in" / f"laser_{k}.png")
        image(tmp_path / "in" / f"v{k}.png")
    source, out = tmp_path / "in", tmp_path / "out"
    words = ("import", source, "-o", out)
    assert "-o: is needed" in refusal(capsys, "import", source)
    assert "--step-deg: is needed for a sweep of 3 steps" in refusal(capsys, *words)
    assert "found both" in refusal(capsys, *words, "--step-deg", "1", "--angles", source / "laser_0.png")
    assert "--board: is needed with --boards" in refusal(capsys, *words, "--boards", "v*")
    assert "laser-off images without laser-on" in refusal(capsys, *words, "--off", "v*", "--step-deg", "1")
    assert "both name laser_0.png" in refusal(capsys, *words, "--on", "l*", "--off", "laser*", "--step-deg", "1")
    assert "found 17 patterns" in refusal(capsys, *words, "--on", *(f"laser_{k}.png" for k in range(17)))
    assert "expected 1 different names" in refusal(capsys, *words, "--lasers", "a", "b", "--step-deg", "1")
    assert "--every: found 0" in refusal(capsys, *words, "--every", "0", "--step-deg", "1")
    assert "--exposures-ms" in refusal(capsys, *words, "--exposures-ms", "-1", "--step-deg", "1")
    assert 'expected "linear"' in refusal(capsys, *words, "--step-deg", "1", "--response", "log")
    assert "is a grey image" in refusal(capsys, *words, "--step-deg", "1", "--pixel-format", "rgb8")
    for step in ("nan", "inf", "1e300"):
        assert "--step-deg: found" in refusal(capsys, *words, "--step-deg", step)
    out.mkdir()
    assert "exists" in refusal(capsys, *words, "--step-deg", "1")
    assert "same file" in refusal(capsys, "import", source, "-o", source, "--step-deg", "1")


def video(path, codec, frames=6):
    """Frames of noise, so that every one of them takes its share of the file."""
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 10, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"OpenCV cannot write {codec} here")
    rng = np.random.default_rng(0)
    for _ in range(frames):
        writer.write(rng.integers(0, 256, (48, 64, 3), np.uint8))
    writer.release()
    return path.read_bytes()


VIDEOS = [(".avi", "FFV1"), (".avi", "MJPG"), (".mkv", "FFV1"), (".webm", "VP80"), (".mp4", "mp4v")]


def test_frames_that_a_video_only_announces_are_said(tmp_path, capsys):
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / "laser.avi"
    whole = video(path, "MJPG")
    # The number of frames in the header of the stream; the file is whole.
    place = whole.index(b"strh") + 8 + 32
    assert whole[place : place + 4] == (6).to_bytes(4, "little")
    path.write_bytes(whole[:place] + (9).to_bytes(4, "little") + whole[place + 4 :])
    assert main(["import", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--step-deg", "1"]) == 0
    assert "laser.avi has 6 frames, but says of itself that it has 9" in capsys.readouterr().out


def test_lists_of_other_files_are_no_videos(tmp_path, capsys):
    """A decoder would open the files that such a list names."""
    image(tmp_path / "secret.png")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "laser.mp4").write_text(f"#EXTM3U\n#EXTINF:1,\n{tmp_path / 'secret.png'}\n")
    message = refusal(capsys, "import", tmp_path / "in", "-o", tmp_path / "out", "--step-deg", "1")
    assert "laser.mp4: found another kind of file, expected a video" in message
    (tmp_path / "in" / "laser.mp4").write_bytes(b"\0\0\0\x20ftypisom" + bytes(200))
    message = refusal(capsys, "import", tmp_path / "in", "-o", tmp_path / "out", "--step-deg", "1")
    assert "cannot be decoded" in message


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("chessboard 11x6 13mm", {"type": "chessboard", "columns": 11, "rows": 6, "square_mm": 13.0}),
        (
            "ChArUco 12x9 3 cm 22 mm",
            {"type": "charuco", "columns": 12, "square_mm": 30.0, "marker_mm": 22.0},
        ),
        ("charuco 5x4 0.03m 20mm DICT_4X4_50", {"square_mm": 30.0, "dictionary": "DICT_4X4_50"}),
        ("charuco 6x8 35mm 24mm DICT_4X4_250 legacy", {"dictionary": "DICT_4X4_250", "layout": "legacy"}),
        ("charuco 6x8 35mm 24mm Legacy", {"dictionary": "DICT_5X5_250", "layout": "legacy"}),
        ("circles 4x11 20mm 16mm", {"type": "circles", "rows": 11, "spacing_mm": 20.0, "layout": "asymmetric"}),
        ("circles 7x7 37.5mm 22mm symmetric", {"diameter_mm": 22.0, "layout": "symmetric"}),
        ("aprilgrid 6×6 24mm 7.2mm", {"type": "aprilgrid", "tag_mm": 24.0, "gap_mm": 7.2}),
    ],
)
def test_boards_as_people_write_them(text, board):
    found = parse_board(text).model_dump()
    assert {key: found[key] for key in board} == board


@pytest.mark.parametrize(
    "text", ["", "chess", "chessboard 11x6", "chessboard 11x6 13", "disc 3x3 1mm", "circles 4x11 20mm"]
)
def test_boards_that_are_not_understood(text):
    with pytest.raises(OptionError, match='expected "chessboard 11x6 13mm"'):
        parse_board(text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("circles 4x10 20mm 16mm", "expected an odd number"),
        ("circles 4x11 20mm 40mm", "diameter_mm: found 40"),
        ("aprilgrid 6x6 24mm 1mm", "gap_mm"),
        ("aprilgrid 30x30 24mm 7mm", "tags, and there are 587"),
        ("circles 4x11 20mm 16mm round", "layout"),
    ],
)
def test_boards_that_cannot_be(text, says):
    with pytest.raises(OptionError, match=says):
        parse_board(text)


@pytest.mark.parametrize(("suffix", "codec"), VIDEOS)
def test_a_video_that_is_cut_short_is_refused(tmp_path, capsys, suffix, codec):
    """Decoders give the frames that are left as if there were no others."""
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / f"laser{suffix}"
    whole = video(path, codec)
    for share in (0.98, 0.7, 0.5):
        path.write_bytes(whole[: int(share * len(whole))])
        message = refusal(capsys, "import", tmp_path / "in", "-o", tmp_path / "out", "--step-deg", "1")
        # The list of frames of an MP4 stands at its end.
        expected = "cannot be decoded" if suffix == ".mp4" else "the file ends before its own header says"
        assert expected in message
        assert not (tmp_path / "out").exists()
    path.write_bytes(whole)
    assert main(["import", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--step-deg", "1"]) == 0
    said = capsys.readouterr().out
    assert f"laser{suffix} has 6 frames" in said and "says of itself" not in said


@pytest.mark.parametrize(
    ("beginning", "short"),
    [
        (b"RIFF" + (100).to_bytes(4, "little") + b"AVI " + bytes(96), False),
        (b"RIFF" + (101).to_bytes(4, "little") + b"AVI " + bytes(96), True),
        (b"RIFF" + bytes(4) + b"AVI ", False),
        (b"RIFF\xff\xff\xff\xffAVI ", False),
        (b"\0\0\0\x10ftypisomisom" + b"\0\0\0\x20mdat" + bytes(24), False),
        (b"\0\0\0\x10ftypisomisom" + b"\0\0\0\x20mdat" + bytes(23), True),
        (b"\0\0\0\x10ftypisomisom" + b"\0\0\0\0mdat" + bytes(23), False),
        (b"\0\0\0\x10ftypisomisom" + b"\0\0\0\1mdat" + (40).to_bytes(8, "big") + bytes(23), True),
        (b"\x1a\x45\xdf\xa3\x81\0" + b"\x18\x53\x80\x67\x85" + bytes(5), False),
        (b"\x1a\x45\xdf\xa3\x81\0" + b"\x18\x53\x80\x67\x85" + bytes(4), True),
        (b"\x1a\x45\xdf\xa3\x81\0" + b"\x18\x53\x80\x67\x01" + 7 * b"\xff" + bytes(4), False),
        (b"\x1a\x45\xdf\xa3", False),
    ],
)
def test_a_video_says_how_long_it_is(tmp_path, beginning, short):
    """Sizes that were left open, as by a recorder that was stopped hard, say nothing."""
    (tmp_path / "video").write_bytes(beginning)
    with open(tmp_path / "video", "rb") as file:
        assert is_cut_short(file) is short
