"""Captures, calibrations and clouds in a folder, as pages list them."""

import json
import os
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan import api
from jaxscan.calibration import Calibration
from jaxscan.cli.console.orders import NAME
from jaxscan.cli.console.slate import MOST_POINTS, pack_points
from jaxscan.errors import CaptureError, JaxscanError, OutputError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME, Capture, journal_objects, read_texts
from jaxscan.files.disk import open_regular
from jaxscan.report import words
from jaxscan.vision import encode_jpeg, to_grey


MOST = 200
"""Captures that are listed."""
_CLOUD = ".ply"
MADE = {"cloud": _CLOUD, "plan": ".plan.pdf", "mesh": ".glb", "report": ".report.html"}
"""What is made of a capture, and how its file ends behind the capture's name."""
_FORMAT, _HEAD = b'"jaxscan-calibration/', 200
_MADE_WITH, _CLOUD_HEAD = re.compile(rb"^comment calibration (\S+)$", re.MULTILINE), 2000
_MOST_FILES, _MOST_CALIBRATIONS, _MOST_BYTES = 2000, 20, 64 << 20
"""Files that are looked at for calibrations, calibrations that are listed, and the size of one."""
_THUMBNAIL = 240
"""Width of a thumbnail [px]."""
_WIDE = 960


class Captures:
    """The captures in a folder; whoever made them is a stranger, and so are their names."""

    def __init__(self, folder: Path, fits: Callable[[Calibration], bool] = lambda one: True) -> None:
        """The folder need not exist yet.

        Args:
            folder: Where they are.
            fits: Whether a calibration is one of the rig.
        """
        self.folder, self._fits = folder, fits
        self._known: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {}
        self._described: dict[str, tuple[tuple[int, int], dict[str, Any] | None]] = {}

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
        """The newest calibration that lies in the folder or beside it, may be used, and fits the rig."""
        return next((self.folder_of(one) / one["file"] for one in self.calibrations() if one["good"]), None)

    def folder_of(self, calibration: dict[str, Any]) -> Path:
        """Where a listed calibration lies."""
        return self.folder.parent if calibration["beside"] else self.folder

    def calibrations(self, *, of_any_rig: bool = False) -> list[dict[str, Any]]:
        """The calibrations in the folder and beside it that fit the rig, or all of them, the newest first.

        Beside it are those that were made in a terminal. A file with the name of a sweep was not made of it.
        """
        sweeps = {one["name"] for one in self.listed() if one["kind"] != "calibration"}
        found: dict[str, dict[str, Any]] = {}
        for beside, folder in ((False, self.folder), (True, self.folder.parent)):
            for name in _names(folder)[:_MOST_FILES]:
                path = folder / name
                if not name.endswith(".json") or not NAME.fullmatch(name) or name in found or os.path.islink(path):
                    continue
                if not os.path.isfile(path) or name.removesuffix(".json") in sweeps:
                    continue
                about = self._calibration(path)
                if about is not None and (about["fits"] or of_any_rig):
                    found[name] = about | {"file": name, "beside": beside, "changed": _changed(path)[0] / 1e9}
        return sorted(found.values(), key=lambda one: -float(one["changed"]))[:_MOST_CALIBRATIONS]

    def _calibration(self, path: Path) -> dict[str, Any] | None:
        """What is known of a calibration; None of another file."""
        state = _changed(path)
        if str(path) not in self._described or self._described[str(path)][0] != state:
            about = None
            # Many files end in .json, and some are large.
            with suppress(JaxscanError):
                with open_regular(path, error=CaptureError, limit=_MOST_BYTES, links="refuse") as file:
                    head = file.read(_HEAD)
                if _FORMAT in head:
                    found = api.load_calibration(path)
                    about = judged(found) | {"fits": self._fits(found)}
            self._described[str(path)] = (state, about)
        return self._described[str(path)][1]

    def calibration_of(self, digest: str) -> Path | None:
        """The file in the folder or beside it that is the calibration of this digest."""
        for one in self.calibrations(of_any_rig=True):
            file = self.folder_of(one) / one["file"]
            if digest and calibration_digest(file) == digest:
                return file
        return None

    def made(self, name: str, what: str) -> Path:
        """What is made of a capture: one of `MADE`."""
        return self.path(name).with_name(name + MADE[what])

    def delete(self, name: str) -> None:
        """Remove a capture, its cloud and what was made of it; calibrations stay.

        Raises:
            CaptureError: If it is none, or cannot be removed.
        """
        path = self._own(name)
        try:
            # It follows no links.
            shutil.rmtree(path)
            for suffix in MADE.values():
                path.with_name(name + suffix).unlink(missing_ok=True)
        except OSError as problem:
            raise CaptureError(f"{name}: cannot be removed: {problem.strerror}.") from problem

    def rename(self, name: str, other: str) -> None:
        """Give a capture, its cloud and what was made of it another name.

        Raises:
            CaptureError: If it is none, or the name is taken.
        """
        path, to = self._own(name), self.path(other)
        suffixes = [suffix for suffix in MADE.values() if os.path.lexists(path.with_name(name + suffix))]
        if taken := [suffix for suffix in ("", *suffixes) if os.path.lexists(to.with_name(other + suffix))]:
            raise CaptureError(f"{other}{taken[0]}: is there already; take another name.")
        try:
            os.rename(path, to)
            for suffix in suffixes:
                os.rename(path.with_name(name + suffix), to.with_name(other + suffix))
        except OSError as problem:
            raise CaptureError(f"{name}: cannot be renamed: {problem.strerror}.") from problem

    def _own(self, name: str) -> Path:
        """The folder of a capture that is in this folder itself, not elsewhere by a link."""
        path = self.path(name)
        if os.path.islink(path) or not os.path.isfile(path / HEADER_NAME):
            raise CaptureError(f"{name}: found no capture of this name in {self.folder}.")
        return path

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
            when = {what: _changed(self.made(name, what))[0] for what in MADE}
            # What was made of an older cloud is made again.
            made = [what for what in MADE if what != "cloud" and when[what] and when[what] >= when["cloud"]]
            there = {"cloud": when["cloud"] > 0, "made_with": self._made_with(name), "made": made}
            there |= {"changed": state[0] / 1e9}
            found.append(self._known[name][1] | there)
        return sorted(found, key=lambda one: -float(one["changed"]))[:MOST]

    def _made_with(self, name: str) -> str:
        """The digest of the calibration that the cloud of a capture was made with; "" where it is not known."""
        with suppress(JaxscanError), open_regular(self.cloud(name), error=CaptureError, links="refuse") as file:
            found = _MADE_WITH.search(file.read(_CLOUD_HEAD))
            return found[1].decode() if found else ""
        return ""

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
        on, off = capture.pictures(index)
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


def verdict_of(calibration: Calibration) -> dict[str, Any]:
    """The verdict of a calibration with the lines that it follows from, as pages show it."""
    captures = calibration.provenance.get("captures")
    # A file may say anything.
    of = [one.get("name") for one in captures if isinstance(one, dict)] if isinstance(captures, list) else []
    return judged(calibration) | {
        "of": of,
        "verdict": words.headline(calibration)._asdict(),
        "lengths": [line._asdict() for line in words.lengths(calibration)],
        "advice": words.advice(calibration),
        "warnings": words.warnings(calibration),
    }


def judged(calibration: Calibration) -> dict[str, Any]:
    """How good a calibration is, in a line."""
    first, verdict = words.headline(calibration), calibration.quality.verdict
    good_to = None if verdict is None else verdict.good_to
    size = {"sigma_mm": None if good_to is None else good_to.sigma_mm}
    return {"good": first.kind in ("good", "plain"), "headline": first.headline, **size}


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
