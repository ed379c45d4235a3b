"""A line in the header of a cloud that tells whether the file is still as it was written: formats without checksums.

The line holds the file's size and a digest of all its bytes, taken with zeros in the place of the digest. A program
that keeps the comments but writes a header of its own makes a file of another size, of which the line says nothing; a
file of the same size that differs is damaged, or was edited in place.
"""

import hashlib
import os
import re
from pathlib import Path
from typing import BinaryIO

from jaxscan.errors import CloudError
from jaxscan.files.disk import Part


_DIGEST_BYTES, _SIZE_DIGITS = 16, 15
_HEAD_BYTES = 64 << 10
_BLOCK_BYTES = 1 << 20
_LINE = re.compile(rb"seal blake2b ([0-9a-f]{%d}) of ([0-9]{%d}) bytes\r?\n" % (2 * _DIGEST_BYTES, _SIZE_DIGITS))

SEAL_LINE = f"seal blake2b {'0' * 2 * _DIGEST_BYTES} of {'0' * _SIZE_DIGITS} bytes"
"""Comment for a header, whose numbers `seal` fills in."""


def seal(path: Part) -> None:
    """Fill in the line of a file that is complete; it is read once, a block at a time.

    Args:
        path: A file with `SEAL_LINE` in its header.
    """
    with open(path, "r+b") as file:
        found = _LINE.search(file.read(_HEAD_BYTES))
        if found is None:
            raise ValueError(f"{path} has no line to fill in.")
        file.seek(found.start(2))
        file.write(f"{os.fstat(file.fileno()).st_size:0{_SIZE_DIGITS}d}".encode())
        digest = _digest(file, found.start(1))
        file.seek(found.start(1))
        file.write(digest.encode())


def check_seal(file: BinaryIO, path: Path) -> None:
    """Compare a file with the line in its header; one without it, or of another size, is that of another program.

    Args:
        file: Open for reading; it is at its beginning afterwards.
        path: For messages.

    Raises:
        CloudError: If it has changed since it was written.
    """
    found = _LINE.search(file.read(_HEAD_BYTES))
    if found is not None and int(found[2]) == os.fstat(file.fileno()).st_size:
        digest = _digest(file, found.start(1))
        if digest != found[1].decode():
            raise CloudError(
                f"{path}: has changed since it was written: found digest {digest}, expected {found[1].decode()}; copy "
                'or write it anew, or take the comment "seal ..." out of its header if you have edited it.'
            )
    file.seek(0)


def _digest(file: BinaryIO, place: int) -> str:
    """Digest of the whole file, as if zeros were at the place of its own digest."""
    digits = 2 * _DIGEST_BYTES
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    file.seek(0)
    digest.update(file.read(place) + b"0" * digits)
    file.seek(place + digits)
    while block := file.read(_BLOCK_BYTES):
        digest.update(block)
    return digest.hexdigest()
