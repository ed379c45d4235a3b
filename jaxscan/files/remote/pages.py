"""Lists one folder on storage, and no more of it than is allowed: a server may have, or invent, names without end."""

from typing import Any

from jaxscan.errors import CaptureError
from jaxscan.files.disk import shown
from jaxscan.files.remote.place import Place, asked, info_of, is_s3


def listed(folder: Place, most: int) -> list[dict[str, Any]]:
    """The entries of a folder, with the field names of its driver.

    Args:
        folder: On storage.
        most: Most entries. More are refused: by S3's listing when it comes to them, by that of another driver, which
            has no pages, when it is complete.

    Raises:
        CaptureError: If there are more, or it cannot be listed.
    """
    # Its driver would collect all pages first. A bucket's versions, and the list of buckets, are left to it.
    if is_s3(folder.address) and folder.path and not folder.storage.version_aware:
        return _by_pages(folder, most) or _alone(folder)
    found: list[dict[str, Any]] = asked(lambda: folder.storage.ls(folder.path, detail=True), folder)
    if len(found) > most:
        raise _too_many(folder, most)
    return found


def _alone(folder: Place) -> list[dict[str, Any]]:
    """The entry of a place that is no folder with entries: that of a file, none of an empty bucket."""
    entry = info_of(folder)
    return [entry] if entry["type"] == "file" else []


def _by_pages(folder: Place, most: int) -> list[dict[str, Any]]:
    bucket, key, _ = folder.storage.split_path(folder.path)
    wanted = {"Bucket": bucket, "Prefix": f"{key}/" if key else "", "Delimiter": "/"}
    found: list[dict[str, Any]] = []

    def page() -> tuple[list[dict[str, Any]], str | None]:
        answer = folder.storage.call_s3("list_objects_v2", **wanted)
        inner = [
            {"name": f"{bucket}/{one['Prefix'][:-1]}", "type": "directory", "size": 0}
            for one in answer.get("CommonPrefixes", ())
        ]
        files = [
            {"name": f"{bucket}/{one['Key']}", "type": "file", "size": one["Size"], "ETag": one.get("ETag")}
            for one in answer.get("Contents", ())
        ]
        return inner + files, answer["NextContinuationToken"] if answer.get("IsTruncated") else None

    # A page has an entry at least.
    for _ in range(most + 1):
        entries, following = asked(page, folder)
        found += entries
        if len(found) > most:
            break
        if following is None:
            return found
        wanted["ContinuationToken"] = following
    raise _too_many(folder, most)


def _too_many(folder: Place, most: int) -> CaptureError:
    return CaptureError(f"{shown(folder.address)}: holds more than {most} files.")
