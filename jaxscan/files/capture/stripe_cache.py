"""Cache of extracted stripes: arrays in one file, with a key that identifies their source."""

import functools
import hashlib
import json
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.capture import Capture
from jaxscan.files.disk import MEGABYTE, parse_json, read_arrays, read_bounded, reported, write_arrays, write_atomically


CACHE_FORMAT = "jaxscan-stripes/3"
CACHE_NAME = "stripes.npz"
MAX_CACHE_BYTES = 1 << 34
"""Most memory that its arrays take; 7200 profiles of 4096 lines take 0.9 GiB."""

_KEY = "key"
_KINDS = "biuf"


def cache_path(capture: Capture) -> Path:
    """Where the stripes of a capture are kept: beside its journal, or where the capture says."""
    return capture.stripes_at or capture.path / CACHE_NAME


def frames_key(capture: Capture) -> str:
    """A digest of everything that the frames of a capture come from, as "sha256:<hex>".

    It changes with the header, the journal, the choice of records (`every`), and the size or a time of any image
    file: of its content, and of its entry on the disk, which no program can set. So stripes do not serve a copy
    of the capture either. The images themselves are not read.

    Raises:
        CaptureError: If an image is no longer there.
    """
    digest = hashlib.sha256(capture.digest().encode())
    digest.update(json.dumps([capture.compared, [record.i for record in capture.records]]).encode())
    root = str(capture.path)
    images = {image.path: None for record in capture.records for image in (*record.on, *record.off)}
    for path in images:
        with reported(f"{root}/{path}: cannot be read", error=CaptureError):
            status = os.stat(f"{root}/{path}")
        digest.update(f"{path}\0{status.st_size}\0{status.st_mtime_ns}\0{status.st_ctime_ns}\n".encode())
    return "sha256:" + digest.hexdigest()


@functools.lru_cache(maxsize=1)
def code_digest() -> str:
    """Digest of the code that finds stripes, so that new code never uses stripes of older code."""
    root = Path(str(resources.files("jaxscan")))
    digest = hashlib.sha256()
    for file in sorted(file for room in ("stripes", "reconstruction") for file in (root / room).rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + read_bounded(file, MEGABYTE, error=CaptureError))
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
    about = {"format": CACHE_FORMAT, "key": dict(key), "sha256": _digest(arrays)}
    text = {_KEY: np.frombuffer(json.dumps(about, allow_nan=False).encode(), np.uint8)}
    # It can be computed again, so it does not wait for the disk; a file damaged by a loss of power is refused.
    # In the folder of a capture a link may lead anywhere, so it is replaced.
    write = functools.partial(write_arrays, arrays={**text, **arrays})
    write_atomically(path, write, durable=False, error=CaptureError, links="replace")


def load_stripes(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read a file that `save_stripes` wrote.

    Returns:
        arrays: By name.
        key: The key that was given, in the types of JSON.

    Raises:
        CaptureError: If the file is missing, damaged, too large, or another kind of file.
    """
    about = _about(path)
    arrays = _read(path, limit=MAX_CACHE_BYTES)
    arrays.pop(_KEY, None)
    # The archive's own checksums do not cover the names and the number of its arrays.
    if any(array.dtype.kind not in _KINDS for array in arrays.values()) or _digest(arrays) != about["sha256"]:
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


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    """The sha256 of all arrays with their names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        digest.update(array.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def _about(path: str | Path) -> dict[str, Any]:
    """The key and the list of arrays, from a file in which nothing is compressed."""
    found = _read(path, limit=MEGABYTE, only=_KEY).get(_KEY)
    if found is not None and found.dtype == np.uint8 and found.ndim == 1:
        about = parse_json(found.tobytes(), name=str(path), error=CaptureError)
        if isinstance(about, dict) and about.get("format") == CACHE_FORMAT:
            if isinstance(about.get("key"), dict) and "sha256" in about:
                return about
    raise CaptureError(f"{path}: holds no stripes ({CACHE_FORMAT}).")


def _read(path: str | Path, *, limit: int, only: str | None = None) -> dict[str, np.ndarray]:
    """Arrays of a file in which nothing is compressed: they take no more memory than its size."""
    return read_arrays(path, error=CaptureError, limit=limit, only=only, stored=True, links="refuse")
