"""Names that no file can have: one line, wherever a file is read or written, and before any work."""

import os

import numpy as np
import pytest

from jaxscan.errors import JaxscanError
from jaxscan.files.calibration import load_calibration, load_scanner
from jaxscan.files.capture import CaptureHeader, open_capture, verify_capture
from jaxscan.files.clouds import load_cloud
from jaxscan.files.disk import FileModel, load_toml, read_arrays
from jaxscan.files.recording import create_capture, repack_capture, resume_capture


HEADER = CaptureHeader.model_validate(
    {"kind": "sweep", "camera": {"width": 6, "height": 4, "pixel_format": "mono8"}, "laser": {"name": "red"}}
)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    path = tmp_path_factory.mktemp("names") / "room"
    with create_capture(path, HEADER, durable=False) as writer:
        writer.append(angle_deg=0.0, on=np.zeros((4, 6), np.uint8))
    return path


READERS = {
    "capture": open_capture,
    "verify": verify_capture,
    "resume": resume_capture,
    "cloud": lambda path: load_cloud(f"{path}.ply"),
    "cloud npz": lambda path: load_cloud(f"{path}.npz"),
    "calibration": lambda path: load_calibration(f"{path}.json"),
    "scanner": lambda path: load_scanner(f"{path}.json"),
    "configuration": lambda path: load_toml(path, FileModel),
    "arrays": lambda path: read_arrays(path, error=JaxscanError),
}
WRITERS = {
    "capture": lambda path, capture: create_capture(path, HEADER),
    "repacked": lambda path, capture: repack_capture(capture, path, storage="npy"),
}
NAMES = ["n" * 300, "nul\0name", "lone\ud800surrogate", "deep/" * 2000 + "x"]


@pytest.mark.parametrize("name", NAMES, ids=["long", "nul", "surrogate", "deep"])
@pytest.mark.parametrize("reader", READERS)
def test_reading(tmp_path, reader, name):
    with pytest.raises(JaxscanError) as caught:
        READERS[reader](tmp_path / name)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1500


@pytest.mark.parametrize("name", NAMES, ids=["long", "nul", "surrogate", "deep"])
@pytest.mark.parametrize("writer", WRITERS)
def test_writing(tmp_path, capture, writer, name):
    with pytest.raises(JaxscanError) as caught:
        WRITERS[writer](tmp_path / name, capture)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1500
    assert os.listdir(tmp_path) == []
