"""Files and folders in work: locked, removed, and those of killed processes removed by the next."""

import errno
import os
import subprocess
import sys

import pytest

from jaxscan.errors import JaxscanError
from jaxscan.files.disk import forget_partials, partial_file, partial_folder, remove_stale, write_atomically
from jaxscan.files.disk import writing as module


LEFT = ".part-0123456789ab"


def test_a_file_is_made_beside_and_renamed(tmp_path):
    with partial_file(tmp_path / "a.png") as part:
        assert part.parent == tmp_path and part.suffix == ".png" and part.read_bytes() == b""
        part.write_bytes(b"x")
        os.replace(part, tmp_path / "a.png")
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize("make", [partial_file, partial_folder])
@pytest.mark.parametrize("problem", [None, ValueError("broken"), KeyboardInterrupt(), SystemExit(1)])
def test_what_was_not_renamed_is_removed(tmp_path, make, problem):
    if problem is None:
        with make(tmp_path / "a.png"):
            assert len(os.listdir(tmp_path)) == 1
    else:
        with pytest.raises(type(problem)), make(tmp_path / "a.png") as part:
            if part.is_dir():
                (part / "inner").mkdir()
                (part / "inner" / "file").write_bytes(b"x")
            raise problem
    assert os.listdir(tmp_path) == []


def test_a_folder_that_was_renamed_stays(tmp_path):
    with partial_folder(tmp_path / "made") as part:
        (part / "file").touch()
        os.rename(part, tmp_path / "made")
    assert os.listdir(tmp_path) == ["made"] and os.listdir(tmp_path / "made") == ["file"]


def test_names_are_those_that_are_removed(tmp_path):
    for name in ("a", "a.png", "a.cameramodel", "a. b", "a.-", "a." + "x" * 200):
        with partial_file(tmp_path / name) as part:
            pass
        # Left by a killed process, it would be removed.
        part.touch()
        remove_stale(tmp_path)
        assert os.listdir(tmp_path) == []


def test_what_killed_processes_left_is_removed(tmp_path):
    (tmp_path / f"{LEFT}.png").touch()
    (tmp_path / LEFT / "inner").mkdir(parents=True)
    with partial_file(tmp_path / "a.txt") as part:
        assert os.listdir(tmp_path) == [part.name]


@pytest.mark.parametrize("make", ["partial_file", "partial_folder"])
def test_what_other_processes_hold_stays(tmp_path, make):
    code = (
        "import sys, time\nfrom pathlib import Path\n"
        f"from jaxscan.files.disk import {make}\n"
        f"with {make}(Path(sys.argv[1]) / 'a') as part:\n    print(part, flush=True)\n    time.sleep(60)"
    )
    other = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        held = other.stdout.readline().strip()
        remove_stale(tmp_path)
        assert os.path.exists(held)
    finally:
        other.kill()
        other.wait()
        other.stdout.close()
    assert os.path.exists(held)  # Killed, so it could not remove it.
    remove_stale(tmp_path)
    assert os.listdir(tmp_path) == []


def test_nothing_else_is_removed(tmp_path):
    names = [".part-x", ".part-0123456789AB", ".part-0123456789abc", f"{LEFT}.a b", f"x{LEFT}", "part-0123456789ab"]
    for name in names:
        (tmp_path / name).write_bytes(b"kept")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "file").write_bytes(b"kept")
    (tmp_path / LEFT).symlink_to("folder")
    os.mkfifo(tmp_path / f"{LEFT}.pipe")
    remove_stale(tmp_path)
    assert sorted(os.listdir(tmp_path)) == sorted([*names, "folder", LEFT, f"{LEFT}.pipe"])
    assert (tmp_path / "folder" / "file").read_bytes() == b"kept"


def test_forgotten_before_the_process_ends(tmp_path):
    with partial_file(tmp_path / "a") as file, partial_folder(tmp_path / "b") as folder:
        (folder / "x").touch()
        forget_partials()
        assert not file.exists() and not folder.exists()
        # Another's work under the same name is not touched when the block ends.
        file.write_bytes(b"another's")
    assert file.read_bytes() == b"another's"


def test_a_disk_that_turns_read_only_gives_the_first_failure(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(module, "_delete", refuse)
    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(JaxscanError, match=r"a.txt: cannot be written: Read-only file system"):
        write_atomically(tmp_path / "a.txt", b"x")


def test_a_name_taken_by_another_process_is_not_used(tmp_path, monkeypatch):
    """Another process removes the file between its making and its locking."""
    make, made = os.open, []

    def taken(path, *rest):
        handle = make(path, *rest)
        made.append(path)
        if len(made) == 1:
            os.unlink(path)
        return handle

    monkeypatch.setattr(os, "open", taken)
    with partial_file(tmp_path / "a") as part:
        assert part.exists() and part == made[1]


def test_a_folder_removed_before_it_is_opened_is_made_again(tmp_path, monkeypatch):
    """Another process takes it for one that a killed process left, between its making and its opening."""
    opened, tried = os.open, []

    def gone(path, *rest):
        tried.append(path)
        if len(tried) == 1:
            os.rmdir(path)
        return opened(path, *rest)

    monkeypatch.setattr(os, "open", gone)
    with partial_folder(tmp_path / "a") as part:
        assert part.exists() and part == tried[1]
    with pytest.raises(FileNotFoundError), partial_folder(tmp_path / "none" / "a"):
        pass
