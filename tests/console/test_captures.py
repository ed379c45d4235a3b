"""What the console finds in its folder."""

import json
import os
import shutil

import pytest

from jaxscan.cli.console.captures import Captures, verdict_of
from jaxscan.cli.console.orders import Order
from jaxscan.cli.console.slate import Slate
from jaxscan.cli.console.works import Works, keep
from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.calibration import calibration_digest, load_calibration


def test_the_newest_good_calibration_is_found(tiny, tmp_path):
    folder = Captures(tmp_path)
    assert folder.newest_calibration() is None
    shutil.copytree(tiny.boards, tmp_path / "boards")
    shutil.copytree(tiny.sweep, tmp_path / "room")
    assert folder.newest_calibration() is None
    for name in ("boards", "room"):
        # One beside a sweep was not made of it.
        shutil.copy(tiny.calibration, folder.calibration(name))
        shutil.copy(tiny.calibration.with_suffix(".npz"), tmp_path / f"{name}.npz")
    assert folder.newest_calibration() == tmp_path / "boards.json"


def test_a_calibration_that_is_refused_or_torn_is_not_used(tiny, tmp_path):
    folder = Captures(tmp_path)
    shutil.copytree(tiny.boards, tmp_path / "boards")
    found = json.loads(tiny.calibration.read_text())
    found["quality"]["converged"] = False
    folder.calibration("boards").write_text(json.dumps(found))
    assert folder.newest_calibration() is None
    folder.calibration("boards").write_text("{")
    assert folder.newest_calibration() is None


def test_a_capture_is_complete_if_its_session_said_so(tiny, tmp_path):
    shutil.copytree(tiny.sweep, tmp_path / "room")
    journal = tmp_path / "room" / "frames.jsonl"
    records = b"".join(line for line in journal.read_bytes().splitlines(keepends=True) if b'"event"' not in line)
    for end, complete in ((b"", False), (b'{"event": "end", "status": "complete"}\n', True), (b'{"event": "en', False)):
        journal.write_bytes(records + end)
        (listed,) = Captures(tmp_path).listed()
        assert listed["complete"] is complete and not listed["problem"]


def test_a_calibration_beside_the_folder_is_found_if_it_fits_the_rig(tiny, tmp_path):
    folder = Captures(tmp_path / "captures")
    shutil.copy(tiny.calibration, tmp_path / "better.json")
    (tmp_path / "other.json").write_text('{"format": "something/1"}')
    (tmp_path / "torn.json").write_text('{"format": "jaxscan-calibration/1", ')
    (tmp_path / "link.json").symlink_to(tiny.calibration)
    (one,) = folder.calibrations()
    assert (one["file"], one["beside"], one["good"]) == ("better.json", True, True)
    assert one["sigma_mm"] > 0 and one["headline"].startswith("Good to ")
    assert folder.newest_calibration() == tmp_path / "better.json"
    of_another = Captures(tmp_path / "captures", lambda found: False)
    assert of_another.newest_calibration() is None and of_another.calibrations() == []
    # A cloud's own is found all the same.
    digest = calibration_digest(tmp_path / "better.json")
    assert of_another.calibration_of(digest) == tmp_path / "better.json"


def test_a_cloud_says_which_calibration_made_it_and_what_was_made_of_an_older_cloud_is_old(tiny, tmp_path):
    folder = captured(tmp_path, tiny)
    assert folder.listed()[0]["made_with"] == ""
    digest = calibration_digest(tiny.calibration)
    folder.cloud("room").write_bytes(b"ply\nformat ascii 1.0\ncomment calibration %s\n" % digest.encode())
    os.utime(folder.cloud("room"), (2e9, 2e9))
    (listed,) = folder.listed()
    assert listed["cloud"] and listed["made_with"] == digest and listed["made"] == []
    folder.cloud("room").unlink()
    folder.cloud("room").symlink_to(tiny.calibration)
    assert folder.listed()[0]["made_with"] == ""


def test_a_verdict_on_the_page_has_the_lines_that_it_follows_from(tiny):
    about = verdict_of(load_calibration(tiny.calibration))
    first = about["lengths"][0]
    assert not first["part"] and about["headline"].startswith("Good to ")
    assert first["sigma_mm"] == pytest.approx(about["sigma_mm"], rel=1e-6)
    parts = [line["sigma_mm"] for line in about["lengths"] if line["part"]]
    # Parts below a thirtieth are not listed.
    assert first["sigma_mm"] == pytest.approx(sum(part**2 for part in parts) ** 0.5, rel=5e-3)


def test_of_what_a_verb_says_pages_keep_the_news():
    lines = []
    for line in (
        "note: a",
        "Calibrating: 10 %, about 60 s left",
        "Calibrating: 20 %, about 50 s left",
        "next: jaxscan",
    ):
        keep(lines, line)
    assert lines == ["note: a", "Calibrating: 20 %, about 50 s left"]


def captured(tmp_path, tiny):
    """A folder with a capture and what was made of it, beside a file of somebody else."""
    shutil.copytree(tiny.sweep, tmp_path / "captures" / "room")
    for suffix in (".ply", ".glb", ".plan.pdf", ".report.html", ".json"):
        (tmp_path / "captures" / f"room{suffix}").write_text("made")
    (tmp_path / "own.txt").write_text("mine")
    return Captures(tmp_path / "captures")


def there(folder):
    return sorted(name.removeprefix("room") for name in os.listdir(folder.folder))


def test_a_capture_is_deleted_with_what_was_made_of_it_and_no_more(tiny, tmp_path):
    folder = captured(tmp_path, tiny)
    assert folder.listed()[0]["made"] == ["plan", "mesh", "report"]
    (folder.folder / "elsewhere").symlink_to(tiny.sweep)
    (folder.folder / "empty").mkdir()
    (folder.folder / "room" / "link").symlink_to(tmp_path / "own.txt")
    for name in ("elsewhere", "empty", "nothing", "..", "../captures/room", "room/..", ""):
        with pytest.raises(CaptureError):
            folder.delete(name)
    folder.delete("room")
    # The calibration stays, and so does what a link in the capture leads to.
    assert there(folder) == [".json", "elsewhere", "empty"]
    assert (tmp_path / "own.txt").read_text() == "mine" and (tiny.sweep / "capture.toml").exists()


def test_a_capture_is_renamed_with_what_was_made_of_it_unless_the_name_is_taken(tiny, tmp_path):
    folder = captured(tmp_path, tiny)
    (folder.folder / "taken.ply").write_text("another")
    for other in ("taken", "room", "../out", ""):
        with pytest.raises(CaptureError):
            folder.rename("room", other)
    assert there(folder) == ["", ".glb", ".json", ".plan.pdf", ".ply", ".report.html", "taken.ply"]
    folder.rename("room", "hall")
    halls = ["hall", "hall.glb", "hall.plan.pdf", "hall.ply", "hall.report.html"]
    assert there(folder) == [".json", *halls, "taken.ply"]
    assert [one["name"] for one in folder.listed()] == ["hall"]


def test_a_second_recalibration_by_a_sweep_begins_from_the_calibration_before_the_first(tiny, tmp_path, monkeypatch):
    """What a sweep tells counts once; and the calibration that is used is not written over while it is read."""
    folder, begun = Captures(tmp_path), []
    monkeypatch.setattr(Works, "begin", lambda works, work: begun.append(list(work.words)))
    shutil.copy(tiny.calibration, folder.calibration("boards"))
    found = json.loads(tiny.calibration.read_text())
    digest = calibration_digest(folder.calibration("boards"))
    found["provenance"] |= {"captures": [{"name": "room"}], "calibration": {"name": "boards.json", "digest": digest}}
    better = tmp_path / "room.recalibrated.json"
    better.write_text(json.dumps(found))
    works = Works(Slate(doing="nothing"), folder, better)
    for name in ("room", "hall"):
        works.carry_out(Order("recalibrate", name))
    assert [words[1:4] for words in begun] == [
        [str(tmp_path / "room"), "-c", str(folder.calibration("boards"))],
        [str(tmp_path / "hall"), "-c", str(better)],
    ]
    folder.calibration("boards").unlink()
    with pytest.raises(
        OptionError, match="is made of room already, and the calibration before it is not in the folder"
    ):
        works.carry_out(Order("recalibrate", "room"))
