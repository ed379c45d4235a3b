"""Stripes that were extracted before: arrays in one file, under a key that says what they came from."""

import functools
import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.capture import Capture
from jaxscan.files.disk import MEGABYTE, parse_json, read_arrays, write_arrays, write_atomically


CACHE_FORMAT = "jaxscan-stripes/1"
MAX_CACHE_BYTES = 1 << 34
"""Largest file that is read; 7200 profiles of 4096 lines take 0.9 GiB."""

_KEY = "key"
_KINDS = "biuf"


def cache_path(capture: Capture) -> Path:
    """Where the stripes of a capture are kept: beside its journal."""
    return capture.path / "stripes.npz"


def frames_key(capture: Capture) -> str:
    """A digest of everything that the frames of a capture come from, as "sha256:<hex>".

    It changes with the header, the journal, the choice of records (`every`), and the size or the
    time of change of any image file. The images themselves are not read.

    Raises:
        CaptureError: If an image is no longer there.
    """
    digest = hashlib.sha256(capture.digest().encode())
    digest.update(json.dumps([record.i for record in capture.records]).encode())
    root = str(capture.path)
    images = {image.path: None for record in capture.records for image in (*record.on, *record.off)}
    for path in images:
        try:
            status = os.stat(f"{root}/{path}")
        except OSError as problem:
            raise CaptureError(f"{root}/{path}: cannot be read: {problem.strerror or problem}.") from problem
        digest.update(f"{path}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return "sha256:" + digest.hexdigest()


@functools.lru_cache(maxsize=1)
def code_digest() -> str:
    """Digest of the code that finds stripes, so that better code never takes the stripes of worse."""
    root = Path(str(resources.files("jaxscan")))
    files = sorted(file for room in ("stripes", "reconstruction") for file in (root / room).rglob("*.py"))
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return "sha256:" + digest.hexdigest()


def save_stripes(path: str | Path, arrays: Mapping[str, np.ndarray], key: Mapping[str, Any]) -> None:
    """Write arrays and their key, whole or not at all.

    Args:
        path: The file, `.npz`; one that exists is replaced.
        arrays: Of numbers or booleans, by name.
        key: What they came from, as JSON holds it: settings, versions, `frames_key`.

    Raises:
        CaptureError: If the file cannot be written.
        ValueError: If the arrays or the key are of another kind.
    """
    wrong = [name for name, array in arrays.items() if name == _KEY or np.asarray(array).dtype.kind not in _KINDS]
    if wrong:
        raise ValueError(f"`arrays` must hold numbers, and none may be called {_KEY!r}, got {wrong[0]!r}.")
    said = {"format": CACHE_FORMAT, "key": dict(key), "arrays": _described(arrays)}
    text = json.dumps(said, allow_nan=False).encode()
    about = {_KEY: np.frombuffer(text, np.uint8)}
    # It can be computed again, so it does not wait for the disk: what a loss of power leaves is refused.
    write_atomically(path, lambda part: write_arrays(part, {**about, **arrays}), durable=False, error=CaptureError)


def load_stripes(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read what `save_stripes` wrote.

    Returns:
        arrays: By name.
        key: As it was given, after a way through JSON.

    Raises:
        CaptureError: If the file is missing, damaged, too large, or another kind of file.
    """
    about = _about(path)
    arrays = read_arrays(path, error=CaptureError, limit=MAX_CACHE_BYTES)
    arrays.pop(_KEY, None)
    # The archive's own checksums do not cover the names and the number of its arrays.
    if any(array.dtype.kind not in _KINDS for array in arrays.values()) or _described(arrays) != about["arrays"]:
        raise CaptureError(f"{path}: does not hold the arrays that it lists; the file is damaged.")
    return arrays, about["key"]


def cached_stripes(path: str | Path, key: Mapping[str, Any]) -> dict[str, np.ndarray] | None:
    """The arrays that were saved under this very key; None where there are none that can be read.

    The arrays of another key are not read.
    """
    try:
        wanted = json.loads(json.dumps(dict(key), allow_nan=False))
        return load_stripes(path)[0] if _about(path)["key"] == wanted else None
    except CaptureError:
        return None


def _described(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {name: [np.asarray(array).dtype.str, *np.shape(array)] for name, array in arrays.items()}


def _about(path: str | Path) -> dict[str, Any]:
    """The key and what arrays there are, from a file of which every array is as large as it says."""
    _check_stored(path)
    found = read_arrays(path, error=CaptureError, limit=MEGABYTE, only=_KEY).get(_KEY)
    if found is None or found.dtype != np.uint8 or found.ndim != 1:
        raise CaptureError(f"{path}: holds no stripes ({CACHE_FORMAT}).")
    about = parse_json(found.tobytes(), name=str(path), error=CaptureError)
    if not isinstance(about, dict) or about.get("format") != CACHE_FORMAT:
        raise CaptureError(f"{path}: holds no stripes ({CACHE_FORMAT}).")
    if not all(isinstance(about.get(part), dict) for part in ("key", "arrays")):
        raise CaptureError(f"{path}: holds no stripes ({CACHE_FORMAT}).")
    return about


def _check_stored(path: str | Path) -> None:
    """See that nothing is compressed, so that no more memory is taken than the file has bytes."""
    try:
        if not os.path.isfile(path):
            raise CaptureError(f"{path}: no such file.")
        size = os.path.getsize(path)
        if size > MAX_CACHE_BYTES:
            raise CaptureError(f"{path}: larger than the {MAX_CACHE_BYTES >> 30} GiB that such a file may have.")
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            names = {member.filename for member in members}
            packed = [member.filename for member in members if member.compress_type != zipfile.ZIP_STORED]
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError) as problem:
        raise CaptureError(f"{path}: not a readable .npz file: {problem}.") from problem
    # Members may overlap in the file, or share a name, and be read more than once.
    if packed or len(names) < len(members) or sum(member.file_size for member in members) > size:
        raise CaptureError(f"{path}: not a readable .npz file: found compressed, repeated or overlapping arrays.")
