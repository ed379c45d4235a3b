"""Cache of extracted stripes: arrays in one file, with a key that identifies their source."""

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
from jaxscan.files.disk import MEGABYTE, parse_json, read_arrays, reported, write_arrays, write_atomically


CACHE_FORMAT = "jaxscan-stripes/1"
CACHE_NAME = "stripes.npz"
MAX_CACHE_BYTES = 1 << 34
"""Largest file that is read; 7200 profiles of 4096 lines take 0.9 GiB."""

_KEY = "key"
_KINDS = "biuf"


def cache_path(capture: Capture) -> Path:
    """Where the stripes of a capture are kept: beside its journal."""
    return capture.path / CACHE_NAME


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
        with reported(f"{root}/{path}: cannot be read", error=CaptureError):
            status = os.stat(f"{root}/{path}")
        digest.update(f"{path}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return "sha256:" + digest.hexdigest()


@functools.lru_cache(maxsize=1)
def code_digest() -> str:
    """Digest of the code that finds stripes, so that better code never takes the stripes of worse."""
    root = Path(str(resources.files("jaxscan")))
    digest = hashlib.sha256()
    for file in sorted(file for room in ("stripes", "reconstruction") for file in (root / room).rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return "sha256:" + digest.hexdigest()


def save_stripes(path: str | Path, arrays: Mapping[str, np.ndarray], key: Mapping[str, Any]) -> None:
    """Write arrays and their key atomically.

    Args:
        path: The file, `.npz`; one that exists is replaced.
        arrays: Arrays of numbers or booleans, by name.
        key: Their source, as JSON values: settings, versions, `frames_key`.

    Raises:
        CaptureError: If the file cannot be written.
        ValueError: If the arrays or the key are of another kind.
    """
    wrong = [name for name, array in arrays.items() if name == _KEY or np.asarray(array).dtype.kind not in _KINDS]
    if wrong:
        raise ValueError(f"`arrays` must hold numbers, and none may be called {_KEY!r}, got {wrong[0]!r}.")
    about = {"format": CACHE_FORMAT, "key": dict(key), "arrays": _described(arrays)}
    text = {_KEY: np.frombuffer(json.dumps(about, allow_nan=False).encode(), np.uint8)}
    # It can be computed again, so it does not wait for the disk; a file damaged by a loss of power is refused.
    write_atomically(path, lambda part: write_arrays(part, {**text, **arrays}), durable=False, error=CaptureError)


def load_stripes(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read a file that `save_stripes` wrote.

    Returns:
        arrays: By name.
        key: As it was given, with the types of JSON.

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
    """The arrays that were saved with exactly this key; None if there are none or they cannot be read.

    Arrays with another key are not read.
    """
    try:
        wanted = json.loads(json.dumps(dict(key), allow_nan=False))
        return load_stripes(path)[0] if _about(path)["key"] == wanted else None
    except CaptureError:
        return None


def _described(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {name: [np.asarray(array).dtype.str, *np.shape(array)] for name, array in arrays.items()}


def _about(path: str | Path) -> dict[str, Any]:
    """The key and the list of arrays, from a file in which nothing is compressed."""
    _check_stored(path)
    found = read_arrays(path, error=CaptureError, limit=MEGABYTE, only=_KEY).get(_KEY)
    if found is not None and found.dtype == np.uint8 and found.ndim == 1:
        about = parse_json(found.tobytes(), name=str(path), error=CaptureError)
        if isinstance(about, dict) and about.get("format") == CACHE_FORMAT:
            if all(isinstance(about.get(part), dict) for part in ("key", "arrays")):
                return about
    raise CaptureError(f"{path}: holds no stripes ({CACHE_FORMAT}).")


def _check_stored(path: str | Path) -> None:
    """Check that nothing is compressed, so that reading takes no more memory than the size of the file."""
    if not os.path.isfile(path):
        raise CaptureError(f"{path}: no such file.")
    try:
        size = os.path.getsize(path)
        if size > MAX_CACHE_BYTES:
            raise CaptureError(f"{path}: larger than the {MAX_CACHE_BYTES >> 30} GiB that such a file may have.")
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except (OSError, ValueError, zipfile.BadZipFile, NotImplementedError) as problem:
        raise CaptureError(f"{path}: not a readable .npz file: {problem}.") from problem
    stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
    # Members may overlap in the file, or share a name, and be read more than once.
    repeated = len({member.filename for member in members}) < len(members)
    if not stored or repeated or sum(member.file_size for member in members) > size:
        raise CaptureError(f"{path}: not a readable .npz file: found compressed, repeated or overlapping arrays.")
