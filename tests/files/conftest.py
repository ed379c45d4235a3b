"""Tiny captures, written by hand as a person would import one."""

import json

import numpy as np
import pytest

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


def journal(path):
    """The lines of a capture's journal."""
    return [json.loads(line) for line in (path / "frames.jsonl").read_text().splitlines()]


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path / "room")
