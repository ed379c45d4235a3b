"""Digests of what a project reads: captures, calibration files, and the code."""

import functools
import hashlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from pathlib import Path

from jaxscan.errors import CaptureError, ConfigError
from jaxscan.files.capture import HEADER_NAME, JOURNAL_NAME
from jaxscan.files.disk import MEGABYTE, file_digest, read_bounded
from jaxscan.files.remote import is_remote, remote_digest
from jaxscan.project.steps import Step, digest_of, parts_of


_CAPTURE = ("geometry", "stripes", "vision", "files/capture", "files/calibration", "api")
_SWEEP = (*_CAPTURE, "reconstruction")
_CLOUD = (*_SWEEP, "photographs", "files/clouds")
_CALIBRATION = (*_CAPTURE, "observation", "calibration")
_MEASURES = ("geometry", "measurement", "files/calibration", "files/clouds", "api")
_MERGED = ("geometry", "reconstruction", "files/clouds", "api")
_PLAN = (*_MEASURES, "reconstruction", "drawing", "files/drawings")
_REGISTER = (*_CALIBRATION, "reconstruction", "recalibration", "measurement", "files/known_room")
CODE_OF: Mapping[str, tuple[str, ...]] = {
    "calibration": _CALIBRATION,
    "stripes": _SWEEP,
    "cloud": _CLOUD,
    "measures": _MEASURES,
    "mesh": (*_MEASURES, "reconstruction", "surface", "files/meshes"),
    "plan": _PLAN,
    "panorama": _CLOUD,
    "report": (*_MEASURES, "reconstruction", "calibration", "drawing", "vision", "report"),
    "recalibration": _REGISTER,
    "register": _REGISTER,
    "station": _CLOUD,
    "merged e57": _MERGED,
    "merged tiles": _MERGED,
    "merged plan": _PLAN,
}
"""Rooms, folders or files, whose code decides a product, beside the one that makes them all: a change elsewhere, of the
viewer say, leaves it as good as it was. Rooms that decide an input already are not named again."""
_AT_A_TIME = 16
"""Sources that are asked for at a time: mostly they wait for disks and networks."""
MOST_JOURNAL = 1 << 30


def digests_of(steps: Iterable[Step]) -> tuple[dict[str, str], dict[str, dict[str, str]]]:
    """The digest of every step, and its parts.

    Args:
        steps: Each after those that it needs.

    Returns:
        digests: By key.
        parts: By key, as `parts_of` gives them.

    A capture that cannot be read has the digest of the reason: its steps fail when they are done, and no others.

    Raises:
        JaxscanError: If a file that many steps read is not there.
    """
    steps = tuple(steps)
    roles = {address: role for step in steps for role, address in step.sources.items()}
    with ThreadPoolExecutor(_AT_A_TIME) as pool:
        found = dict(zip(roles, pool.map(_source, roles, roles.values()), strict=True))
    digests: dict[str, str] = {}
    parts: dict[str, dict[str, str]] = {}
    for step in steps:
        parts[step.key] = parts_of(step, found | {key: digests[key] for key in step.inputs}, code_digest(step.kind))
        digests[step.key] = digest_of(step, parts[step.key])
    return digests, parts


@functools.cache
def code_digest(kind: str) -> str:
    """Digest of the code that makes products of a kind."""
    root = Path(str(resources.files("jaxscan")))
    digest = hashlib.sha256()
    rooms = (*CODE_OF[kind], "project/work")
    # A room is a folder, or one file.
    files = {file for room in rooms for file in (*(root / room).rglob("*.py"), *root.glob(f"{room}.py"))}
    for file in sorted(files):
        digest.update(str(file.relative_to(root)).encode() + b"\0" + read_bounded(file, MEGABYTE, error=ConfigError))
    return "sha256:" + digest.hexdigest()


def _source(address: str, role: str) -> str:
    capture = role.startswith(("capture", "boards"))
    try:
        if is_remote(address):
            return remote_digest(address)
        return _capture_digest(address) if capture else file_digest(address, error=ConfigError)
    except CaptureError as problem:
        if not capture:
            raise
        return "sha256:" + hashlib.sha256(f"cannot be read: {problem}".encode(errors="backslashreplace")).hexdigest()


def _capture_digest(folder: str) -> str:
    """A capture by its header and journal, which names the sha256 of every image."""
    digest = hashlib.sha256()
    for name in (HEADER_NAME, JOURNAL_NAME):
        digest.update(file_digest(Path(folder, name), limit=MOST_JOURNAL, error=CaptureError).encode())
    return "sha256:" + digest.hexdigest()
