"""Reads blocks of files: by fsspec's driver, and those of S3 by a client that needs less than half its time.

A sweep has hundreds of small images. The client of S3 is used where server, region and keys are all that the driver
was told, and it gets those of the driver; after its first failure the driver reads all that follows. The driver's
answers and errors are those that count: the client makes it faster, and changes nothing else.
"""

import datetime
import re
from collections.abc import Callable
from typing import Any

from jaxscan.errors import DependencyError
from jaxscan.files.remote.place import Place, is_s3


Reader = Callable[[Place, int, int], bytes]
"""Reads a file from one byte to another; errors are those of the driver."""

_LASTS = datetime.timedelta(minutes=10)
"""After so much time the driver is asked for its keys again; it renews those that end."""
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")


def reader_of(place: Place) -> Reader:
    """A function that reads files of the storage of a place, from many threads.

    Raises:
        DependencyError: If the client of S3 is not installed.
    """
    return _reader_of_s3(place) if is_s3(place.address) and _is_plain(place) else by_driver


def by_driver(place: Place, start: int, end: int) -> bytes:
    """A block of a file, by fsspec's driver."""
    # S3 has no range of no bytes.
    return bytes(place.storage.cat_file(place.path, start=start, end=end)) if end > start else b""


def _is_plain(place: Place) -> bool:
    """Whether the driver of S3 was told nothing but a server, a region, and keys."""
    driver = place.storage
    config = driver.s3.meta.config
    told = driver.client_kwargs or driver.config_kwargs or driver.s3_additional_kwargs
    special = driver.requester_pays or driver.version_aware or driver.cache_regions or config.use_fips_endpoint
    # Of the profile: virtual hosts, acceleration, another way to sign; an authority for certificates.
    styles = (None, {"addressing_style": "auto"}, {"addressing_style": "path"})
    trusts = driver.session.get_config_variable("ca_bundle") and not driver.s3.meta.endpoint_url.startswith("http://")
    own = config.s3 not in styles or trusts
    signed = driver.anon or config.signature_version == "s3v4"
    keyed = bool(driver.key) == bool(driver.secret) and (driver.key or not driver.token)
    return bool(_BUCKET.fullmatch(_parted(place)[0]) and signed and keyed and not (told or special or own))


def _reader_of_s3(place: Place) -> Reader:
    try:
        from obstore.store import S3Store
    except ImportError as problem:
        raise DependencyError('s3:// needs obstore: pip install "jaxscan[s3]"') from problem
    driver = place.storage
    server = driver.s3.meta
    known: dict[str, Any] = {} if driver.anon else {"credential_provider": lambda: _keys(driver)}
    store = S3Store(
        _parted(place)[0],
        # All that it would otherwise take from the environment, where the driver may not have looked.
        endpoint=server.endpoint_url,
        aws_endpoint_url_s3=server.endpoint_url,
        region=server.region_name or "us-east-1",
        skip_signature=bool(driver.anon),
        virtual_hosted_style_request=False,
        request_payer=False,
        s3_express=False,
        client_options={
            "allow_http": server.endpoint_url.startswith("http://"),
            "connect_timeout": "10s",
            # A silent line has failed. A slow one has not: this limit is that of a whole request.
            "read_timeout": "60s",
            "timeout": "1 hour",
        },
        # Every request is tried again by the caller.
        retry_config={"max_retries": 0},
        **known,
    )
    failures: list[Exception] = []

    def read(place: Place, start: int, end: int) -> bytes:
        if end > start and not failures:
            try:
                return bytes(store.get_range(_parted(place)[1], start=start, end=end))
            except FileNotFoundError:
                raise
            # A bucket in another region, a certificate, a key that it cannot spell, or a network that fails.
            except Exception as problem:
                failures.append(problem)
        return by_driver(place, start, end)

    return read


def _parted(place: Place) -> tuple[str, str]:
    bucket, _, key = place.path.partition("/")
    return bucket, key


def _keys(driver: Any) -> dict[str, Any]:
    """The keys with which the driver signs: those that it was given, or else those that its session finds."""
    if driver.key:
        return _named(driver.key, driver.secret, driver.token, None)
    from fsspec.asyn import sync

    async def frozen() -> Any:
        found = await driver.session.get_credentials()
        return await found.get_frozen_credentials()

    keys = sync(driver.loop, frozen)
    until = datetime.datetime.now(datetime.UTC) + _LASTS
    return _named(keys.access_key, keys.secret_key, keys.token, until)


def _named(key: str, secret: str, token: str | None, until: datetime.datetime | None) -> dict[str, Any]:
    return {"access_key_id": key, "secret_access_key": secret, "token": token, "expires_at": until}
