"""Files and folders appear whole or not at all."""

import errno
import os
import subprocess

import pytest

from jaxscan.errors import CloudError, JaxscanError
from jaxscan.files.disk import check_writable, whole_folder, write_atomically


def test_bytes_and_callables(tmp_path):
    write_atomically(tmp_path / "a.txt", b"one")
    write_atomically(tmp_path / "b.ply", lambda part: part.write_bytes(part.suffix.encode()) and None)
    assert (tmp_path / "a.txt").read_bytes() == b"one"
    # Libraries choose by the suffix, so the temporary file has it too.
    assert (tmp_path / "b.ply").read_bytes() == b".ply"
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.ply"]


@pytest.mark.parametrize("durable", [True, False])
@pytest.mark.parametrize(
    "problem", [OSError(errno.ENOSPC, "No space left on device"), ValueError("broken"), KeyboardInterrupt()]
)
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, problem, durable):
    target = tmp_path / "a.txt"
    target.write_bytes(b"old")

    def fail(part):
        part.write_bytes(b"half")
        raise problem

    expected = CloudError if isinstance(problem, OSError) else type(problem)
    with pytest.raises(expected) as caught:
        write_atomically(target, fail, durable=durable, error=CloudError)
    if expected is CloudError:
        assert "No space left on device" in str(caught.value) and "a.txt" in str(caught.value)
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_missing_folder_says_so(tmp_path):
    with pytest.raises(JaxscanError, match=r"the folder .*missing does not exist; create it first"):
        write_atomically(tmp_path / "missing" / "a.txt", b"")


def test_a_folder_or_device_is_not_replaced(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name in ("folder", "pipe"):
        with pytest.raises(JaxscanError, match="not a regular file"):
            write_atomically(tmp_path / name, b"x")
    assert sorted(os.listdir(tmp_path)) == ["folder", "pipe"]


def test_not_writable(tmp_path, monkeypatch):
    # Running as root, permissions would not stop the write: let the system call say no.
    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(JaxscanError, match=r"a.txt: cannot be written: Permission denied"):
        write_atomically(tmp_path / "a.txt", b"x")
    assert os.listdir(tmp_path) == []


def test_a_link_is_followed(tmp_path):
    (tmp_path / "real.txt").write_bytes(b"old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_atomically(tmp_path / "link.txt", b"new")
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "real.txt").read_bytes() == b"new"


@pytest.mark.parametrize("leads_to", ["real.txt", "nowhere.txt"])
def test_a_link_is_replaced(tmp_path, leads_to):
    (tmp_path / "real.txt").write_bytes(b"old")
    (tmp_path / "link.txt").symlink_to(leads_to)
    write_atomically(tmp_path / "link.txt", b"new", links="replace")
    assert not (tmp_path / "link.txt").is_symlink() and (tmp_path / "link.txt").read_bytes() == b"new"
    assert (tmp_path / "real.txt").read_bytes() == b"old" and not (tmp_path / "nowhere.txt").exists()


@pytest.mark.parametrize("links", ["follow", "replace"])
@pytest.mark.parametrize("name", ["n" * 300, "nul\0name", "lone\ud800surrogate"])
def test_names_that_no_file_can_have(tmp_path, name, links):
    for write in (
        lambda: write_atomically(tmp_path / name, b"x", links=links),
        lambda: check_writable(tmp_path / name),
    ):
        with pytest.raises(JaxscanError, match="cannot be written"):
            write()
    assert os.listdir(tmp_path) == []


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
