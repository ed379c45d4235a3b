"""Names that no file can have: one line, wherever a file is read or written, and before any work."""

import os

import numpy as np
import pytest

from jaxscan.errors import JaxscanError
from jaxscan.files.capture import open_capture
from jaxscan.files.recording import create_capture, repack_capture

from .conftest import header, refused


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    path = tmp_path_factory.mktemp("names") / "room"
    with create_capture(path, header(), durable=False) as writer:
        writer.append(angle_deg=0.0, on=np.zeros((4, 6), np.uint8))
    return path


WRITERS = {
    "capture": lambda path, capture: create_capture(path, header()),
    "repacked": lambda path, capture: repack_capture(capture, path, storage="npy"),
}
NAMES = ["n" * 300, "nul\0name", "lone\ud800surrogate", "deep/" * 2000 + "x"]


@pytest.mark.parametrize("name", NAMES, ids=["long", "nul", "surrogate", "deep"])
def test_reading(tmp_path, name):
    """A capture is the one thing that is looked at before it is opened; for all others stands `test_opening`."""
    said = refused(JaxscanError, lambda: open_capture(tmp_path / name))
    assert len(said) < 1500


@pytest.mark.parametrize("name", NAMES, ids=["long", "nul", "surrogate", "deep"])
@pytest.mark.parametrize("writer", WRITERS)
def test_writing(tmp_path, capture, writer, name):
    said = refused(JaxscanError, lambda: WRITERS[writer](tmp_path / name, capture))
    assert len(said) < 1500 and os.listdir(tmp_path) == []
