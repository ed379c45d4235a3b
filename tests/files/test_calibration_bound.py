"""A calibration and its observations are bound by digests, and a value changed by hand is noticed."""

import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from jaxscan.errors import CalibrationError
from jaxscan.files.calibration import calibration_notes, load_calibration, load_scanner, save_calibration
from jaxscan.files.disk import writing
from jaxscan.geometry import Chessboard

from .test_calibration import make_calibration, make_observations


@pytest.fixture
def path(tmp_path):
    save_calibration(make_calibration(observations=make_observations()), tmp_path / "c.json")
    return tmp_path / "c.json"


def changed(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_observations_of_another_calibration_are_refused(path, tmp_path):
    load_calibration(path)
    (tmp_path / "other").mkdir()
    board = Chessboard(columns=4, rows=3, square=0.03)
    save_calibration(make_calibration(observations=make_observations(board)), tmp_path / "other" / "c.json")
    data = path.with_suffix(".npz").read_bytes()
    at = len(data) // 2
    foreign = (tmp_path / "other" / "c.npz").read_bytes()
    flipped = data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]
    for other in (foreign, data[:at], b"", b"no archive", flipped):
        path.with_suffix(".npz").write_bytes(other)
        belonging = r"the observations beside c\.json belong to another"
        message = belonging if other is foreign else r"the observations are damaged \(not a readable"
        with pytest.raises(CalibrationError, match=rf"c\.npz: {message}") as caught:
            load_calibration(path)
        assert "\n" not in str(caught.value)
        # A reconstruction needs the JSON alone.
        load_scanner(path)
        assert calibration_notes(path) == []
    path.with_suffix(".npz").unlink()
    assert load_calibration(path).observations is None


def test_a_value_changed_by_hand_is_noted(path):
    assert calibration_notes(path) == []
    # The same values, set in another way.
    changed(path, lambda data: None)
    assert calibration_notes(path) == []

    def longer(data):
        data["camera"]["fx"] *= 1.01

    changed(path, longer)
    (note,) = calibration_notes(path)
    assert "have changed since jaxscan calibrate wrote it" in note
    load_scanner(path)
    # As the note says.
    changed(path, lambda data: data.pop("digests"))
    assert calibration_notes(path) == []


@pytest.mark.parametrize("kept", [{}, {"values": None, "observations": None}])
def test_older_files_without_digests_stay_readable(path, kept):
    changed(path, lambda data: data.update(digests=kept))
    assert load_calibration(path).observations is not None and calibration_notes(path) == []


def test_observations_beside_a_calibration_that_names_none_are_refused(path, tmp_path):
    save_calibration(make_calibration(), tmp_path / "bare.json")
    shutil.copy(tmp_path / "c.npz", tmp_path / "bare.npz")
    with pytest.raises(CalibrationError, match=r"bare\.npz: .* calibrate again.* or move this one away"):
        load_calibration(tmp_path / "bare.json")
    load_scanner(tmp_path / "bare.json")


def contents(folder):
    return {found.name: found.read_bytes() for found in folder.iterdir()}


def test_both_files_are_complete_before_one_gets_its_name(path, tmp_path, monkeypatch):
    """A kill at any other moment leaves the old pair; the observations are renamed first."""
    before, renamed = contents(tmp_path), []
    board = Chessboard(columns=4, rows=3, square=0.03)
    new = make_calibration(observations=make_observations(board))
    (tmp_path / "elsewhere").mkdir()
    save_calibration(new, tmp_path / "elsewhere" / "c.json")
    after = contents(tmp_path / "elsewhere")
    shutil.rmtree(tmp_path / "elsewhere")

    def replace(part, target):
        if not renamed:
            parts = sorted(content for name, content in contents(tmp_path).items() if name.startswith(".part-"))
            assert parts == sorted(after.values())
            assert {name: contents(tmp_path)[name] for name in before} == before
        renamed.append(Path(target).name)
        rename(part, target)

    rename = os.replace
    monkeypatch.setattr(os, "replace", replace)
    save_calibration(new, path)
    assert renamed == ["c.npz", "c.json"]
    assert contents(tmp_path) == after
    load_calibration(path)


@pytest.mark.parametrize("failing", ["c.npz", "c.json"])
def test_a_failure_changes_neither_file(path, tmp_path, monkeypatch, failing):
    before = contents(tmp_path)

    def full(part):
        if part.suffix == Path(failing).suffix:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(writing, "sync_to_disk", full)
    board = Chessboard(columns=4, rows=3, square=0.03)
    with pytest.raises(CalibrationError, match=rf"{failing}: cannot be written: No space left"):
        save_calibration(make_calibration(observations=make_observations(board)), path)
    assert contents(tmp_path) == before
