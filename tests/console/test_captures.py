"""What the console finds in its folder."""

import json
import shutil

from jaxscan.cli.console.captures import Captures


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
