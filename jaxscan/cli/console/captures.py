"""Captures, calibrations and clouds in a folder, as pages list them."""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan import api
from jaxscan.cli.console.orders import NAME
from jaxscan.cli.console.slate import MOST_POINTS, pack_points
from jaxscan.errors import CaptureError, JaxscanError, OutputError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME, Capture, journal_objects, read_texts
from jaxscan.report import words
from jaxscan.vision import encode_jpeg, to_grey


MOST = 200
"""Captures that are listed."""
_CLOUD = ".ply"
_THUMBNAIL = 240
"""Width of a thumbnail [px]."""
_WIDE = 960


class Captures:
    """The captures in a folder; whoever made them is a stranger, and so are their names."""

    def __init__(self, folder: Path) -> None:
        """The folder need not exist yet."""
        self.folder = folder
        self._known: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {}

    def path(self, name: str) -> Path:
        """Where a capture of this name is, or would be.

        Raises:
            CaptureError: If it is no name of one.
        """
        if not NAME.fullmatch(name) or ".." in name:
            raise CaptureError(f"{name}: expected letters, digits, dots, dashes and underscores, 64 at most.")
        return self.folder / name

    def cloud(self, name: str) -> Path:
        """The cloud of a capture."""
        return self.path(name).with_name(name + _CLOUD)

    def calibration(self, name: str) -> Path:
        """The calibration that is made of a capture."""
        return self.path(name).with_name(name + ".json")

    def newest_calibration(self) -> Path | None:
        """The calibration of the newest capture of the board that has one which may be used."""
        for one in self.listed():
            file = self.calibration(one["name"])
            if one["kind"] != "calibration" or not os.path.isfile(file):
                continue
            with suppress(JaxscanError):
                if words.headline(api.load_calibration(file)).kind == "good":
                    return file
        return None

    def calibration_of(self, digest: str) -> Path | None:
        """The file in the folder that is the calibration of this digest."""
        for one in self.listed():
            file = self.calibration(one["name"])
            if digest and os.path.isfile(file) and calibration_digest(file) == digest:
                return file
        return None

    def listed(self) -> list[dict[str, Any]]:
        """What is known of each capture, the newest first."""
        found = []
        for name in _names(self.folder):
            header, journal = self.folder / name / HEADER_NAME, self.folder / name / JOURNAL_NAME
            if not NAME.fullmatch(name) or not os.path.isfile(header):
                continue
            state = _changed(journal)
            if name not in self._known or self._known[name][0] != state:
                self._known[name] = (state, self._describe(name))
            found.append(self._known[name][1] | {"cloud": os.path.isfile(self.cloud(name)), "changed": state[0] / 1e9})
        return sorted(found, key=lambda one: -float(one["changed"]))[:MOST]

    def _describe(self, name: str) -> dict[str, Any]:
        try:
            capture = api.open_capture(self.path(name))
        except JaxscanError as problem:
            problem_line = " ".join(str(problem).split())
            return {"name": name, "kind": "", "records": 0, "complete": False, "problem": problem_line}
        *_, (_, last) = journal_objects(read_texts(self.path(name)).journal_bytes)
        complete = last.get("event") == "end" and last.get("status") == "complete"
        about = {"kind": capture.header.kind, "records": len(capture), "complete": complete, "problem": ""}
        return {"name": name} | about

    def photograph(self, name: str, index: int, *, lit: bool, small: bool) -> bytes:
        """A picture of a record as JPEG.

        Args:
            name: The capture.
            index: Of its records, from 0.
            lit: The laser-on frame rather than the laser-off frame.
            small: As a thumbnail.

        Raises:
            CaptureError: If it is not there.
        """
        capture: Capture = api.open_capture(self.path(name), compare=False)
        if not 0 <= index < len(capture):
            raise CaptureError(f"{name}: found no record {index}, expected 0 ... {len(capture) - 1}.")
        on, off = capture.frames(index)
        frame = on if (lit or off is None) and on is not None else off
        if frame is None:
            raise CaptureError(f"{name}: record {index} has no image.")
        step = max(1, frame.shape[1] // (_THUMBNAIL if small else _WIDE))
        grey = to_grey(frame, capture.pixel_format)[::step, ::step]
        return encode_jpeg(np.repeat(np.ascontiguousarray(grey)[:, :, None], 3, 2), quality=80)

    def points(self, name: str) -> bytes:
        """The cloud of a capture, thinned, for a page.

        Raises:
            CloudError: If it cannot be read.
        """
        cloud = api.load_cloud(self.cloud(name))
        valid = np.asarray(cloud.valid)
        xyz, rgb = np.asarray(cloud.xyz)[valid], np.asarray(cloud.rgb)[valid]
        step = max(1, -(-len(xyz) // MOST_POINTS))
        return pack_points(xyz[::step], rgb[::step])


def result_of(path: Path) -> dict[str, Any]:
    """The JSON that a verb wrote."""
    from jaxscan.files.disk import read_bounded

    found = json.loads(read_bounded(path, 64 << 20, error=OutputError))
    return found if isinstance(found, dict) else {}


def _names(folder: Path) -> list[str]:
    try:
        return sorted(os.listdir(folder))
    except OSError:
        # Nothing was captured yet.
        return []


def _changed(path: Path) -> tuple[int, int]:
    try:
        about = os.stat(path)
    except OSError:
        return 0, 0
    return about.st_mtime_ns, about.st_size
