"""Tiny captures, written by hand as a person would import one."""

import json

import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files.capture import CaptureHeader, open_capture
from jaxscan.vision import encode_png


HEADER = """\
format = "jaxscan-capture/1"
kind = "{kind}"
[camera]
width = 6
height = 4
pixel_format = "{pixel_format}"
[turntable]
carries = "scanner"
{rest}
"""
LASER = '[[laser]]\nname = "red"\n'
BOARD = '[board]\ntype = "chessboard"\ncolumns = 5\nrows = 4\nsquare_mm = 30.0\n'
CAMERA = {"width": 6, "height": 4, "pixel_format": "mono8"}
FRAMES = np.random.default_rng(6).integers(0, 256, (60, 4, 6), np.uint8)


def header(kind="sweep", **tables):
    """The header of a capture that is written by the program."""
    board = {"type": "chessboard", "columns": 5, "rows": 4, "square_mm": 30.0} if kind == "calibration" else None
    return CaptureHeader(kind=kind, **{"camera": CAMERA, "laser": [{"name": "red"}], "board": board, **tables})


def refused(error, call, *patterns):
    """The message with which a call is refused: one line that holds all the patterns."""
    with pytest.raises(error) as caught:
        call()
    said = str(caught.value)
    assert "\n" not in said and all(pattern in said for pattern in patterns), said
    return said


class Folder:
    """A capture's folder under construction."""

    def __init__(self, path):
        self.path = path
        (path / "on").mkdir(parents=True)
        (path / "off").mkdir()
        self.lines = []
        self.header()

    def header(self, kind="sweep", pixel_format="mono8", rest=LASER):
        text = HEADER.format(kind=kind, pixel_format=pixel_format, rest=rest)
        (self.path / "capture.toml").write_text(text)

    def image(self, name, image):
        (self.path / name).write_bytes(encode_png(image))
        return image

    def record(self, i, *, angle_deg=None, **keys):
        """A complete record with images of its own; `keys` replace or add."""
        rng = np.random.default_rng(i)
        on = self.image(f"on/{i:06d}.png", rng.integers(0, 256, (4, 6), np.uint8))
        off = self.image(f"off/{i:06d}.png", rng.integers(0, 256, (4, 6), np.uint8))
        record = {"i": i, "angle_deg": 0.1 * i if angle_deg is None else angle_deg}
        record |= {"on": f"on/{i:06d}.png", "off": f"off/{i:06d}.png", **keys}
        self.line(json.dumps(record))
        return on, off

    def line(self, text):
        self.lines.append(text)
        (self.path / "frames.jsonl").write_text("".join(line + "\n" for line in self.lines))

    def refused(self, *patterns):
        """Opening it is refused."""
        return refused(CaptureError, lambda: open_capture(self.path), *patterns)


def journal(path):
    """The lines of a capture's journal."""
    return [json.loads(line) for line in (path / "frames.jsonl").read_text().splitlines()]


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path / "room")
