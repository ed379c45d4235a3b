"""Captures, calibrations and clouds in a folder, as pages list them."""

import os
import re
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan import api
from jaxscan.calibration import Calibration
from jaxscan.cli.console.orders import NAME_WORDS, is_name
from jaxscan.cli.console.slate import MOST_POINTS, one_line, pack_points
from jaxscan.errors import CaptureError, JaxscanError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME, journal_objects, read_texts
from jaxscan.files.disk import open_regular
from jaxscan.report import words
from jaxscan.stripes import PixelFormat
from jaxscan.vision import encode_jpeg, to_grey


MOST = 200
MADE = {"cloud": ".ply", "plan": ".plan.pdf", "mesh": ".glb", "report": ".report.html"}
"""What is made of a capture, and how its file ends behind the capture's name."""
_FORMAT, _HEAD = b'"jaxscan-calibration/', 200
_MADE_WITH, _CLOUD_HEAD = re.compile(rb"^comment calibration (\S+)$", re.MULTILINE), 2000
_MOST_FILES, _MOST_CALIBRATIONS, _MOST_BYTES = 2000, 20, 64 << 20
"""Files that are looked at for calibrations, calibrations that are listed, and the size of one."""
_THUMBNAIL, _WIDE = 240, 960


class Captures:
    """The captures in a folder. Neither their contents nor their names are trusted."""

    def __init__(self, folder: Path, fits: Callable[[Calibration], bool] = lambda one: True) -> None:
        """The folder need not exist yet; `fits` says whether a calibration is one of the rig."""
        self.folder, self._fits = folder, fits
        self._known: dict[Path, tuple[tuple[int, int], Any]] = {}
        """What was read of a file, and the state of the file then."""

    def path(self, name: str) -> Path:
        """Where a capture of this name is, or would be.

        Raises:
            CaptureError: If it is not the name of a capture.
        """
        if not is_name(name):
            raise CaptureError(f"{name}: {NAME_WORDS}")
        return self.folder / name

    def made(self, name: str, what: str) -> Path:
        """What is made of a capture: one of `MADE`."""
        return self.path(name).with_name(name + MADE[what])

    def cloud(self, name: str) -> Path:
        """The cloud of a capture."""
        return self.made(name, "cloud")

    def calibration(self, name: str) -> Path:
        """The calibration that is made of a capture."""
        return self.path(name).with_name(name + ".json")

    def newest_calibration(self) -> Path | None:
        """The newest calibration that lies in the folder or beside it, may be used, and fits the rig."""
        return next((self.folder_of(one) / one["file"] for one in self.calibrations() if one["good"]), None)

    def folder_of(self, calibration: dict[str, Any]) -> Path:
        """Where a listed calibration lies."""
        return self.folder.parent if calibration["beside"] else self.folder

    def calibration_of(self, digest: str) -> Path | None:
        """The file in the folder or beside it that is the calibration of this digest."""
        known = (one for one in self.calibrations(of_any_rig=True) if digest and one["digest"] == digest)
        return next((self.folder_of(one) / one["file"] for one in known), None)

    def calibrations(self, *, of_any_rig: bool = False) -> list[dict[str, Any]]:
        """The calibrations in the folder and beside it that fit the rig, or all of them, the newest first.

        Those beside it were made in a terminal. A file there that has the name of a sweep was not made from that sweep.
        """
        sweeps = {f"{one['name']}.json" for one in self.listed() if one["kind"] != "calibration"}
        found: dict[str, dict[str, Any]] = {}
        for beside, folder in ((False, self.folder), (True, self.folder.parent)):
            for name in _names(folder)[:_MOST_FILES]:
                path = folder / name
                if not name.endswith(".json") or not is_name(name) or name in found or name in sweeps:
                    continue
                if os.path.islink(path) or not os.path.isfile(path):
                    continue
                about = self._read_anew(path, path, self._calibration)
                if about is not None and (about["fits"] or of_any_rig):
                    found[name] = about | {"file": name, "beside": beside, "changed": _changed(path)[0] / 1e9}
        return sorted(found.values(), key=lambda one: -float(one["changed"]))[:_MOST_CALIBRATIONS]

    def _read_anew(self, path: Path, states: Path, read: Callable[[Path], Any]) -> Any:
        """The result of `read` for a path, cached until the file `states` changes."""
        state = _changed(states)
        if path not in self._known or self._known[path][0] != state:
            self._known[path] = (state, read(path))
        return self._known[path][1]

    def _calibration(self, path: Path) -> dict[str, Any] | None:
        """What is known of a calibration; None for any other file."""
        # Many files end in .json, and some are large.
        with suppress(JaxscanError):
            with open_regular(path, error=CaptureError, limit=_MOST_BYTES, links="refuse") as file:
                head = file.read(_HEAD)
            if _FORMAT in head:
                found = api.load_calibration(path)
                return judged(found) | {"fits": self._fits(found), "digest": calibration_digest(path)}
        return None

    def delete(self, name: str) -> None:
        """Remove a capture, its cloud and what was made of it; calibrations stay.

        Raises:
            CaptureError: If it is none, or cannot be removed.
        """
        path = self._own(name)
        try:
            # It follows no links.
            shutil.rmtree(path)
            for what in MADE:
                self.made(name, what).unlink(missing_ok=True)
        except OSError as problem:
            raise CaptureError(f"{name}: cannot be removed: {problem.strerror}.") from problem

    def rename(self, name: str, other: str) -> None:
        """Give a capture, its cloud and what was made of it another name.

        Raises:
            CaptureError: If it is none, or the name is taken.
        """
        moves = [(self._own(name), self.path(other))]
        moves += [(self.made(name, what), self.made(other, what)) for what in MADE]
        moves = [(old, new) for old, new in moves if os.path.lexists(old)]
        if taken := [new.name for _, new in moves if os.path.lexists(new)]:
            raise CaptureError(f"{taken[0]}: is there already; take another name.")
        try:
            for old, new in moves:
                os.rename(old, new)
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
            path = self.folder / name
            if not is_name(name) or not os.path.isfile(path / HEADER_NAME):
                continue
            about = self._read_anew(path, path / JOURNAL_NAME, _described)
            when = {what: _changed(self.made(name, what))[0] for what in MADE}
            # What was made of an older cloud is made again.
            made = [what for what in MADE if what != "cloud" and when[what] and when[what] >= when["cloud"]]
            beside = {"cloud": when["cloud"] > 0, "made_with": self._made_with(name), "made": made}
            found.append(about | beside | {"changed": _changed(path / JOURNAL_NAME)[0] / 1e9})
        return sorted(found, key=lambda one: -float(one["changed"]))[:MOST]

    def _made_with(self, name: str) -> str:
        """The digest of the calibration that the cloud of a capture was made with; "" where it is not known."""
        with suppress(JaxscanError), open_regular(self.cloud(name), error=CaptureError, links="refuse") as file:
            found = _MADE_WITH.search(file.read(_CLOUD_HEAD))
            return found[1].decode() if found else ""
        return ""

    def photograph(self, name: str, index: int, *, lit: bool, small: bool) -> bytes:
        """A picture of a record as JPEG: the laser-on frame if `lit`, as a thumbnail if `small`.

        Raises:
            CaptureError: If it is not there.
        """
        capture = api.open_capture(self.path(name), compare=False)
        if not 0 <= index < len(capture):
            raise CaptureError(f"{name}: found no record {index}, expected 0 ... {len(capture) - 1}.")
        on, off = capture.pictures(index)
        frame = on if (lit or off is None) and on is not None else off
        if frame is None:
            raise CaptureError(f"{name}: record {index} has no image.")
        step = max(1, frame.shape[1] // (_THUMBNAIL if small else _WIDE))
        return grey_jpeg(frame, capture.pixel_format, step)[0]

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


def grey_jpeg(frame: np.ndarray, pixel_format: PixelFormat, step: int) -> tuple[bytes, np.ndarray]:
    """Every n-th pixel of a frame, as a JPEG and as levels of grey."""
    grey = np.ascontiguousarray(to_grey(frame, pixel_format)[::step, ::step])
    return encode_jpeg(np.repeat(grey[:, :, None], 3, 2), quality=80), grey


def captures_of(provenance: Mapping[str, Any]) -> list[Any]:
    """Names of the captures that a calibration was made from, as its file states them: unchecked."""
    captures = provenance.get("captures")
    return [one.get("name") for one in captures if isinstance(one, dict)] if isinstance(captures, list) else []


def verdict_of(calibration: Calibration) -> dict[str, Any]:
    """The verdict of a calibration with the lines that it follows from, as pages show it."""
    return judged(calibration) | {
        "of": captures_of(calibration.provenance),
        "verdict": words.headline(calibration)._asdict(),
        "lengths": [line._asdict() for line in words.lengths(calibration)],
        "advice": words.advice(calibration),
        "warnings": words.warnings(calibration),
    }


def judged(calibration: Calibration) -> dict[str, Any]:
    """How good a calibration is, in a line."""
    first, verdict = words.headline(calibration), calibration.quality.verdict
    sigma_mm = None if verdict is None or verdict.good_to is None else verdict.good_to.sigma_mm
    return {"good": first.kind in ("good", "plain"), "headline": first.headline, "sigma_mm": sigma_mm}


def _described(path: Path) -> dict[str, Any]:
    about = {"name": path.name, "kind": "", "records": 0, "complete": False, "problem": ""}
    try:
        capture = api.open_capture(path)
    except JaxscanError as problem:
        return about | {"problem": one_line(problem)}
    *_, (_, last) = journal_objects(read_texts(path).journal_bytes)
    complete = last.get("event") == "end" and last.get("status") == "complete"
    return about | {"kind": capture.header.kind, "records": len(capture), "complete": complete}


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
