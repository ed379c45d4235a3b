"""Reads blocks of files: by fsspec's driver, and those of S3 by a client that needs a quarter of its time for each.

A sweep has hundreds of small images. Keys, region and server are those that the driver has found.
"""

import datetime
from collections.abc import Callable
from typing import Any

from jaxscan.errors import DependencyError
from jaxscan.files.remote.place import Place, is_s3


Reader = Callable[[Place, int, int], bytes]
"""Reads a file from one byte to another; errors are those of its library."""

_LASTS = datetime.timedelta(minutes=10)
"""After so much time the driver is asked for its keys again; it renews those that end."""


def reader_of(place: Place) -> Reader:
    """A function that reads files of the storage of a place, from many threads.

    Raises:
        DependencyError: If the client of S3 is not installed.
    """
    return _reader_of_s3(place) if is_s3(place.address) else _by_driver


def _by_driver(place: Place, start: int, end: int) -> bytes:
    content: bytes = place.storage.cat_file(place.path, start=start, end=end)
    return content


def _reader_of_s3(place: Place) -> Reader:
    try:
        from obstore.store import S3Store
    except ImportError as problem:
        raise DependencyError('s3:// needs obstore: pip install "jaxscan[s3]"') from problem
    driver = place.storage
    server = driver.s3.meta
    bucket = _parted(place)[0]
    known: dict[str, Any] = {"skip_signature": True} if driver.anon else {"credential_provider": lambda: _keys(driver)}
    store = S3Store(
        bucket,
        endpoint=server.endpoint_url,
        region=server.region_name or "us-east-1",
        virtual_hosted_style_request=False,
        client_options={"allow_http": server.endpoint_url.startswith("http://")},
        # Every request is tried again by the caller.
        retry_config={"max_retries": 0},
        **known,
    )

    def read(place: Place, start: int, end: int) -> bytes:
        # S3 has no range of no bytes.
        return bytes(store.get_range(_parted(place)[1], start=start, end=end)) if end > start else b""

    return read


def _parted(place: Place) -> tuple[str, str]:
    bucket, _, key = place.path.partition("/")
    return bucket, key


def _keys(driver: Any) -> dict[str, Any]:
    from fsspec.asyn import sync

    async def frozen() -> Any:
        found = await driver.session.get_credentials()
        return await found.get_frozen_credentials()

    keys = sync(driver.loop, frozen)
    until = datetime.datetime.now(datetime.UTC) + _LASTS
    return {
        "access_key_id": keys.access_key,
        "secret_access_key": keys.secret_key,
        "token": keys.token,
        "expires_at": until,
    }
