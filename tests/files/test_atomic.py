"""Files appear whole or not at all."""

import errno
import os

import pytest

from jaxscan.errors import CloudError, JaxscanError
from jaxscan.files.disk import check_writable, write_atomically


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
