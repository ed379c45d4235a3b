"""Digests of images: noted when they are written, found wrong when they changed."""

import json
import time

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files.capture import SEAL, open_capture, seal, seal_note, verify_capture
from jaxscan.files.recording import create_capture, repack_capture, resume_capture

from .conftest import FRAMES, header, journal


def write(path, *, count=4, storage="zstd", digests=True, seal=False):
    with create_capture(path, header(), storage=storage, digests=digests) as capture:
        for k in range(count):
            capture.append(angle_deg=0.1 * k, on=FRAMES[2 * k], off=FRAMES[2 * k + 1])
        if seal:
            capture.seal()
    return path


def messages(path):
    return [str(problem) for problem in verify_capture(path)]


def read_all(path):
    return [chunk.on.copy() for chunk in open_capture(path).chunks(2)]


def test_a_bracket_has_a_digest_for_each_image(tmp_path):
    with create_capture(tmp_path / "room", header(), digests=True) as capture:
        capture.append(
            angle_deg=0.0, on=[(FRAMES[0], 0.01), (FRAMES[1], 0.02)], off=[(FRAMES[2], 0.01), (FRAMES[3], 0.02)]
        )
    (line,) = journal(tmp_path / "room")
    assert [len(line["sha256"][side]) for side in ("on", "off")] == [2, 2]
    assert messages(tmp_path / "room") == []
    (tmp_path / "room" / line["on"][1]["file"]).write_bytes(b"x")
    (found,) = verify_capture(tmp_path / "room")
    assert found.record == 0 and line["on"][1]["file"] in found.message


def test_without_digests_a_record_has_no_such_key_and_only_missing_files_are_found(tmp_path):
    path = write(tmp_path / "room", digests=False)
    assert not any("sha256" in line for line in journal(path))
    assert messages(path) == []
    (path / "off/000002.zst").unlink()
    assert messages(path) == ["record 2: off/000002.zst: no such file."]


@pytest.mark.parametrize("storage", ["zstd", "png", "npy"])
@pytest.mark.parametrize("at", [-1, -20, -70])
def test_a_flipped_bit_is_found(tmp_path, storage, at):
    """Fault 22: silent corruption."""
    path = write(tmp_path / "room", storage=storage)
    assert messages(path) == []
    name = journal(path)[3]["on"].partition("#")[0]
    data = bytearray((path / name).read_bytes())
    data[at] ^= 0x10
    (path / name).write_bytes(data)
    found = verify_capture(path)
    assert len(found) == 1 and found[0].record is not None and "has changed" in found[0].message


def test_only_the_last_take_of_a_record_counts(tmp_path):
    path = write(tmp_path / "room")
    with resume_capture(path, digests=True) as capture:
        capture.append(angle_deg=0.0, on=FRAMES[9], off=FRAMES[10], i=0)
    (path / "on/000000.zst").unlink()
    assert messages(path) == []
    (path / "on/000000-1.zst").unlink()
    assert messages(path) == ["record 0: on/000000-1.zst: no such file."]


@pytest.mark.parametrize(
    "said",
    [
        "",
        "0" * 63,
        "\x1b]0;taken over\x07" + "0" * 50,
    ],
)
def test_what_is_no_digest_is_a_problem_and_not_repeated_as_it_stands(tmp_path, said):
    path = write(tmp_path / "room", count=1)
    (line,) = journal(path)
    (path / "frames.jsonl").write_text(json.dumps({**line, "sha256": {**line["sha256"], "on": said}}) + "\n")
    (problem,) = verify_capture(path)
    assert problem.record == 0 and "expected a sha256" in problem.message and problem.message.isprintable()


def test_a_torn_line_is_said(tmp_path):
    path = write(tmp_path / "room")
    with open(path / "frames.jsonl", "ab") as file:
        file.write(b'{"i": 4, "angle')
    (problem,) = verify_capture(path)
    assert problem.record is None and "line 5" in problem.message


def test_what_was_begun_and_never_had_a_header_may_be_begun_again(tmp_path):
    """Fault 21: a crash between the folders and the header leaves nothing that could be lost."""
    path = tmp_path / "room"
    (path / "on").mkdir(parents=True)
    (path / "off").mkdir()
    (path / "frames.jsonl").touch()
    (path / ".part-0123456789ab.toml").write_text("form")
    write(path)
    assert len(open_capture(path)) == 4


def edited(path, name, old, new):
    text = (path / name).read_text()
    assert old in text
    (path / name).write_text(text.replace(old, new))


def without_line(path, number):
    lines = (path / "frames.jsonl").read_text().splitlines(keepends=True)
    del lines[number]
    (path / "frames.jsonl").write_text("".join(lines))


RECORD = '"angle_deg": 1, "on": "on/000000.png", "off": "off/000000.png"'
CHANGES = {
    "an angle": lambda path: edited(path, "frames.jsonl", '"angle_deg": 0.2', '"angle_deg": 0.3'),
    "a record removed": lambda path: without_line(path, 1),
    "a record added": lambda path: edited(path, "frames.jsonl", '{"event"', f'{{"i": 9, {RECORD}}}\n{{"event"'),
    "the count in the seal": lambda path: edited(path, "frames.jsonl", '"sealed_records": 4', '"sealed_records": 3'),
    "a digest": lambda path: edited(path, "frames.jsonl", '"sha256": {"on": "', '"sha256": {"on": "0'),
    "the header": lambda path: edited(path, "capture.toml", '"mono8"', '"bayer_rggb8"'),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_in_a_sealed_capture_is_an_error_of_one_line(tmp_path, change):
    path = write(tmp_path / "room", seal=True)
    assert open_capture(path).notes == () and seal_note(path) == "" and messages(path) == []
    CHANGES[change](path)
    with pytest.raises(CaptureError, match=r"(frames\.jsonl|capture\.toml).*has changed") as caught:
        open_capture(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(CaptureError):
        repack_capture(path, tmp_path / "packed", storage="npy")
    assert any(problem.lasting for problem in verify_capture(path))


@pytest.mark.parametrize("storage", ["zstd", "png", "npy"])
def test_a_changed_image_is_an_error_wherever_it_is_read(tmp_path, storage):
    path = write(tmp_path / "room", storage=storage, seal=True)
    assert len(read_all(path)) == 2
    name = journal(path)[2]["on"].partition("#")[0]
    data = bytearray((path / name).read_bytes())
    if storage != "npy":
        # A good image, of another record.
        data = (path / journal(path)[1]["on"]).read_bytes()
    else:
        data[128 + 2 * FRAMES[0].size] ^= 1
    (path / name).write_bytes(data)
    capture = open_capture(path)
    reads = [lambda: read_all(path), lambda: capture.frames(2), lambda: capture.image(capture.records[2].on[0])]
    reads.append(lambda: repack_capture(path, tmp_path / "packed", storage="png"))
    for read in reads:
        with pytest.raises(CaptureError, match=rf"record 2: {name}.*has changed since it was written"):
            read()
    assert not (tmp_path / "packed").exists()
    # Whoever wants the time that it takes.
    assert open_capture(path, compare=False).frames(2)[0] is not None
    assert np.array_equal(capture.frames(1)[0], FRAMES[2])


def test_without_its_seal_a_capture_says_so(tmp_path):
    path = write(tmp_path / "room", seal=True)
    without_line(path, 4)
    (note,) = open_capture(path).notes
    assert "not sealed, although its records have digests" in note and seal_note(path) == note


def test_records_after_the_last_seal_are_counted(tmp_path):
    path = write(tmp_path / "room", seal=True)
    with resume_capture(path, digests=True) as capture:
        capture.append(angle_deg=0.4, on=FRAMES[8], off=FRAMES[9])
        capture.append(angle_deg=0.5, on=FRAMES[10], off=FRAMES[11])
    (note,) = open_capture(path).notes
    assert "not sealed: 2 records after the last seal" in note
    with resume_capture(path, digests=True) as capture:
        capture.seal()
    assert open_capture(path).notes == () and journal(path)[-1]["sealed_records"] == 6
    edited(path, "frames.jsonl", '"sealed_records": 4', '"sealed_records": 5')
    with pytest.raises(CaptureError, match="line 10: the seal does not fit"):
        open_capture(path)


def test_seals_without_header_and_captures_without_digests_stay_readable(tmp_path):
    path = write(tmp_path / "old")
    with resume_capture(path, digests=True) as capture:
        capture.flush()
        # Scans have always noted how many records they believed; a suspect record is in the journal all the same.
        capture.event("end", records=3, **{SEAL: seal(path)[SEAL]})
    assert open_capture(path).notes == ()
    bare = write(tmp_path / "bare", digests=False)
    assert open_capture(bare).notes == () and "not sealed" in seal_note(bare)
    with resume_capture(bare, digests=True) as capture:
        capture.append(angle_deg=1.0, on=FRAMES[8], off=FRAMES[9])
    assert "4 of 5 records have no digests" in seal_note(bare)


def test_a_file_larger_than_any_image_is_not_read(tmp_path):
    """Ten gigabytes of nothing, which take no room on the disk, would take half a minute."""
    path = write(tmp_path / "room", seal=True)
    victim = sorted((path / "on").iterdir())[0]
    with open(victim, "r+b") as file:
        file.truncate(10 << 30)
    began = time.monotonic()
    (problem,) = verify_capture(path)
    assert "larger than" in problem.message and time.monotonic() - began < 5
