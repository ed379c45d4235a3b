"""Captures that a pattern finds on storage."""

import fnmatch
import functools

from jaxscan.errors import CaptureError
from jaxscan.files.capture import HEADER_NAME
from jaxscan.files.disk import shown
from jaxscan.files.remote.listing import entries_of
from jaxscan.files.remote.place import Missing, Place, check_address, in_threads, info_of, open_place


MAX_FOUND = 20_000
"""Most folders that a pattern may find."""

_WILD = frozenset("*?[")


def find_captures(pattern: str) -> list[str]:
    """Addresses of the captures that a pattern finds.

    Args:
        pattern: Such as "s3://bucket/rooms/*", with `*`, `?` and `[…]` in any part of the path.

    Returns:
        Those of the folders that hold a capture's header, sorted; none where there is nothing.

    Raises:
        CaptureError: If storage cannot be read, its listing is hostile, or more than `MAX_FOUND` folders fit.
        DependencyError: If fsspec, or the driver for the scheme, is not installed.
    """
    check_address(pattern)
    scheme, rest = pattern.split("://", 1)
    parts = rest.rstrip("/").split("/")
    if any("**" in part for part in parts):
        raise CaptureError(f"{shown(pattern)}: found **, expected one * for each folder on the way.")
    first = next((k for k, part in enumerate(parts) if _WILD & set(part)), len(parts))
    places = [open_place(f"{scheme}://{'/'.join(parts[:first])}")]
    for part in parts[first:]:
        if _WILD & set(part):
            places = [one for found in in_threads(functools.partial(_matching, part=part), places) for one in found]
        else:
            places = [place.child(part) for place in places]
        if len(places) > MAX_FOUND:
            raise CaptureError(f"{shown(pattern)}: finds more than {MAX_FOUND} folders; expected a narrower pattern.")
    headed = in_threads(_has_header, places)
    return sorted(place.address for place, has in zip(places, headed, strict=True) if has)


def _matching(place: Place, part: str) -> list[Place]:
    """The folders in a folder whose names fit one part of a pattern."""
    try:
        entries = entries_of(place)
    except Missing:
        return []
    return [place.child(name) for name, e in entries if e["type"] == "directory" and fnmatch.fnmatchcase(name, part)]


def _has_header(place: Place) -> bool:
    try:
        return info_of(place.child(HEADER_NAME)).get("type") == "file"
    except Missing:
        return False
