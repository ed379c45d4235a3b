"""The one door for reading: regular files only, at once, and none that is too large."""

import os
import socket

import pytest

from jaxscan.errors import CaptureError, JaxscanError
from jaxscan.files.disk import open_regular, read_bounded

from .conftest import refused


def test_a_file_is_opened_and_closed(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    with open_regular(tmp_path / "a", error=CaptureError, limit=3) as file:
        assert file.read() == b"abc" and file.tell() == 3
    assert file.closed
    assert read_bounded(tmp_path / "a", 3, error=CaptureError) == b"abc"


def test_pipes_and_devices_and_folders_are_refused_at_once(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "to_zero").symlink_to("/dev/zero")
    listening = socket.socket(socket.AF_UNIX)
    monkeypatch.chdir(tmp_path)  # The path of a socket is short.
    listening.bind("socket")
    for name, found in (("pipe", "a device or pipe"), ("folder", "a folder"), ("to_zero", "a device or pipe")):
        with pytest.raises(CaptureError, match=f"{name}: found {found}, expected a file") as caught:
            open_regular(tmp_path / name, error=CaptureError)
        assert "\n" not in str(caught.value)
    with pytest.raises(CaptureError, match="socket: cannot be read"), listening:
        open_regular(tmp_path / "socket", error=CaptureError)


def test_too_large(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * (2 << 20))
    with pytest.raises(JaxscanError, match=r"a: larger than the 1 MiB that such a file may have"):
        read_bounded(tmp_path / "a", 1 << 20, error=JaxscanError)


def test_links_are_followed_or_refused(tmp_path):
    (tmp_path / "real").write_bytes(b"abc")
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "dangling").symlink_to("nowhere")
    assert read_bounded(tmp_path / "link", 9, error=CaptureError) == b"abc"
    assert read_bounded(tmp_path / "real", 9, error=CaptureError, links="refuse") == b"abc"
    for name in ("link", "dangling"):
        with pytest.raises(CaptureError, match=f"{name}: found a link, expected the file itself"):
            read_bounded(tmp_path / name, 9, error=CaptureError, links="refuse")
    with pytest.raises(CaptureError, match="dangling: no such file"):
        read_bounded(tmp_path / "dangling", 9, error=CaptureError)


@pytest.mark.parametrize("links", ["follow", "refuse"])
@pytest.mark.parametrize("name", ["n" * 300, "nul\0name", "lone\ud800surrogate", "a/b" * 3000])
def test_names_that_no_file_can_have_are_one_short_line(tmp_path, name, links):
    said = refused(CaptureError, lambda: open_regular(tmp_path / name, error=CaptureError, links=links))
    assert len(said) < 1500


def test_no_handle_is_left_after_a_refusal(tmp_path):
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        with pytest.raises(CaptureError):
            open_regular(tmp_path, error=CaptureError)
    assert len(os.listdir("/proc/self/fd")) == before
