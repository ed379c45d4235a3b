"""A folder of files appears whole, or nothing has changed."""

import os
import subprocess

import pytest

from jaxscan.files.disk import whole_folder


@pytest.fixture
def small_disk(tmp_path):
    """A real file system of 200 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(place)]
    if os.geteuid() != 0 or subprocess.run(words, capture_output=True).returncode:
        pytest.skip("a small file system needs the right to mount one")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("name", ["", "new", "a/b"])
def test_a_full_disk_leaves_nothing(small_disk, name):
    with pytest.raises(OSError, match="No space left"), whole_folder(small_disk / name) as part:
        for number in range(10):
            (part / str(number)).write_bytes(bytes(50_000))
    assert os.listdir(small_disk) == []


@pytest.mark.parametrize("name", ["", "new", "a/b"])
def test_all_get_their_names_and_others_stay(tmp_path, name):
    target = tmp_path / name
    (tmp_path / "own").write_text("own")
    with whole_folder(target) as part:
        (part / "images").mkdir()
        (part / "images" / "1").write_text("one")
        assert not (target / "images").exists()
    assert (target / "images" / "1").read_text() == "one" and (tmp_path / "own").read_text() == "own"
    assert not list(tmp_path.rglob(".part-*"))


def test_an_error_leaves_what_was_there(tmp_path):
    (tmp_path / "1").write_text("old")
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path) as part:
        (part / "1").write_text("new")
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == ["1"] and (tmp_path / "1").read_text() == "old"
